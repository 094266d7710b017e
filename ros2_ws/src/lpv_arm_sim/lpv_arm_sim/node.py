"""Simulator node: publishes faulty joint measurements of a simulated arm."""

import time
from dataclasses import replace

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from lpv.core.control.tracking import BANDWIDTH, loop_latency
from lpv.core.control.watchdog import (
    UNKNOWN_LOOP,
    BrakeReason,
    DriveWatchdog,
    LatencyLimits,
    latency_limits,
)
from lpv.core.monitoring.message_fields import ERROR, OK, WARN
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.limits import PATIENCE
from lpv.core.support.timestamps import NANOSECONDS, set_stamp, to_nanoseconds
from lpv.core.uio.certificate.gains import Gains
from lpv_msgs.msg import GroundTruth, TorqueCommand
from lpv_msgs.srv import ClearFaults, InjectFault
from lpv_node.input_check import Refusals, all_finite, all_sized
from lpv_node.managed import ManagedNode, served
from lpv_node.parameters import (
    FROM_GAINS,
    chosen_limit,
    declare_given,
    named_file,
    read_gains,
    table,
)
from lpv_node.qos import stream
from lpv_node.serialized import SerializedMessage
from lpv_node.status import StatusReporter

SPECS = table(f"""
arm_file FILE           arm file (YAML), or name of a shipped arm
scenario_file FILE      scenario file (YAML), or name of a shipped one
seed=-1[-1:2147483647]  seed of noise and disturbance; -1 takes the scenario's
substeps=2[1:100]       Runge-Kutta steps per sample
shutdown_at_end         exit with code 0 after the scenario's duration; otherwise the arm goes on at
                        the end of its path
command_timeout=0.0[0:60]  real time only: brake when the measurement that was answered last is this
                        old [s]; {FROM_GAINS}
max_mean_latency=0.0[0:60]  real time only: brake when commands are this old on average over 0.1 s
                        [s]; {FROM_GAINS}
bandwidth={BANDWIDTH}[0.1:100]  serial arms only: that of the tracker, which limits of latency
                        follow from [rad/s]
start_time=1.0[0.001:1e9]  lockstep only: stamp of the first sample [s]; zero means "not set" in ROS
""")

_CATCH_UP = 5
"""Most samples that a braked arm makes up for, as queues hold; what is beyond is left out."""


