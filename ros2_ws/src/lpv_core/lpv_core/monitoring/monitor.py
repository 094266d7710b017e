"""Observer and diagnosis together, measurement by measurement: what the UIO node and a replay run.

Everything that decides on content is here and not in the node, so that a replay of a recorded
bag gives the very bytes that the node published.  The node takes measurements one by one, a replay
many at a time; both run `monitor_step`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from lpv_core.decision.diagnosis import (
    ALARM_EVENT,
    DIAGNOSIS_CONSTANTS,
    DIAGNOSIS_STATE,
    AlarmEvent,
    DiagnosisParameters,
    SensorState,
    diagnose,
    diagnosis_constants,
    diagnosis_history,
    make_alarm,
    reset_diagnosis,
)
from lpv_core.decision.sensor_decision import NOTHING
from lpv_core.model.joint_order import JointOrder
from lpv_core.model.joints import joint_angle
from lpv_core.monitoring import message_fields
from lpv_core.observer.sampled_observer import (
    COUNTERS,
    ESTIMATE,
    NANOSECONDS,
    OBSERVER_CONSTANTS,
    OBSERVER_STATE,
    Mode,
    counters,
    observe,
    observer_constants,
    pair,
    reset_observer,
)
from lpv_core.support.errors import SampleError
from lpv_core.support.jit import njit
from lpv_core.support.records import NEVER, new_record, record_type

_REPORT_INTERVAL = NANOSECONDS
"""A diagnostics report is due after each such time of the data [ns], and at every alarm event."""
_LONGEST_STALE = 50_000_000
"""Time without a usable measurement after which the last estimate is not trustworthy [ns]."""
_STALE, _NO_ESTIMATE = int(Mode.STALE), int(Mode.NO_ESTIMATE)
_SENSOR_STALE = int(SensorState.STALE)

MONITOR_CONSTANTS = record_type(
    ('observer', OBSERVER_CONSTANTS), ('diagnosis', DIAGNOSIS_CONSTANTS)
)
MONITOR_STATE = record_type(
    ('observer', OBSERVER_STATE),
    ('estimate', ESTIMATE),
    ('diagnosis', DIAGNOSIS_STATE),
    ('has_estimate', '?'),
    ('next_report', 'i8'),
)

_STATE = record_type(
    ('position', 'f8', (2,)),
    ('velocity', 'f8', (2,)),
    ('compensated_position', 'f8', (2,)),
    ('measured_position', 'f8', (2,)),
    ('measured_velocity', 'f8', (2,)),
    ('mode', 'u1'),
    ('trustworthy', '?'),
)
_FAULT = record_type(
    ('estimate', 'f8', (2,)),
    ('bound', 'f8', (2,)),
    ('threshold', 'f8', (2,)),
    ('state', 'u1', (2,)),
    ('alarm', 'u1', (2,)),
)
ANSWER = record_type(
    ('answered', '?'),
    ('has_fault', '?'),
    ('restarted', '?'),
    ('has_events', '?'),
    ('due', '?'),
    ('inconsistent', '?'),
    ('state', _STATE),
    ('fault', _FAULT),
)
"""What one measurement leads to.

answered
    False for a sample with an old stamp, which needs no answer.
has_fault
    Whether there is a fault estimate; a state there is always.
restarted
    Time went backwards: observer and alarms started anew.
has_events, due
    Whether alarms changed, and whether a diagnostics report is due.
inconsistent
    Whether rates, torques and model contradict each other.
state, fault
    Fields of lpv_msgs/StateEstimate and lpv_msgs/FaultEstimate.
