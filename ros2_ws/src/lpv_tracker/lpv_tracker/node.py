"""Tracker node: torques from estimates and from inverse-kinematics references."""

from operator import attrgetter

import numpy as np
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from lpv.core.control.estimate_check import (
    IMPOSSIBLE,
    NOT_FINITE,
    ROWS,
    CorrectionLimit,
    check_values,
)
from lpv.core.control.path_follower import APPROACH_SPEED, PathFollower, approach_speeds
from lpv.core.control.tracking import BANDWIDTH, COMPENSATION, FEEDBACK_FIELDS, TrackingController
from lpv.core.control.watchdog import (
    LatencyLimits,
    StopReason,
    TrackerLimits,
    TrackerWatchdog,
    latency_limits,
    mean_limit,
)
from lpv.core.monitoring.message_fields import ERROR, OK, WARN
from lpv.core.monitoring.stamp_gate import StampGate
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.certificate.loop_gains import NO_CERTIFICATE, LoopGains
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.limits import PATIENCE, QUIET, SMALL
from lpv.core.support.options import Entry
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds
from lpv.core.uio.certificate.gains import Gains
from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand
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
from lpv_tracker.upcoming import UpcomingReferences

SPECS = table(f"""
arm_file FILE           arm file (YAML), or name of a shipped arm
scenario_file FILE      scenario file (YAML) or name of a shipped one; its path is tracked
estimate_timeout=0.0[0:60]  real time only: safe stop when no estimate came for this long [s];
                        {FROM_GAINS}
max_latency=0.0[0:60]   real time only: safe stop when an estimate answers a measurement that is
                        older [s]; {FROM_GAINS}
max_mean_latency=0.0[0:60]  real time only: safe stop when measurements that estimates answer are
                        older on average over 0.1 s [s]; {FROM_GAINS}, or in proportion to a longer
                        max_latency
max_tracking_error={TrackerLimits.tracking_error}[0.01:10]  safe stop, until ~/resume is called,
                        when a joint is further from its reference for 0.05 s [rad]
max_speed={TrackerLimits.speed}[0.01:1]  safe stop, until ~/resume is called, when a joint is faster
                        for 0.02 s than this share of its velocity limit, as measured or as
                        estimated [1]
approach_speed={APPROACH_SPEED}[0.01:10]  fastest joint rate on the way to the path, where the arm
                        starts or goes on elsewhere; below what max_speed allows [rad/s]
bandwidth={BANDWIDTH}[0.1:100]  serial arms only: distance from zero of the three poles of every
                        joint [rad/s]; the gains of a two-link arm are in its gains file
""")
TUNABLE = (
    Entry('compensation', 'position in the loop: as measured (off), with confirmed faults removed, '
          'or as estimated (always)', 'confirmed', choices=COMPENSATION),
)  # fmt: skip
_REFUSALS = {
    NOT_FINITE: 'estimate with values that are not finite',
    IMPOSSIBLE: 'estimate with values that no arm has',
}
_OTHER_CLOCK = round(2.0 * PATIENCE * NANOSECONDS)
"""Stamps that differ from this machine's time by more are of another clock [ns]."""
_UNKNOWN_LATENCY = 'not watched: stamps are of another clock'


