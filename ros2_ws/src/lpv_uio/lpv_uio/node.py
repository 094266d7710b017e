"""UIO node: state and fault estimates, alarms and diagnostics from joint measurements."""

import math
from collections import deque
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from lpv.core.monitoring.alarm_text import count_texts, describe, unusable_text
from lpv.core.monitoring.answers import Answer
from lpv.core.monitoring.message_fields import ERROR, OK, WARN, alarm_fields
from lpv.core.monitoring.parameters import DIAGNOSIS, SAMPLING, DiagnosisParameters, check_names
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, Mode
from lpv.core.support.errors import SampleError
from lpv.core.support.jit import on_compile
from lpv.core.support.limits import MAX_DELAY, PATIENCE, STALE_AFTER
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.unknown_input_observer import CHOICES
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate, TorqueCommand
from lpv_node.input_check import OneSender, Refusals, all_finite, all_sized
from lpv_node.managed import ManagedNode, served
from lpv_node.parameters import declare_given, named_file, read_gains, table
from lpv_node.qos import latched, stream
from lpv_node.status import StatusReporter, diagnostics
from lpv_uio.messages import OutputMessages
from lpv_uio.open_alarms import OpenAlarms, alarm_file

TUNABLE = tuple(one._replace(name=f'diagnosis.{one.name}') for one in DIAGNOSIS)
SPECS = (
    *table(f"""
arm_file FILE            arm file (YAML), or name of a shipped arm
torque_source {{effort,command}}  where torques come from: the effort of joint_states, or the latest
                         torque_command
stale_after={STALE_AFTER}[0.01:60]  real time only: time without a measurement that can be
                         used after which the diagnosis is stale [s]
observer {{{','.join(CHOICES)}}}  whose estimate of the faults is published, where gains are given:
                         that of the smaller bound, or one of the observers alone
"""),
    *SAMPLING,
)
_COMPILING = 'compiling the observer: the first start after an installation takes up to a minute'
_SILENT = 'no new measurement that fits the arm'
_MISFIT = 'measurement that does not fit the arm'
_PARTIAL = 'measurement without all joints of the arm'
_NOT_ESTIMATED = int(Mode.STALE)
"""From this mode on there is nothing to correct."""


