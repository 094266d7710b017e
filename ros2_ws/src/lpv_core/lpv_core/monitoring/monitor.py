"""Observer and diagnosis together, measurement by measurement: what the UIO node and a replay run.

Everything that decides on content is here and not in the node, so that a replay of a recorded
bag gives the very bytes that the node published.  The node takes measurements one by one, a replay
many at a time; both run `monitor_step`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import (
    ALARM_EVENT,
    DIAGNOSIS_CONSTANTS,
    DIAGNOSIS_STATE,
    Alarm,
    DiagnosisParameters,
    SensorState,
    diagnose,
    diagnosis_buffers,
    diagnosis_constants,
    make_alarm,
    reset_diagnosis,
)
from lpv_core.decision.sensor_decision import NOTHING
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joint_order import JointOrder
from lpv_core.model.joints import joint_angle
from lpv_core.monitoring import message_fields
from lpv_core.monitoring.answers import LONGEST_STALE, Answer, Answers, answer_type
from lpv_core.observer.sampled_observer import (
    COUNTERS,
    ESTIMATE,
    OBSERVER_CONSTANTS,
    OBSERVER_STATE,
    Counters,
    Mode,
    counters,
    observe,
    observer_constants,
    reset_observer,
)
from lpv_core.residual.noise_estimation import excess
from lpv_core.residual.rate_independence import RATE_SOURCES, UNDECIDED, contradicts, rate_source_of
from lpv_core.residual.sample_buffer import RATE, READING, SampleBuffer, buffer_of
from lpv_core.support.errors import SampleError
from lpv_core.support.jit import njit
from lpv_core.support.records import memory, new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_REPORT_INTERVAL = NANOSECONDS
"""A diagnostics report is due after each such time of the data [ns], and at every alarm event."""
_STALE, _NO_ESTIMATE = int(Mode.STALE), int(Mode.NO_ESTIMATE)
_SENSOR_STALE = int(SensorState.STALE)

__all__ = ['ANSWER', 'Answer', 'Answers', 'SensorMonitor', 'monitor_step']

MONITOR_CONSTANTS = record_type(
    ('observer', OBSERVER_CONSTANTS), ('diagnosis', DIAGNOSIS_CONSTANTS)
)
MONITOR_STATE = record_type(
    ('observer', OBSERVER_STATE),
    ('estimate', ESTIMATE),
    ('diagnosis', DIAGNOSIS_STATE),
    ('has_estimate', '?'),
    ('next_report', 'i8'),  # [ns]
    ('rates', 'u1', (2,)),  # what rates are, of `lpv_core.residual.rate_independence`
)

ANSWER = answer_type(2)
"""What one measurement leads to."""
_REPORT = record_type(
    ('row', 'i8'),  # of the measurement
    ('answer', ANSWER),
    ('counters', COUNTERS),
    ('unsupported', '?'),  # the arm rests, and the measured torques do not hold it
    ('reading_noise', 'f8', (2,)),  # over what the arm file states, 1 if that is not less
    ('rate_noise', 'f8', (2,)),  # the same of the rates
    ('rates', 'u1', (2,)),  # what rates are, of `lpv_core.residual.rate_independence`
)
_EVENT = record_type(
    ('row', 'i8'),  # of the measurement
    ('event', ALARM_EVENT),
)
_BUFFER = 64
"""Events and reports that are passed at a time."""
_TESTED = 500
"""Samples in which it is tested whether rates come from the positions."""


class _Measurements(NamedTuple):
    """Measurements in a row, as `SensorMonitor.take_many` gets them."""

    stamp: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


class _Results(NamedTuple):
    """What measurements lead to, and how much of it there is."""

    answers: np.ndarray
    events: np.ndarray
    reports: np.ndarray
    found: np.ndarray
    """Number of events and of reports."""


@njit
def monitor_step(
    params: np.record,
    state: np.record,
    buffers: SampleBuffer,
    answer: np.record,
    stamp: int,
    position: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
) -> None:
    """Use one measurement.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    buffers : SampleBuffer
        `lpv_core.decision.diagnosis.diagnosis_buffers`.
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
        forget_estimate(state, buffers)
    answer.answered, answer.has_events = True, False
    if fresh:
        state.has_estimate = True
        diagnose(params.diagnosis, state.diagnosis, buffers, state.estimate)
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
        if stamp - state.observer.stamp > LONGEST_STALE:
            answer.state.trustworthy = False
    # On the clock of the data: replays then report alike.
    answer.due = answer.has_events or state.next_report == NEVER or stamp >= state.next_report
    if answer.due:
        state.next_report = stamp + _REPORT_INTERVAL
        for i in range(2):
            _test_rates(state, buffer_of(buffers, i), i)