"""
_REPORT = record_type(
    ('row', 'i8'), ('answer', ANSWER), ('inconsistent', '?'), ('counters', COUNTERS)
)
_EVENT = record_type(('row', 'i8'), ('event', ALARM_EVENT))
_BUFFER = 64
"""Events and reports that are passed at a time."""


@njit
def monitor_step(
    params: np.record,
    state: np.record,
    stamps: np.ndarray,
    values: np.ndarray,
    answer: np.record,
    stamp,
    position,
    velocity,
    effort,
) -> None:
    """Use one measurement.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    stamps, values : ndarray
        `lpv_core.decision.diagnosis.diagnosis_history`.
    answer : numpy.record
        Receives the answer, of type `ANSWER`.
    stamp, position, velocity, effort
        As `lpv_core.observer.sampled_observer.observe`.
    """
    restarts = state.observer.counters.restarts
    fresh = observe(
        params.observer, state.observer, state.estimate, stamp, position, velocity, effort
    )
    answer.restarted = state.observer.counters.restarts > restarts
    if answer.restarted:
        forget_estimate(state)
    answer.answered, answer.has_events = True, False
    if fresh:
        state.has_estimate = True
        diagnose(params.diagnosis, state.diagnosis, stamps, values, state.estimate)
        events = state.diagnosis.decision.events
        answer.has_events = events[0].happened != NOTHING or events[1].happened != NOTHING
        _fill(params, state, answer, state.estimate.mode)
    elif not state.has_estimate:
        _fill(params, state, answer, _NO_ESTIMATE)
    elif state.observer.stamp >= stamp:
        answer.answered = answer.has_fault = answer.due = False
        return
    else:
        # An unusable sample is answered with the last estimate; never with silence.
        _fill(params, state, answer, _STALE)
        if stamp - state.observer.stamp > _LONGEST_STALE:
            answer.state.trustworthy = False
    # On the clock of the data: replays then report alike.
    answer.due = answer.has_events or state.next_report == NEVER or stamp >= state.next_report
    if answer.due:
        state.next_report = stamp + _REPORT_INTERVAL


@njit
def forget_estimate(state) -> None:
    """Estimates, alarms and the clock of reports start anew."""
    reset_diagnosis(state.diagnosis)
    state.has_estimate, state.next_report = False, NEVER


@njit
def _fill(params, s, answer, mode) -> None:
    state, fault, e, d = answer.state, answer.fault, s.estimate, s.diagnosis.decision
    joints = params.observer.recursion.joints
    answer.has_fault, state.mode = s.has_estimate, mode
    answer.inconsistent = s.has_estimate and d.inconsistent
    if not s.has_estimate:
        for i in range(2):
            state.position[i] = state.velocity[i] = state.compensated_position[i] = 0.0
            state.measured_position[i] = state.measured_velocity[i] = 0.0
        state.trustworthy = False
        return
    healthy_1 = e.sensor_position[0] - d.confirmed_fault[0]
    healthy_2 = e.sensor_position[1] - d.confirmed_fault[1]
    for i in range(2):
        state.position[i], state.velocity[i] = e.position[i], e.velocity[i]
        state.compensated_position[i] = joint_angle(
            joints, joints.to_joint, i, healthy_1, healthy_2
        )
        state.measured_position[i] = e.measured_position[i]
        state.measured_velocity[i] = e.measured_velocity[i]
        fault.estimate[i], fault.bound[i] = d.estimate[i], d.estimate_bound[i]
        fault.threshold[i], fault.alarm[i] = d.threshold[i], d.alarm[i]
        fault.state[i] = _SENSOR_STALE if mode == _STALE else d.state[i]
    state.trustworthy = d.trustworthy


@njit
def _report(state, answer, report) -> None:
    report.answer.state.mode, report.answer.has_fault = answer.state.mode, answer.has_fault
    report.answer.state.trustworthy = answer.state.trustworthy
    report.inconsistent = state.diagnosis.decision.inconsistent
    for i in range(2):
        report.answer.fault.estimate[i] = answer.fault.estimate[i]
        report.answer.fault.bound[i] = answer.fault.bound[i]
        report.answer.fault.threshold[i] = answer.fault.threshold[i]
        report.answer.fault.state[i] = answer.fault.state[i]
    to, now = report.counters, state.observer.counters
    to.duplicates, to.out_of_order, to.restarts = now.duplicates, now.out_of_order, now.restarts
    to.not_finite, to.implausible = now.not_finite, now.implausible
    to.gaps, to.late_steps = now.gaps, now.late_steps


@njit
def _steps(
    params,
    state,
    stamps,
    values,
    answered,
    first,
    stamp,
    position,
    velocity,
    effort,
    events,
    reports,
    found,
):
    """`monitor_step` from row ``first`` on, as far as events and reports find room."""
    found[:] = 0
    for k in range(first, len(stamp)):
        if found[0] + 2 > len(events) or found[1] == len(reports):
            return k
        answer = answered[k]
        monitor_step(
            params, state, stamps, values, answer, stamp[k], position[k], velocity[k], effort[k]
        )
        if answer.has_events:
            for i in range(2):
                event = state.diagnosis.decision.events[i]
                if event.happened != NOTHING:
                    copy_event(event, events[found[0]].event)
                    events[found[0]].row = k
                    found[0] += 1
        if answer.due:
            reports[found[1]].row = k
            _report(state, answer, reports[found[1]])
            found[1] += 1
    return len(stamp)


@njit
def copy_event(event, to) -> None:
    """Copy an alarm event, of type `lpv_core.decision.diagnosis.ALARM_EVENT`."""
    to.happened, to.sensor, to.onset = event.happened, event.sensor, event.onset
    to.detected, to.amount, to.bound = event.detected, event.amount, event.bound
    to.kind, to.by_change, to.inconsistent = event.kind, event.by_change, event.inconsistent


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
    inconsistent : bool
        Rates, torques and model contradict each other.
    """

    stamp: int
    state: dict = None
    fault: dict = None
    alarms: list = field(default_factory=list)
    status: list = None
    events: list = field(default_factory=list)
    restarted: bool = False
    inconsistent: bool = False


