"""Observer and diagnosis together, measurement by measurement: what the UIO node and a replay run.

Everything that decides on content is here and not in the node, so that a replay of a recorded
bag gives the very bytes that the node published.
"""

from dataclasses import asdict, dataclass, field

from lpv_core import answers
from lpv_core.diagnosis import AlarmEvent, Diagnoser, SensorState
from lpv_core.errors import SampleError
from lpv_core.joint_order import JointOrder
from lpv_core.observer import NANOSECONDS, Mode, UnknownInputObserver

_REPORT_INTERVAL = NANOSECONDS
"""A diagnostics report is due after each such time of the data [ns], and at every alarm event."""


@dataclass
class Answer:
    """What one measurement leads to; each entry holds the fields of one message.

    Attributes
    ----------
    stamp : int
        Of the measurement [ns]; of every message, too.
    state, fault : dict or None
        lpv_msgs/StateEstimate and lpv_msgs/FaultEstimate.
    alarms : list of dict
        lpv_msgs/FaultAlarm.
    status : list of dict or None
        diagnostic_msgs/DiagnosticArray's statuses where a report is due.
    events : list of Alarm
        The alarm events themselves.
    restarted : bool
        Time went backwards: observer and alarms started anew.
    """

    stamp: int
    state: dict = None
    fault: dict = None
    alarms: list = field(default_factory=list)
    status: list = None
    events: list = field(default_factory=list)
    restarted: bool = False


class SensorMonitor:
    """Diagnosis of one arm's position sensors.

    Parameters
    ----------
    name : str
        Name in diagnostics: the node's fully qualified name.
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    max_gap : float, optional
        Longest interval that is integrated [s].
    initial_samples : int, optional
        Samples that the start value is averaged over.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    def __init__(self, name, arm, gains, parameters=None, max_gap=0.1, initial_samples=1):
        self.name, self.arm = name, arm
        self.observer = UnknownInputObserver(arm, gains, initial_samples, max_gap)
        self.diagnoser = Diagnoser(arm, gains, parameters)
        self._order = JointOrder(arm.joint_names)
        self._estimate = self._diagnosis = self._next_report = None
        self.rejected = 0

    def reset(self):
        """Forget estimates and alarms; counters stay."""
        self.observer.reset()
        self.diagnoser.reset()
        self._estimate = self._diagnosis = self._next_report = None

    def warm_up(self):
        """Compile by two made-up samples, and forget them: the first real ones must not wait."""
        for stamp in (1, 1 + round(self.arm.sample_time * NANOSECONDS)):
            estimate = self.observer.update(stamp, [0.0, 0.1], [0.0, 0.0], [0.0, 0.0])
            self.diagnoser.update(estimate)
        self.reset()

    def take(self, stamp, message, torque=None):
        """Use one measurement.

        Parameters
        ----------
        stamp : int
            Its time [ns].
        message : sensor_msgs/JointState
            The measurement; any object with its fields.
        torque : sequence of two floats, optional
            Joint torques in place of the message's effort [N m].

        Returns
        -------
        Answer or None
            None for a sample with an old stamp, which needs no answer.

        Raises
        ------
        SampleError
            If joints are unknown or sizes are wrong; it is counted.
        """
        restarts = self.observer.counters.restarts
        try:
            position, velocity, effort = self._order.pick(message)
            estimate = self.observer.update(stamp, position, velocity,
                                            effort if torque is None else torque)
        except SampleError:
            self.rejected += 1
            raise
        answer = Answer(stamp)
        if self.observer.counters.restarts > restarts:
            answer.restarted = True
            self.diagnoser.reset()
            self._estimate = self._diagnosis = self._next_report = None
        if estimate is not None:
            self._fresh(answer, estimate)
        elif not self._repeat(answer):
            return None
        return answer

    def _fresh(self, answer, estimate):
        self._estimate = estimate
        self._diagnosis = diagnosis = self.diagnoser.update(estimate)
        answer.events = diagnosis.events
        answer.state = self._state(estimate.mode)
        answer.fault = self._fault(diagnosis.state)
        answer.alarms = [answers.alarm_fields(event) for event in diagnosis.events]
        self._report(answer, estimate.mode)

    def _report(self, answer, mode):
        """Add a status where one is due, on the clock of the data: replays then report alike."""
        due = self._next_report is None or answer.stamp >= self._next_report
        if due or answer.events:
            self._next_report = answer.stamp + _REPORT_INTERVAL
            answer.status = self.status(mode)

    def _repeat(self, answer):
        """Answer an unusable sample with the last estimate, marked stale; never with silence."""
        if self._estimate is None:
            answer.state = self._state(Mode.NO_ESTIMATE)
            self._report(answer, Mode.NO_ESTIMATE)
            return True
        if (self.observer.stamp or 0) >= answer.stamp:
            return False
        answer.state = self._state(Mode.STALE)
        answer.fault = self.stale_fault()
        self._report(answer, Mode.STALE)
        return True

    def _state(self, mode):
        return answers.state_fields(self._estimate, self._diagnosis, mode, self.observer.joints)

    def _fault(self, states):
        return answers.fault_fields(self._estimate, self._diagnosis, states,
                                    self.arm.sensor_names)

    def stale_fault(self):
        """Fields of a FaultEstimate that says that its values are the last ones.

        Returns
        -------
        dict or None
            None before the first estimate.
        """
        return None if self._estimate is None else self._fault([SensorState.STALE] * 2)

    def status(self, mode):
        """Statuses for /diagnostics.

        Parameters
        ----------
        mode : Mode
            State of the observer.

        Returns
        -------
        list of dict
            As `lpv_core.answers.diagnostic_fields`.
        """
        values = {**asdict(self.observer.counters), 'rejected messages': self.rejected,
                  'method': self.observer.method}
        return answers.diagnostic_fields(self.name, self.arm, self._estimate, self._diagnosis,
                                         mode, values)


def describe(event):
    """An alarm event as one line of text.

    Parameters
    ----------
    event : Alarm
        The event.

    Returns
    -------
    str
        Sensor, kind, size, bound and confidence.
    """
    words = {AlarmEvent.RAISED: 'ALARM', AlarmEvent.UPDATED: 'alarm updated',
             AlarmEvent.CLEARED: 'alarm cleared'}
    return (f'{words[event.event]}, {event.sensor}: {event.kind}, {event.size:+.3f} rad, bound of '
            f'the level {event.bound:.3f} rad, confidence {event.confidence:.3f}')