@njit
def _test_rates(state: np.record, buffer: SampleBuffer, i: int) -> None:
    """Test whether the latest rates of a sensor come from its positions; keep what was found."""
    rows = slice(max(0, buffer.used[0] - _TESTED), buffer.used[0])
    source, _ = rate_source_of(
        buffer.stamps[rows], buffer.values[rows, READING], buffer.values[rows, RATE]
    )
    if source != UNDECIDED:
        state.rates[i] = source


@njit
def forget_estimate(state: np.record, buffers: SampleBuffer) -> None:
    """Estimates, alarms and the clock of reports restart."""
    reset_diagnosis(state.diagnosis, buffers)
    state.has_estimate, state.next_report = False, NEVER
    state.rates[:] = UNDECIDED


@njit
def _fill(params: np.record, state: np.record, answer: np.record, mode: int) -> None:
    """Fill the messages' fields of an answer."""
    to, fault, estimate = answer.state, answer.fault, state.estimate
    decision, joints = state.diagnosis.decision, params.observer.recursion.joints
    answer.has_fault, to.mode = state.has_estimate, mode
    answer.inconsistent = state.has_estimate and decision.inconsistent
    if not state.has_estimate:
        for i in range(2):
            to.position[i] = to.velocity[i] = to.compensated_position[i] = 0.0
            to.measured_position[i] = to.measured_velocity[i] = 0.0
        to.trustworthy = False
        return
    healthy_1 = estimate.sensor_position[0] - decision.confirmed_fault[0]
    healthy_2 = estimate.sensor_position[1] - decision.confirmed_fault[1]
    for i in range(2):
        to.position[i], to.velocity[i] = estimate.position[i], estimate.velocity[i]
        to.compensated_position[i] = joint_angle(joints, joints.to_joint, i, healthy_1, healthy_2)
        to.measured_position[i] = estimate.measured_position[i]
        to.measured_velocity[i] = estimate.measured_velocity[i]
        fault.estimate[i], fault.bound[i] = decision.estimate[i], decision.estimate_bound[i]
        fault.threshold[i], fault.alarm[i] = decision.threshold[i], decision.alarm[i]
        fault.state[i] = _SENSOR_STALE if mode == _STALE else decision.state[i]
    to.trustworthy = decision.trustworthy


@njit
def _report(state: np.record, answer: np.record, report: np.record) -> None:
    """Copy what a diagnostics report needs."""
    to = report.answer
    to.state.mode, to.has_fault = answer.state.mode, answer.has_fault
    to.state.trustworthy = answer.state.trustworthy
    to.inconsistent = state.diagnosis.decision.inconsistent
    for i in range(2):
        to.state.compensated_position[i] = answer.state.compensated_position[i]
        to.state.measured_position[i] = answer.state.measured_position[i]
        to.fault.estimate[i], to.fault.bound[i] = answer.fault.estimate[i], answer.fault.bound[i]
        to.fault.threshold[i], to.fault.state[i] = answer.fault.threshold[i], answer.fault.state[i]
        noise = state.diagnosis.sensors[i].noise
        report.reading_noise[i] = excess(noise.reading, noise.windows)
        report.rate_noise[i] = excess(noise.rate, noise.windows)
        report.rates[i] = state.rates[i]
    report.unsupported = state.estimate.unsupported
    count, now = report.counters, state.observer.counters
    count.duplicates, count.out_of_order = now.duplicates, now.out_of_order
    count.restarts, count.gaps, count.late_steps = now.restarts, now.gaps, now.late_steps
    count.not_finite, count.implausible = now.not_finite, now.implausible