class UioNode(ManagedNode):
    """Unknown-input observer and diagnosis.

    Topics: subscribes ``joint_states`` (and ``torque_command`` if torques come from there);
    publishes ``state_estimate``, ``fault_estimate``, ``joint_states_corrected``, ``fault_alarm``
    (latched) and ``/diagnostics``.  Service: ``~/reset``.

    In real time, where several nodes publish measurements, one of them is believed; and an observer
    that is started again after it died is not trustworthy until it has found the faults again that
    were confirmed before, or ``~/reset`` is called.
    """

    def __init__(self) -> None:
        super().__init__('uio', SPECS, TUNABLE)
        # Nobody else has such parameters: a misspelt one would be left out in silence.
        parts = (name.partition('.') for name in self._parameter_overrides)
        check_names([name for place, _, name in parts if place == 'diagnosis'], self.get_name())
        self._alarms: OpenAlarms | None = None
        declare_given(self, 'gains')
        self._measurement_in: Subscription | None = None
        self.add_post_set_parameters_callback(self._retune)

    def setup(self) -> None:
        """Read arm and gains, create publishers."""
        self._arm = load_arm(named_file(self, 'arm_file', 'arms'))
        with on_compile(self._say_compiling):
            self._monitor = self._make_monitor()
            self._monitor.warm_up()
            self._monitor.warm_up_faults()
        self._messages = OutputMessages(self._arm, self._monitor.answer_type)
        self._from_command = self.get_parameter('torque_source').value == 'command'
        self._unknown = [math.nan] * len(self._arm.joint_names)
        self._torque = self._unknown
        self._commanded: int | None = None  # stamp that the last command answers [ns]
        # Steady times, see `elapsed`.
        self._received: int | None = None  # about when the last measurement came that was used [ns]
        self._is_new = False  # whether one came since the last look for silence
        self._used: int | None = None  # its stamp; the first that is answered counts, too [ns]
        self._unused = 0  # measurements since then
        self._ahead = 0  # the node's clock of the driver's, about [ns]
        self._answered: int | None = None  # stamp of the last answer [ns]
        self._silent_since: int | None = None  # time of the last report, or of the silence [ns]
        self._silence_reports = 0
        self._stale = False
        self._refusals, self._sender = Refusals(self), OneSender(self._arm)
        self._alarms = None if self.lockstep else OpenAlarms(alarm_file(self))
        if self._alarms is not None and self._alarms.before:
            self.get_logger().error(self._untrusted_text())
        self._recent: deque[int] = deque(maxlen=MAX_DELAY)
        qos = stream(self.lockstep)
        self._state_out = self.create_publisher(StateEstimate, 'state_estimate', qos)
        self._fault_out = self.create_publisher(FaultEstimate, 'fault_estimate', qos)
        self._corrected_out = self.create_publisher(
            JointState, 'joint_states_corrected', stream(self.lockstep, reliable=True)
        )
        self._alarm_out = self.create_publisher(FaultAlarm, 'fault_alarm', latched())
        self._diagnostics_out = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._status = StatusReporter(self, 'measurements', self._arm.name)
        self.create_service(Trigger, '~/reset', self._on_reset)

    def _say_compiling(self, _function: str) -> None:
        self.get_logger().info(_COMPILING, once=True)

    def _make_monitor(self) -> SerialSensorMonitor:
        """Observers and diagnosis of the arm."""
        gains = read_gains(self, self._arm, Gains)
        if gains is None and self._arm.lpv is not None:
            self.get_logger().warning('no gains file is given: the moving horizon observes alone')
        return SerialSensorMonitor(
            self.get_fully_qualified_name(),
            self._arm,
            self._diagnosis_parameters(),
            gains,
            self.get_parameter('observer').value,
            max_gap=self.get_parameter('max_gap').value,
            initial_samples=self.get_parameter('initial_samples').value,
        )

    def outputs(self) -> dict[Publisher, int]:
        """Publishers to be matched before measurements are taken."""
        return {
            self._state_out: 1,
            self._fault_out: 0,
            self._corrected_out: 0,
            self._diagnostics_out: 0,
        }

    def begin(self) -> None:
        """Subscribe."""
        # The diagnosis needs every sample, also those that come late, many at once, or during a
        # decision; older ones would be stale.
        waiting = round(STALE_AFTER / self._arm.sample_time)
        qos = stream(self.lockstep, max(waiting, MAX_DELAY))
        self._measurement_in = self.create_subscription(
            JointState, 'joint_states', self._on_measurement, qos
        )
        if self._from_command:
            qos = stream(self.lockstep)
            self.create_subscription(TorqueCommand, 'torque_command', self._on_command, qos)
        if not self.lockstep:
            self.steady_timer(0.1, self._check_silence)
        self.get_logger().info(f'observing {self._arm.name!r} with method {self._monitor.method!r}')

    def stopping(self) -> None:
        """Told to stop: who starts it again knows what for."""
        if self._alarms is not None:
            self._alarms.forget()

    def _on_command(self, message: TorqueCommand) -> None:
        if not all_sized(len(self._arm.joint_names), message.torque):
            self._refusals.add('command with another number of joints than the arm')
        elif not all_finite(message.torque):
            self._refusals.add('command with values that are not finite')
        elif to_nanoseconds(message.header.stamp) not in self._recent:
            self._refusals.add('command whose stamp answers no measurement')
        else:
            # At a safe stop it is the brakes that hold the arm.
            self._torque = self._unknown if message.safe_stop else message.torque
            self._commanded = to_nanoseconds(message.header.stamp)

    def _on_measurement(self, message: JointState) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        if self.lockstep and self._answered is not None and stamp <= self._answered:
            if stamp == self._answered:
                self._publish_estimates(stamp)  # a restarted node missed it
                return
            # Nothing overtakes here: the simulator was restarted, however short its run was.
            self.get_logger().warning('lockstep was restarted: observer and alarms restart')
            self._monitor.reset()
        elif not self.lockstep and not self._is_of_one_sender(message, stamp):
            return
        self._recent.append(stamp)
        try:
            answer = self._monitor.take(stamp, message, self._known_torque())
        except SampleError as error:
            there = len({*self._arm.joint_names}.intersection(message.name))
            # Others may share the topic, a gripper or another arm, and be heard first.
            waits = bool(message.name) and not (self.lockstep or self._silence_reports)
            if there or (self._answered is None and not waits):
                topic = self.resolve_topic_name('joint_states')
                self.get_logger().error(f'{topic}: {error}', throttle_duration_sec=5.0)
                is_part = 0 < there < len(self._arm.joint_names)
                self._refusals.add(_PARTIAL if is_part else _MISFIT)
            return
        self._note_use(answer)
        if answer is not None:
            self._publish(answer)

    def _note_use(self, answer: Answer | None) -> None:
        """Take note of whether a measurement was used."""
        is_used = answer is not None and answer.record['state']['mode'] < _NOT_ESTIMATED
        if answer is None or not (is_used or self._used is None):
            self._unused += 1
            return
        if self._used is None or self._stale:
            self.get_logger().info('measurements flow')
        self._is_new, self._stale, self._used, self._unused = True, False, answer.stamp, 0

    def _known_torque(self) -> Sequence[float] | None:
        """Torques of the last command, NaN where it is old; None: those of the measurement."""
        if not self._from_command:
            return None
        return self._torque if self._commanded in self._recent else self._unknown

    def _is_of_one_sender(self, message: JointState, stamp: int) -> bool:
        """Whether a measurement continues the others, where several nodes publish some."""
        source = self._measurement_in
        publishers = 1 if source is None else source.get_publisher_count()
        if self._sender.accept(stamp, message.name, message.position, publishers):
            return True
        self._refusals.add('measurement of a second publisher of joint_states')
        return False

    def _untrusted_text(self) -> str:
        known = '; '.join(self._alarms.before.values()) if self._alarms else ''
        return (
            'not trustworthy: the observer was started again while faults were confirmed; until '
            f'they are found again, or ~/reset is called: {known}'
        )

    def _publish(self, answer: Answer) -> None:
        self._answered = stamp = answer.stamp
        messages = self._messages
        if answer.restarted:
            self.get_logger().warning(
                'no measurement came for more than 1 s, or their clock was set: balances begin anew'
            )
        if not messages.fill(answer.record):
            self._refusals.add('estimate with values that are not finite')
        if self._alarms is not None and self._alarms.before:
            messages.record['state']['trustworthy'] = False
        self._publish_estimates(stamp)
        for event in answer.events:
            self._alarm_out.publish(messages.alarm(stamp, alarm_fields(event)))
        for event in answer.events:
            self._log(event)
        for warning in answer.warnings:
            self.get_logger().warning(warning)
        if answer.status is not None:
            self._diagnostics_out.publish(diagnostics(stamp, answer.status))

    def _publish_estimates(self, stamp: int) -> None:
        messages = self._messages
        self._state_out.publish(messages.state.at(stamp))
        if messages.record['has_fault'][0]:
            self._fault_out.publish(messages.fault.at(stamp))
        if messages.record['state']['mode'][0] < _NOT_ESTIMATED:
            self._corrected_out.publish(messages.corrected.at(stamp))

    def _log(self, event: Alarm) -> None:
        if event.event == AlarmEvent.RAISED:
            self.get_logger().error(describe(event))
        else:
            self.get_logger().info(describe(event))
        if self._alarms is not None:
            try:
                self._alarms.note(event)
            except OSError as error:
                self.get_logger().warning(
                    f'alarms would not outlive this process: {error}', once=True
                )

    def _check_silence(self) -> None:
        now = self.get_clock().now().nanoseconds
        self._report(now)
        elapsed = self.elapsed()
        if self._is_new:
            self._received, self._silent_since, self._is_new = elapsed, None, False
            self._silence_reports = 0
            self._ahead = now - (self._used or 0)
        if self._received is None or self._stale:
            self._warn_of_silence(now, elapsed)
            return
        self._received = min(self._received, elapsed)  # /clock may have been set back
        if elapsed - self._received > self.get_parameter('stale_after').value * NANOSECONDS:
            self._stale = True
            self.get_logger().warning(
                f'diagnosis is stale: {self._unusable_text() or "no measurements"}'
            )
            stamp = self._publish_stale(now)
            fault = self._monitor.stale_fault()
            if fault is not None:
                self._messages.record['fault'] = fault
                self._messages.degrade()
                self._fault_out.publish(self._messages.fault.at(stamp))

    def _unusable_text(self) -> str:
        """What is wrong with the measurements; empty where none comes."""
        return unusable_text(self._monitor.counters) if self._unused else ''

    def _publish_stale(self, now: int) -> int:
        """Say on /diagnostics that the diagnosis is stale; the stamp that this has [ns]."""
        # By the driver's clock, which may be another one.
        stamp = max(now - self._ahead, (self._used or 0) + 1)
        status = self._monitor.status(Mode.STALE, self._unusable_text())
        self._diagnostics_out.publish(diagnostics(stamp, status))
        return stamp

    def _report(self, now: int) -> None:
        """Say on /diagnostics who publishes measurements, and what was known before this start."""
        senders, others = self.get_publishers_info_by_topic('joint_states'), self._sender.others()
        # Others that have just left are still counted.
        own = max(len(senders) - others, min(len(senders), self._sender.is_heard))
        level, text = (OK, 'one publisher') if own > 0 else (WARN, 'no publisher')
        text += f', and {others} of other joints' if others else ''
        if own > 1:
            names = sorted(f'{s.node_namespace.rstrip("/")}/{s.node_name}' for s in senders)
            level, text = WARN, f'{len(senders)} publishers of joint_states: {", ".join(names)}'
        if self._refusals.is_recent:
            level, text = WARN, f'{text}; messages are refused: {self._refusals.last}'
        elif self._silence_reports and own > 0:
            level, text = WARN, f'{text}; {_SILENT}'
        if self._alarms is not None and self._alarms.before:
            level, text = ERROR, self._untrusted_text()
        self._status.report(now, level, text, lambda: self._refusals.counts)

    def _warn_of_silence(self, now: int, elapsed: int) -> None:
        """Say that no measurement comes, and whether anybody publishes any.

        On /diagnostics every few seconds, in the log ever more seldom: an observer may wait for
        days for a driver that is off.
        """
        if self._silent_since is None:
            self._silent_since = elapsed
        self._silent_since = min(self._silent_since, elapsed)  # /clock may have been set back
        if elapsed - self._silent_since < PATIENCE * NANOSECONDS:
            return
        self._silent_since = elapsed
        if self._stale:
            self._publish_stale(now)
        self._silence_reports += 1
        if self._silence_reports.bit_count() > 1:  # its 1st, 2nd, 4th, 8th, ... is logged
            return
        topic = self.resolve_topic_name('joint_states')
        text = f'{_SILENT} on {topic}, publishers: '
        text += str(self.count_publishers('joint_states'))
        self.get_logger().warning('; '.join([text, *count_texts(self._monitor.counters)]))

    @served
    def _on_reset(self, _request: Trigger.Request, _response: Trigger.Response) -> str:
        self._monitor.reset()
        if self._alarms is not None:
            self._alarms.forget()
        return 'observer and alarms restart'

    def _diagnosis_parameters(self) -> DiagnosisParameters:
        values = {one.name: self.get_parameter(one.name).value for one in TUNABLE}
        return DiagnosisParameters(**{k.partition('.')[2]: v for k, v in values.items()})

    def _retune(self, parameters: list[Parameter]) -> None:
        if any(p.name.startswith('diagnosis.') for p in parameters) and hasattr(self, '_monitor'):
            self._monitor.retune(self._diagnosis_parameters())