class TrackerNode(ManagedNode):
    """Tracking controller.

    Topics: subscribes ``state_estimate``; publishes ``torque_command``, ``reference`` and
    ``/diagnostics``.  Service: ``~/resume``.  The path starts at the stamp of the first estimate;
    its clock stands still during a safe stop, and an arm that is found elsewhere is led to the path
    first (`lpv.core.control.path_follower`).

    Safe stops: for the reasons of `lpv.core.control.watchdog`, and when the node is deactivated or
    ends.  A joint that is too fast or far from its reference stops the arm until ``~/resume``, and
    so does a confirmed fault that the observer no longer knows after a silence.
    """

    def __init__(self) -> None:
        super().__init__('tracker', SPECS, TUNABLE)
        declare_given(self, 'gains', 'loop')
        self._reason: StopReason | None = StopReason.SILENCE  # None: following the path
        self.add_post_set_parameters_callback(self._choose_feedback)

    def setup(self) -> None:
        """Read arm, gains and path, create publishers."""
        self._arm = load_arm(named_file(self, 'arm_file', 'arms'))
        self._make_controller()
        scenario = load_scenario(named_file(self, 'scenario_file', 'scenarios'))
        self._path = scenario.path(self._arm)
        period, joints = round(self._arm.sample_time * NANOSECONDS), len(self._arm.joint_names)
        certified = latency_limits(self._tolerated)
        single = chosen_limit(self, 'max_latency', certified.single)
        # The default of the mean follows a longer single latency, which was warned of.
        own = self.get_parameter('max_mean_latency').value
        mean = chosen_limit(self, 'max_mean_latency', certified.mean)
        if not own and single > certified.single:
            mean = mean_limit(single)
        self._limits = TrackerLimits(
            silence=chosen_limit(self, 'estimate_timeout', certified.single),
            latency=LatencyLimits(single, mean),
            speed=self.get_parameter('max_speed').value,
            tracking_error=self.get_parameter('max_tracking_error').value,
        )
        speed, self._scales = self.get_parameter('approach_speed').value, self._arm.scales()
        speeds = approach_speeds(self._arm, self._limits.speed, speed)
        tip = len(self._path.sample(0.0).tip)
        follower = PathFollower(self._path, speeds, self._scales)
        self._follower = UpcomingReferences(follower, period, joints, tip)
        self._warn_of_speed()
        self._estimate = np.zeros((len(ROWS), joints))
        self._bytes = self._estimate.data.cast('B')
        row = dict(zip(ROWS, self._estimate))
        self._corrected, self._measured = row['compensated_position'], row['measured_position']
        self._velocity, self._measured_velocity = row['velocity'], row['measured_velocity']
        self._endless = np.array([joint.is_endless for joint in self._arm.joints])
        self._place = np.zeros(joints)  # measured positions of the last estimate [rad]
        self._forgotten: np.ndarray | None = None  # correction before a silence [rad]
        self._correction, self._compensation = CorrectionLimit(self._arm), ''
        self._choose_feedback()
        self._compile()
        self._watchdog = TrackerWatchdog(self._arm, self._limits)
        self._stamps, self._refusals, self._stops = StampGate(), Refusals(self), 0
        self._last_stop = ''
        self._last: int | None = None  # stamp of the last estimate [ns]
        self._used = np.zeros(joints)  # correction of the last estimate that was trusted [rad]
        self._previous: int | None = None  # stamp of the last estimate that was followed [ns]
        self._received = 0  # steady time at which the last estimate came [ns]
        self._latency = 0  # of the last estimate [ns]
        qos = stream(self.lockstep)
        self._command_out = self.create_publisher(TorqueCommand, 'torque_command', qos)
        self._reference_out = self.create_publisher(JointReference, 'reference', qos)
        self._status = StatusReporter(self, 'tracking', self._arm.name)
        self.create_service(Trigger, '~/resume', self._on_resume)
        self._make_messages()

    def _warn_of_speed(self) -> None:
        """Say so if the path is faster than the watchdog allows."""
        rate = self._path.sample(np.linspace(self._path.start, self._path.end, 1001)).velocity
        shares = np.abs(rate).max(axis=0) / np.array(self._arm.velocity_limit)
        i = int(np.argmax(shares))
        if shares[i] > self._limits.speed:
            self.get_logger().warning(
                f'the path needs {shares[i]:.0%} of the velocity limit of '
                f'{self._arm.joint_names[i]}; above max_speed, {self._limits.speed:.0%}, the arm '
                'is stopped'
            )

    def _make_messages(self) -> None:
        """Messages that are made of references and commands where these are."""
        self._torque, self._safe_stop = np.zeros(len(self._arm.joint_names)), np.zeros(1, bool)
        name, reference = self._arm.name, self._follower.reference
        command = {'torque': self._torque, 'safe_stop': self._safe_stop}
        self._command = SerializedMessage('lpv_msgs/msg/TorqueCommand', name, command)
        self._reference = SerializedMessage(
            'lpv_msgs/msg/JointReference',
            name,
            {
                'position': reference.position,
                'velocity': reference.velocity,
                'acceleration': reference.acceleration,
                'tip_position': reference.tip,
            },
        )

    def _choose_feedback(self, _parameters: object = None) -> None:
        """Let the loop close on the position that a parameter names, if that has changed."""
        compensation = self.get_parameter('compensation').value
        if hasattr(self, '_correction') and compensation != self._compensation:
            self._compensation = compensation
            self._position = self._estimate[ROWS.index(FEEDBACK_FIELDS[compensation])]
            self._correction.turn_to(self._position, compensation != 'off')

    def _make_controller(self) -> None:
        """The designed law where there are gains, else computed torque."""
        bandwidth = self.get_parameter('bandwidth').value
        gains = read_gains(self, self._arm, Gains)
        self._controller = TrackingController(self._arm, gains, bandwidth)
        self._tolerated = self._controller.tolerated_latency
        if gains is not None:
            self._certificate = 'holds'
        else:
            loop = read_gains(self, self._arm, LoopGains, bandwidth=bandwidth)
            self._certificate = NO_CERTIFICATE if loop is None else loop.certified_region()

    def _compile(self) -> None:
        """Compile before the first estimate, not on it."""
        still = np.zeros(len(self._arm.joint_names))
        self._controller.answer(np.zeros((3, len(still))), still + 0.1, still, still + 0.1, 0.0)
        self._controller.reset()
        watchdog = TrackerWatchdog(self._arm, self._limits)
        watchdog.check_estimate(1, 0, 0, True, still, still)
        watchdog.check_motion(1, still, still, still)
        self._correction.take(1, still, still)
        self._correction.restart()
        check_values(self._estimate)

    def outputs(self) -> dict[Publisher, int]:
        """Publishers to be matched before estimates are taken."""
        return {self._command_out: 1, self._reference_out: 0, self._status.publisher: 0}

    def begin(self) -> None:
        """Subscribe."""
        self.create_subscription(
            StateEstimate, 'state_estimate', self._on_estimate, stream(self.lockstep)
        )
        if not self.lockstep:
            self.steady_timer(0.02, self._check_silence)
        self.get_logger().info(
            f'tracking a path of {self._path.end:.1f} s; the loop tolerates a constant latency of '
            f'{1e3 * self._tolerated:.0f} ms; certificate of the loop: {self._certificate}'
        )

    def end(self) -> None:
        """Leave the arm braked."""
        if self._reason is None and not self.lockstep:
            self._stop(StopReason.SILENCE)

    def _on_estimate(self, message: StateEstimate) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        if not self._is_usable(message, stamp):
            return
        now = 0 if self.lockstep else self.get_clock().now().nanoseconds
        if self._last is not None and stamp <= self._last:
            if self.lockstep and stamp == self._last:
                self._answer_again(stamp)
                return
            if not self.lockstep and self._last - stamp < NANOSECONDS:
                return  # duplicate or out of order
            self._restart()
        if self._last is not None and self._is_silence(stamp - self._last):
            self._forgotten = self._used
        self._received, self._last = self.elapsed(), stamp
        reason = self._judge(message, stamp, now)
        if reason is StopReason.NONE:
            self._follower.advance(stamp, self._position)
            reference = self._follower.reference.position
            reason = self._watchdog.check_motion(stamp, reference, self._position, self._measured)
        if reason is StopReason.NONE and not self._answer(stamp):
            reason = StopReason.UNUSABLE
        if reason is not StopReason.NONE:
            self._stop(reason)
            return
        if self._reason is not None:
            self._reason = None
            self.get_logger().info('following the path')
        self._command_out.publish(self._command.at(stamp))
        self._reference_out.publish(self._reference.at(stamp))
        self._previous = stamp
        self._report(stamp)

    def _is_usable(self, message: StateEstimate, stamp: int) -> bool:
        """Whether an estimate can be one of the observer's; others are counted and ignored."""
        fields = _fields(message)
        if not all_sized(self._estimate.shape[1], *fields):
            self._refusals.add('estimate with another number of joints than the arm')
            return False
        self._bytes[:] = b''.join(fields)
        wrong = check_values(self._estimate)
        if wrong:
            self._refusals.add(_REFUSALS[wrong])
        elif stamp < 0:
            self._refusals.add('estimate with a negative stamp')
        elif not (self.lockstep or self._stamps.accept(stamp)):
            self._refusals.add('estimate whose stamp fits no stream')
        else:
            if self._endless.any():
                self._keep_turns()
            return True
        return False

    def _keep_turns(self) -> None:
        """An observer that is restarted counts turns of endless joints anew: none of the arm's."""
        if self._last is not None:
            turns = np.round((self._place - self._measured) / (2.0 * np.pi))
            self._estimate[:3] += 2.0 * np.pi * turns * self._endless  # all positions of `ROWS`
        self._place[:] = self._measured

    def _judge(self, message: StateEstimate, stamp: int, now: int) -> StopReason:
        """Why an estimate must not be followed."""
        self._latency = 0 if self.lockstep else now - stamp
        reason = self._watchdog.check_estimate(
            stamp,
            self._latency if self._is_of_our_clock() else 0,
            message.mode,
            message.trustworthy,
            self._velocity,
            self._measured_velocity,
        )
        if reason is StopReason.NONE and self._has_lost_a_correction():
            reason = StopReason.CORRECTION_LOST
            self._watchdog.latched = int(reason)
        # A node that was held up itself has seen no silence: the drives have braked meanwhile.
        silent = self._previous is not None and self._is_silence(stamp - self._previous)
        return StopReason.SILENCE if silent and reason is StopReason.NONE else reason

    def _is_of_our_clock(self) -> bool:
        return abs(self._latency) < _OTHER_CLOCK

    def _has_lost_a_correction(self) -> bool:
        """Whether a correction from before a silence is gone: the observer was restarted.

        The correction of the first estimate that is trusted is compared; a loop that is closed on
        the readings has none.
        """
        before, self._forgotten = self._forgotten, None
        self._used = self._measured - self._corrected
        return (
            before is not None
            and self._compensation != 'off'
            and bool(
                np.any((abs(before) > SMALL * self._scales) & (abs(self._used) < 0.5 * abs(before)))
            )
        )

    def _restart(self) -> None:
        """Time has restarted, and so does the path."""
        self._forget()
        self._follower.reset()
        latched = self._watchdog.latched
        self._watchdog = TrackerWatchdog(self._arm, self._limits)
        self._watchdog.latched = latched

    def _forget(self) -> None:
        self._controller.reset()
        self._correction.restart()
        self._follower.stop()
        self._watchdog.note_stop()
        self._previous = None

    def _answer_again(self, stamp: int) -> None:
        """The same estimate again: a restarted node missed the answer."""
        self._command_out.publish(self._command.at(stamp))
        if not self._safe_stop[0]:
            self._reference_out.publish(self._reference.at(stamp))

    def _answer(self, stamp: int) -> bool:
        """Compute the torques; False if they are not finite."""
        self._correction.take(stamp, self._position, self._velocity)
        position, velocity = self._correction.position, self._correction.velocity
        integrated = self._measured if self._controller.integrates_measurement else position
        interval = 0.0 if self._previous is None else (stamp - self._previous) / NANOSECONDS
        self._controller.answer(self._follower.motion, position, velocity, integrated, interval)
        self._torque[:], self._safe_stop[0] = self._controller.torque, False
        return all_finite(self._torque)

    def _check_silence(self) -> None:
        """Stop safely when the observer is silent: the drives then brake."""
        now = self.elapsed()
        self._received = min(self._received, now)  # /clock may have been set back
        silent = now - self._received
        is_told = self._reason is StopReason.SILENCE or self._watchdog.latched
        # Once stopped for another reason, an observer that is merely late is not called silent.
        known = self._reason is None or silent > QUIET * NANOSECONDS
        if not is_told and known and self._is_silence(silent):
            self._stop(StopReason.SILENCE)
        elif self._last is not None:
            self._report(self._last + silent)
        else:
            self._report(self.get_clock().now().nanoseconds)

    def _is_silence(self, interval: int) -> bool:
        return not self.lockstep and interval > self._watchdog.silence

    def _stop(self, reason: StopReason) -> None:
        """Command a safe stop, which answers the last estimate; say why if that is new."""
        self._forget()
        stamp = self._last if self._last is not None else 0
        if reason is not self._reason:
            self._reason, self._stops = reason, self._stops + 1
            self._last_stop = self._stop_text()
            self.get_logger().error(f'safe stop: {self._last_stop}')
        self._torque[:], self._safe_stop[0] = 0.0, True
        self._command_out.publish(self._command.at(stamp))
        self._report(stamp)

    def _stop_text(self) -> str:
        text = (self._reason or StopReason.NONE).text
        return f'{text}; stays until ~/resume is called' if self._watchdog.latched else text

    def _report(self, stamp: int) -> None:
        if self._reason is not None:
            status = ERROR, f'safe stop: {self._stop_text()}'
        elif self._refusals.is_recent:
            status = WARN, 'following the path; messages are refused'
        else:
            status = OK, 'following the path'
        self._status.report(stamp, *status, self._status_values)

    def _status_values(self) -> dict[str, object]:
        latency = f'{self._latency * 1e-6:.1f}' if self._is_of_our_clock() else _UNKNOWN_LATENCY
        return {
            'safe stops': self._stops,
            'last safe stop': self._last_stop,
            'latency [ms]': latency,
            'tolerated constant latency [ms]': f'{self._tolerated * 1e3:.1f}',
            'certificate of the loop': self._certificate,
            **self._refusals.counts,
        }

    @served
    def _on_resume(self, _request: Trigger.Request, _response: Trigger.Response) -> str:
        latched, self._watchdog.latched, self._forgotten = self._watchdog.latched, 0, None
        return 'the arm resumes' if latched else 'nothing was latched'


_fields = attrgetter(*ROWS)
"""Values of a StateEstimate, in the order of `ROWS`."""