class SimulatorNode(ManagedNode):
    """Simulated arm in real time, or in lockstep with /clock.

    Topics: publishes ``joint_states`` (sensor_msgs/JointState), ``ground_truth``
    (lpv_msgs/GroundTruth, for recording only) and, in lockstep, ``/clock``; subscribes
    ``torque_command``.  Services: ``~/inject_fault``, ``~/clear_faults``,
    ``~/release_brakes``.

    Until the first command and for the reasons of `lpv.core.control.watchdog` the drives brake and
    hold the arm where it is; a joint that was too fast keeps them braked until
    ``~/release_brakes``.  In real time an arm does not wait for a process that
    is late: it moves on under the last torque until the drives brake.  In lockstep a sample
    without an answer is sent again when nodes have joined: one that was restarted missed it.
    """

    def __init__(self) -> None:
        super().__init__('arm_sim', SPECS)
        declare_given(self, 'gains')
        self._begun = False
        self._command: TorqueCommand | None = None
        self._waiting = 0  # stamp of the sample that lockstep wants answered [ns]
        self._sent = 0.0  # steady time at which it was sent [s]
        self._slips = 0
        self._reason: BrakeReason | None = BrakeReason.NO_COMMAND  # None: brakes released
        self._flowing = False

    def setup(self) -> None:
        """Read arm and scenario, create publishers and services."""
        self._arm = load_arm(named_file(self, 'arm_file', 'arms'))
        scenario = load_scenario(named_file(self, 'scenario_file', 'scenarios'))
        seed = self.get_parameter('seed').value
        if seed >= 0:
            scenario = replace(scenario, seed=seed)
        self._scenario = scenario
        substeps = self.get_parameter('substeps').value
        self._plant = ArmSimulator(self._arm, scenario, substeps)
        limits = self._latency_limits()
        self._watchdog = DriveWatchdog(self._arm, limits)
        # Compile before the first step, not on it.
        trial = ArmSimulator(self._arm, scenario, substeps)
        trial.read()
        trial.step([0.0] * len(self._arm.joint_names))
        trial.hold()
        self._velocity = self._plant.signals['velocity']
        DriveWatchdog(self._arm, limits).check(1, 0, True, self._velocity)
        self._start = self._first = self._answered = 0  # stamps of samples [ns]
        self._refusals = Refusals(self)
        self._period = round(self._arm.sample_time * NANOSECONDS)
        self._last = round(scenario.duration / self._arm.sample_time)
        qos = stream(self.lockstep)
        self._joint_states_out = self.create_publisher(JointState, 'joint_states', qos)
        self._truth_out = self.create_publisher(GroundTruth, 'ground_truth', qos)
        self._clock_out = None
        if self.lockstep:
            self._clock_out = self.create_publisher(ClockMessage, '/clock', qos)
        self._status = StatusReporter(self, 'drives', self._arm.name)
        self.create_service(InjectFault, '~/inject_fault', self._on_inject)
        self.create_service(ClearFaults, '~/clear_faults', self._on_clear)
        self.create_service(Trigger, '~/release_brakes', self._on_release)
        self._make_messages()

    def _make_messages(self) -> None:
        """Messages that are made of the simulator's own memory."""
        now = self._plant.signals
        self._clock_message = ClockMessage()
        measured = {
            'position': now['measured_position'],
            'velocity': now['measured_velocity'],
            'effort': now['effort'],
        }
        self._state_message = SerializedMessage(
            'sensor_msgs/msg/JointState', 'base_link', measured, name=list(self._arm.joint_names)
        )
        truth = {name: now[name] for name in ('position', 'velocity', 'fault', 'disturbance')}
        truth['torque'] = self._plant.state.torque
        self._truth_message = SerializedMessage('lpv_msgs/msg/GroundTruth', self._arm.name, truth)

    def _latency_limits(self) -> LatencyLimits:
        """As the gains of the loop allow, if they are known, or as parameters say."""
        gains, certified = read_gains(self, self._arm, Gains), UNKNOWN_LOOP
        if gains is not None or self._arm.lpv is None:
            bandwidth = self.get_parameter('bandwidth').value
            certified = latency_limits(loop_latency(self._arm, gains, bandwidth))
        return LatencyLimits(
            chosen_limit(self, 'command_timeout', certified.single),
            chosen_limit(self, 'max_mean_latency', certified.mean),
        )

    def outputs(self) -> dict[Publisher, int]:
        """Publishers to be matched before the first sample."""
        return {self._joint_states_out: 1, self._truth_out: 0, self._status.publisher: 0}

    def listen(self) -> None:
        """Subscribe to commands: the tracker waits for this before it takes estimates."""
        self.create_subscription(
            TorqueCommand, 'torque_command', self._on_command, stream(self.lockstep)
        )

    def begin(self) -> None:
        """Start stepping."""
        self._begun = True
        if self.lockstep:
            self._start = round(self.get_parameter('start_time').value * NANOSECONDS)
            self.get_logger().info(f'lockstep, {self._last} steps of {self._arm.sample_time} s')
            self._newcomers, self._peers = True, self._count_peers()
            self._publish()
            self.steady_timer(0.25, self._ask_again)
        else:
            self._set_clock()
            self.get_logger().info(f'real time, {1.0 / self._arm.sample_time:.0f} Hz')
            self.steady_timer(self._arm.sample_time, self._tick)

    def end(self) -> None:
        """Stop stepping."""
        self._command = None
        self._begun = self._flowing = False

    def _set_clock(self) -> None:
        """The present sample is now: what passed, or was set, meanwhile is no time of the arm's."""
        self._first = self.get_clock().now().nanoseconds
        self._start = self._first - self._plant.step_count * self._period
        self._command, self._answered = None, 0

    @property
    def _stamp(self) -> int:
        return self._start + self._plant.step_count * self._period

    def _on_command(self, message: TorqueCommand) -> None:
        """Lockstep: the answer to the present sample makes the next step. Real time: store it."""
        if not self._begun:
            return  # it answers no sample of this simulator, which has not begun
        stamp = to_nanoseconds(message.header.stamp)
        refusal = self._refusal(message, stamp)
        if refusal:
            self._refusals.add(refusal)
            return
        if self.lockstep and stamp != self._waiting:
            return  # a command for an older sample, e.g. of a tracker that was restarted
        self._command, self._answered = message, stamp
        if self.lockstep:
            self._newcomers = False
            self._advance()
            self._publish()
        elif not self._flowing and self._age() <= self._watchdog.command_age:
            self._flowing = True
            self.get_logger().info('commands flow')

    def _refusal(self, message: TorqueCommand, stamp: int) -> str:
        """Why a command is ignored: it must answer a measurement of this arm."""
        if not all_sized(len(self._arm.joint_names), message.torque):
            return 'command with another number of joints than the arm'
        if not all_finite(message.torque):
            return 'command with values that are not finite'
        if self.lockstep:
            return ''
        if not self._first <= stamp <= self._stamp or (stamp - self._start) % self._period:
            return 'command whose stamp answers no measurement'
        # A safe stop answers the last estimate, which may have been answered before.
        if stamp <= self._answered and not message.safe_stop:
            return 'command for a measurement that was answered before'
        return ''

    def _count_peers(self) -> tuple[int, int]:
        return (
            self._joint_states_out.get_subscription_count(),
            self.count_publishers('torque_command'),
        )

    def _ask_again(self) -> None:
        """Lockstep: send a sample again that went to a node which is no more.

        Only where nodes have come or gone since it was sent: an answer that is merely late must
        not be given twice, or runs with the same seed would differ.
        """
        peers = self._count_peers()
        self._newcomers |= peers != self._peers
        self._peers = peers
        if self._newcomers and time.monotonic() - self._sent > PATIENCE:  # without an answer
            self._sent = time.monotonic()
            self._joint_states_out.publish(self._state_message.at(self._waiting))

    def _tick(self) -> None:
        """Make the steps that are due; only while it is braked may the arm leave some out."""
        if not self.has_time():
            return
        late = self.get_clock().now().nanoseconds - self._stamp
        # Nobody takes less for a clock that was set back; or /clock has told its first time.
        if late < -NANOSECONDS or not self._first:
            self._set_clock()
            return
        behind = late // self._period
        while behind > 0 and not self.finished:
            if self._reason is not None and behind > _CATCH_UP:
                self._start += (behind - 1) * self._period
                self._slips += behind - 1
                behind = 1
            self._advance()
            self._publish()
            behind -= 1

    def _advance(self) -> None:
        """Let the present command act over one sample, or the brakes."""
        command = self._command
        reason = BrakeReason.NO_COMMAND
        if command is not None:
            age = 0 if self.lockstep else self._age()
            reason = self._watchdog.check(self._stamp, age, command.safe_stop, self._velocity)
        if command is not None and reason is BrakeReason.NONE:
            self._plant.step(command.torque)
        else:
            self._flowing &= reason is not BrakeReason.LATE
            self._plant.hold()
        self._note(None if reason is BrakeReason.NONE else reason)

    def _note(self, reason: BrakeReason | None) -> None:
        """Say that the brakes were engaged or released, or why they stay."""
        if reason is not self._reason:
            if reason is None:
                self.get_logger().info('brakes released')
            elif self._reason is None or reason is BrakeReason.OVERSPEED:
                self.get_logger().error(f'brakes engaged: {self._brake_text(reason)}')
            self._reason = reason
        if reason is BrakeReason.NO_COMMAND:
            status = WARN, 'braked: no command yet'
        elif reason is not None:
            status = ERROR, f'braked: {self._brake_text(reason)}'
        elif self._refusals.is_recent:
            status = WARN, 'driven; commands are refused'
        else:
            status = OK, 'driven'
        self._status.report(self._stamp, *status, self._status_values)

    def _status_values(self) -> dict[str, int]:
        return {'samples left out': self._slips, **self._refusals.counts}

    def _count_senders(self) -> None:
        """Notice a second sender of commands, which is a fault of the graph."""
        senders = self.count_publishers('torque_command')
        if senders > 1:
            self._refusals.add(f'the topic torque_command has {senders} senders')

    def _brake_text(self, reason: BrakeReason) -> str:
        text = reason.text
        return f'{text}; stays until ~/release_brakes is called' if self._watchdog.latched else text

    def _age(self) -> int:
        """Age of the measurement that was answered last [ns]: late answers are as bad as none."""
        return self._stamp - self._answered

    @served
    def _on_inject(self, asked: InjectFault.Request, _response: InjectFault.Response) -> str:
        """Start a fault now."""
        now = self._plant.time
        fault = Fault(asked.sensor, asked.kind, now, asked.duration, asked.size, asked.rate)
        self._plant.injector.add(fault)
        return f'{fault.kind} on {fault.sensor} from {now:.3f} s on'

    @served
    def _on_clear(self, request: ClearFaults.Request, response: ClearFaults.Response) -> str:
        """Remove faults of one sensor or of all."""
        response.cleared = self._plant.injector.clear(request.sensor)
        return f'{response.cleared} faults cleared'

    @served
    def _on_release(self, _request: Trigger.Request, _response: Trigger.Response) -> str:
        latched, self._watchdog.latched = self._watchdog.latched, 0
        return 'brakes may be released' if latched else 'none latched'

    def _publish(self) -> None:
        self._plant.read()
        stamp = self._stamp
        self._waiting = stamp
        if self._clock_out is not None:
            set_stamp(self._clock_message.clock, stamp)
            self._clock_out.publish(self._clock_message)
        self._joint_states_out.publish(self._state_message.at(stamp))
        self._sent = time.monotonic()
        # Nobody waits for the truth, and meanwhile the observer is at work.
        self._truth_out.publish(self._truth_message.at(stamp))
        self._report_progress()

    def _report_progress(self) -> None:
        step = self._plant.step_count
        every_second = step % max(1, round(1.0 / self._arm.sample_time)) == 0
        if every_second and not self.lockstep:
            self._count_senders()
        if every_second and step <= self._last:
            left_out = f', {self._slips} samples left out: too slow' if self._slips else ''
            self.get_logger().info(
                f'scenario time {self._plant.time:.1f} of {self._scenario.duration:.1f} s{left_out}'
            )
        if step == self._last:
            self.get_logger().info('the scenario is over')
        if step == self._last and self.get_parameter('shutdown_at_end').value:
            self.finished = True