@dataclass
class Answers:
    """What many measurements lead to, one row a measurement.

    Attributes
    ----------
    answered, has_fault, restarted, inconsistent : ndarray of bool, shape (n,)
        As in `ANSWER`.
    state, fault : numpy.recarray, shape (n,)
        Fields of lpv_msgs/StateEstimate and lpv_msgs/FaultEstimate as attributes, one row each.
    events : list of tuple
        Row and `Alarm` of each alarm event.
    reports : list of tuple
        Row and diagnostic_msgs/DiagnosticArray's statuses of each report that is due.
    """

    answered: np.ndarray
    has_fault: np.ndarray
    restarted: np.ndarray
    inconsistent: np.ndarray
    state: np.recarray
    fault: np.recarray
    events: list
    reports: list


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

    Attributes
    ----------
    rejected : int
        Messages that did not fit the arm.
    method : str
        Of the observer.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    def __init__(
        self,
        name: str,
        arm,
        gains,
        parameters: DiagnosisParameters | None = None,
        max_gap: float = 0.1,
        initial_samples: int = 1,
    ) -> None:
        self.name, self.arm, self._gains = name, arm, gains
        self.method, self.rejected = gains.observer.method, 0
        self._constants = new_record(
            MONITOR_CONSTANTS, observer=observer_constants(arm, gains, initial_samples, max_gap)
        )
        self._state, self._answer = new_record(MONITOR_STATE), new_record(ANSWER)
        self._history = diagnosis_history(arm)
        self._order = JointOrder(arm.joint_names)
        self.retune(parameters or DiagnosisParameters())
        self.reset()

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running; alarms stay as they are.

        Parameters
        ----------
        parameters : DiagnosisParameters
            The new tuning.
        """
        self._parameters = parameters
        self._constants.diagnosis = diagnosis_constants(self.arm, self._gains, parameters)

    def reset(self) -> None:
        """Forget estimates and alarms; counters stay."""
        reset_observer(self._state.observer)
        forget_estimate(self._state)

    def warm_up(self) -> None:
        """Compile by two made-up samples, and forget them: the first real ones must not wait."""
        still = np.zeros(2)
        for stamp in (1, 1 + round(self.arm.sample_time * NANOSECONDS)):
            self._step(stamp, np.array([0.0, 0.1]), still, still)
        self.reset()

    @property
    def counters(self):
        """Samples that were not usable as they came: `lpv_core.observer.sampled_observer.Counters`."""
        return counters(self._state.observer.counters)

    @property
    def parts(self):
        """What `monitor_step` works on: constants, state, past of both sensors, answer."""
        return (self._constants, self._state, *self._history, self._answer)

    def alarms(self, events: Iterable[np.record]):
        """Alarms of events.

        Parameters
        ----------
        events : iterable of numpy.record
            Of type `lpv_core.decision.diagnosis.ALARM_EVENT`.

        Returns
        -------
        list of Alarm
            In the same order.
        """
        return [make_alarm(event, self.arm, self._parameters) for event in events]

    def _step(self, stamp, position, velocity, effort) -> None:
        monitor_step(*self.parts, stamp, position, velocity, effort)

    def take(self, stamp: int, message, torque: Sequence[float] | None = None) -> Answer | None:
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
        try:
            position, velocity, effort = self._order.pick(message)
            effort = pair(effort if torque is None else torque, 'torque')
        except SampleError:
            self.rejected += 1
            raise
        self._step(stamp, pair(position, 'position'), pair(velocity, 'velocity'), effort)
        now = self._answer
        if not now.answered:
            return None
        answer = Answer(
            stamp,
            message_fields.state_fields(now.state),
            restarted=bool(now.restarted),
            inconsistent=bool(now.inconsistent),
        )
        if now.has_fault:
            answer.fault = message_fields.fault_fields(now.fault, self.arm.sensor_names)
        if now.has_events:
            answer.events = self.alarms(
                event
                for event in self._state.diagnosis.decision.events
                if event.happened != NOTHING
            )
            answer.alarms = [message_fields.alarm_fields(event) for event in answer.events]
        if now.due:
            answer.status = self._status_now()
        return answer

    def take_many(
        self, stamps: np.ndarray, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
    ) -> Answers:
        """Use many measurements; the same as `take` one by one.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            Their times [ns].
        position, velocity, effort : ndarray, shape (n, 2)
            Joint positions [rad], rates [rad/s] and torques [N m] in the order of the arm file;
            NaN where there is none.

        Returns
        -------
        Answers
            One row a measurement.
        """
        given = [np.ascontiguousarray(v, dtype=float) for v in (position, velocity, effort)]
        stamps = np.ascontiguousarray(stamps, dtype=np.int64)
        answered = np.zeros(len(stamps), ANSWER).view(np.recarray)
        events, reports = (np.zeros(_BUFFER, kind).view(np.recarray) for kind in (_EVENT, _REPORT))
        found, row = np.zeros(2, np.int64), 0
        result = Answers(
            answered.answered,
            answered.has_fault,
            answered.restarted,
            answered.inconsistent,
            answered.state,
            answered.fault,
            [],
            [],
        )
        while row < len(stamps):
            row = _steps(
                self._constants,
                self._state,
                *self._history,
                answered,
                row,
                stamps,
                *given,
                events,
                reports,
                found,
            )
            new = events[: found[0]]
            result.events += zip(new.row.tolist(), self.alarms(e.event for e in new))
            result.reports += [(int(r.row), self._status(r)) for r in reports[: found[1]]]
        return result

    def stale_fault(self) -> dict[str, Any] | None:
        """Fields of a FaultEstimate that says that its values are the last ones.

        Returns
        -------
        dict or None
            None before the first estimate.
        """
        if not self._state.has_estimate:
            return None
        _fill(self._constants, self._state, self._answer, _STALE)
        return message_fields.fault_fields(self._answer.fault, self.arm.sensor_names)

    def status(self, mode: Mode) -> list[dict[str, Any]]:
        """Statuses for /diagnostics.

        Parameters
        ----------
        mode : Mode
            State of the observer.

        Returns
        -------
        list of dict
            As `lpv_core.monitoring.message_fields.diagnostic_fields`.
        """
        _fill(self._constants, self._state, self._answer, int(mode))
        return self._status_now()

    def _status_now(self):
        report = new_record(_REPORT)
        _report(self._state, self._answer, report)
        return self._status(report)

    def _status(self, report):
        values = {
            **asdict(counters(report.counters)),
            'rejected messages': self.rejected,
            'method': self.method,
        }
        answer = report.answer
        return message_fields.diagnostic_fields(
            self.name,
            self.arm,
            answer.state,
            answer.fault if answer.has_fault else None,
            bool(report.inconsistent),
            values,
        )


def describe(event) -> str:
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
    words = {
        AlarmEvent.RAISED: 'ALARM',
        AlarmEvent.UPDATED: 'alarm updated',
        AlarmEvent.CLEARED: 'alarm cleared',
    }
    return (
        f'{words[event.event]}, {event.sensor}: {event.kind}, {event.size:+.3f} rad within '
        f'{event.bound:.3f} rad, confidence {event.confidence:.3f}'
    )