@njit
def _steps(
    params: np.record,
    state: np.record,
    buffers: SampleBuffer,
    measured: _Measurements,
    first: int,
    results: _Results,
) -> int:
    """`monitor_step` from row ``first`` on, as far as events and reports find room."""
    answers, events, reports, found = results
    found[:] = 0
    for k in range(first, len(measured.stamp)):
        if found[0] + 2 > len(events) or found[1] == len(reports):
            return k
        answer = answers[k]
        monitor_step(
            params,
            state,
            buffers,
            answer,
            measured.stamp[k],
            measured.position[k],
            measured.velocity[k],
            measured.effort[k],
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
    return len(measured.stamp)


@njit
def _take(
    params: np.ndarray,
    state: np.ndarray,
    buffers: SampleBuffer,
    answer: np.ndarray,
    stamp: int,
    measured: np.ndarray,
) -> None:
    """`monitor_step` for Python: with the memory of records, and rows of a measurement."""
    monitor_step(
        params[0], state[0], buffers, answer[0], stamp, measured[0], measured[1], measured[2]
    )


@njit
def copy_event(event: np.record, to: np.record) -> None:
    """Copy an alarm event, of type `lpv_core.decision.diagnosis.ALARM_EVENT`."""
    to.happened, to.sensor, to.onset = event.happened, event.sensor, event.onset
    to.detected, to.amount, to.bound = event.detected, event.amount, event.bound
    to.kind, to.by_change, to.inconsistent = event.kind, event.by_change, event.inconsistent


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
    answer_type : numpy.dtype
        Of a row of `take_many`'s answers.
    needs_rates : bool
        Whether measurements without rates are refused: the observer needs them.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    needs_rates = True

    def __init__(
        self,
        name: str,
        arm: ArmParameters,
        gains: Gains,
        parameters: DiagnosisParameters | None = None,
        max_gap: float = 0.1,
        initial_samples: int = 1,
    ) -> None:
        self.name, self.arm, self._gains = name, arm, gains
        self.method, self.rejected, self.answer_type = gains.observer.method, 0, ANSWER
        self._constants = new_record(
            MONITOR_CONSTANTS, observer=observer_constants(arm, gains, initial_samples, max_gap)
        )
        self._state, self._answer = new_record(MONITOR_STATE), new_record(ANSWER)
        self._buffers = diagnosis_buffers(arm)
        self._memory = (
            memory(self._constants),
            memory(self._state),
            self._buffers,
            memory(self._answer),
        )
        self._measured = np.zeros((3, 2))  # position, rate and torque of a measurement
        self._order = JointOrder(arm.joint_names)
        self.retune(parameters or DiagnosisParameters())
        self.reset()

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running; alarms stay as they are."""
        self._parameters = parameters
        self._constants.diagnosis = diagnosis_constants(self.arm, self._gains, parameters)

    def reset(self) -> None:
        """Forget estimates and alarms; counters stay."""
        reset_observer(self._state.observer)
        forget_estimate(self._state, self._buffers)
        self._warned: set[tuple[int, str]] = set()

    def warm_up(self) -> None:
        """Compile with two made-up samples, and forget them: the first real ones must not wait."""
        measured = np.array([[0.0, 0.1], [0.0, 0.0], [0.0, 0.0]])
        for stamp in (1, 1 + round(self.arm.sample_time * NANOSECONDS)):
            _take(*self._memory, stamp, measured)
        self.reset()

    @property
    def counters(self) -> Counters:
        """Samples that were not usable as they came."""
        return counters(self._state.observer.counters)

    @property
    def parts(self) -> tuple[np.record, np.record, SampleBuffer, np.record]:
        """What `monitor_step` works on: constants, state, past of both sensors, answer."""
        return self._constants, self._state, self._buffers, self._answer

    def alarms(self, events: Iterable[np.record]) -> list[Alarm]:
        """Alarms of events of type `lpv_core.decision.diagnosis.ALARM_EVENT`."""
        return [make_alarm(event, self.arm, self._parameters) for event in events]

    def take(
        self, stamp: int, message: Any, torque: Sequence[float] | None = None
    ) -> Answer | None:
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
            self._measured[:] = self._order.pick(message, torque)
        except SampleError:
            self.rejected += 1
            raise
        _take(*self._memory, stamp, self._measured)
        # Copied as bytes: NumPy would copy nested records field by field.
        record = np.frombuffer(self._memory[-1].tobytes(), ANSWER)[0]
        if not record['answered']:
            return None
        answer = Answer(stamp, record, self.arm)
        if record['has_events']:
            answer.events = self.alarms(
                event
                for event in self._state.diagnosis.decision.events
                if event.happened != NOTHING
            )
        if record['due']:
            report = self._report_now()
            answer.status = self._status(report)
            answer.warnings = self._new_warnings(report)
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
            One row per measurement.
        """
        given = (np.ascontiguousarray(v, dtype=float) for v in (position, velocity, effort))
        measured = _Measurements(np.ascontiguousarray(stamps, dtype=np.int64), *given)
        answers = np.zeros(len(stamps), ANSWER).view(np.recarray)
        events, reports = (np.zeros(_BUFFER, kind).view(np.recarray) for kind in (_EVENT, _REPORT))
        found, row = np.zeros(2, np.int64), 0
        results = _Results(answers, events, reports, found)
        answered = Answers(
            answers.answered,
            answers.has_fault,
            answers.restarted,
            answers.inconsistent,
            answers.state,
            answers.fault,
            events=[],
            reports=[],
        )
        while row < len(stamps):
            row = _steps(self._constants, self._state, self._buffers, measured, row, results)
            new = events[: found[0]]
            answered.events += zip(new['row'].tolist(), self.alarms(e.event for e in new))
            answered.reports += [(int(r.row), self._status(r)) for r in reports[: found[1]]]
        return answered

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
        return self._status(self._report_now())

    def _report_now(self) -> np.record:
        report = new_record(_REPORT)
        _report(self._state, self._answer, report)
        return report

    def _warnings(self, report: np.record) -> tuple[dict[str, str], ...]:
        """What contradicts the arm file, for each sensor by subject."""
        result: tuple[dict[str, str], ...] = ({}, {})
        for i, (sensor, warnings) in enumerate(zip(self.arm.sensor_names, result)):
            for what, ratio in (
                (sensor, report.reading_noise[i]),
                (f'the rate of {sensor}', report.rate_noise[i]),
            ):
                if ratio > 1.0:
                    warnings[what] = (
                        f'noise of {what} is {ratio:.1f} times what the arm file states'
                    )
            found = RATE_SOURCES[report.rates[i]]
            if contradicts(self.arm.rates, found):
                warnings['rates'] = (
                    f'rates of {sensor} are {found}, the arm file states {self.arm.rates}'
                )
        return result

    def _new_warnings(self, report: np.record) -> list[str]:
        """Warnings on subjects that were not warned of before."""
        found = {
            (i, subject): text
            for i, warnings in enumerate(self._warnings(report))
            for subject, text in warnings.items()
        }
        new = [text for subject, text in found.items() if subject not in self._warned]
        self._warned |= set(found)
        return new

    def _status(self, report: np.record) -> list[dict[str, Any]]:
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
            message_fields.Findings(
                bool(answer.inconsistent), bool(report.unsupported), self._warnings(report)
            ),
            values,
        )
