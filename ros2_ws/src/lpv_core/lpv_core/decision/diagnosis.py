"""From fault estimates to alarms, to what is compensated, and to whether to go on at all."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.bound.error_bound import (
    BOUND_CONSTANTS,
    BOUND_STATE,
    error_bound,
    reset_bound,
    update_bound,
)
from lpv_core.decision.fault_classification import DROPOUT, INCONSISTENT, KINDS, NOISE, SPIKE
from lpv_core.decision.fault_magnitude import removable, size_error
from lpv_core.decision.sensor_decision import (
    NOTHING,
    decide,
    is_compensable,
    is_unexplained,
    suspected,
)
from lpv_core.decision.sensor_state import (
    SENSOR_CONSTANTS,
    SENSOR_STATE,
    reset_sensor,
    restart_sensor,
)
from lpv_core.model.joints import row_dot
from lpv_core.observer.sampled_observer import Mode
from lpv_core.residual.change_detection import change_test, sigmas_for
from lpv_core.residual.dead_reckoning import (
    RECKONING_CONSTANTS,
    RECKONING_STATE,
    dead_reckoning,
    reset_reckoning,
    update_dead_reckoning,
)
from lpv_core.residual.model_consistency import (
    CONSISTENCY_CONSTANTS,
    CONSISTENCY_STATE,
    consistency_test,
    is_inconsistent,
    reset_consistency,
)
from lpv_core.residual.rate_sensor_test import rate_test
from lpv_core.residual.sample_buffer import new_history
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_HISTORY = 3.0
"""Past that is kept of each sensor [s]."""


class SensorState(IntEnum):
    """State of a sensor's diagnosis; values as in lpv_msgs/FaultEstimate."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
    NOT_DIAGNOSABLE = 4


class AlarmEvent(IntEnum):
    """Kinds of alarm events; values as in lpv_msgs/FaultAlarm."""

    RAISED = 0
    UPDATED = 1
    CLEARED = 2


@dataclass(frozen=True)
class DiagnosisParameters:
    """Tuning of the decision.

    Attributes
    ----------
    threshold_factor : float
        Threshold over bound; above 1 trades delay against false alarms.
    minimum_threshold : float
        No alarm below this size [rad].
    dwell : float
        How long an estimate must stay above its threshold before the alarm [s].
    clear_dwell : float
        How long it must stay below ``hysteresis`` times the threshold to clear [s].
    hysteresis : float
        Fraction of the threshold at which an alarm may clear.
    sigmas : float
        Multiple of the noise part in the bound.
    friction_uncertainty : float
        Relative uncertainty of Coulomb friction.
    false_alarm_hours : float
        Mean time between false alarms by noise, for the limits of changes [h].
    latch : bool
        Alarms stay until they are reset, even if the fault is over.
    compensation_rate : float
        How fast a compensation without a known step is faded in and out [rad/s].
    safe_stop_bound : float
        A confirmed fault that did not begin with a jump cannot be compensated safely if its size
        and bound together are larger [rad]; a level with a wider bound is no evidence.
    max_ambiguous_change : float
        Largest change of unknown cause with which the arm goes on [rad]: if it is the position
        sensor after all, the arm is off its path by as much.
    """

    threshold_factor: float = 1.0
    minimum_threshold: float = 0.01
    dwell: float = 0.01
    clear_dwell: float = 0.2
    hysteresis: float = 0.7
    sigmas: float = 4.0
    friction_uncertainty: float = 0.3
    false_alarm_hours: float = 1000.0
    latch: bool = False
    compensation_rate: float = 0.5
    safe_stop_bound: float = 1.5
    max_ambiguous_change: float = 0.2


@dataclass(frozen=True)
class Alarm:
    """One alarm event of one sensor.

    Attributes
    ----------
    event : AlarmEvent
        Raised, updated or cleared.
    sensor_index : int
        Index of the physical sensor.
    sensor : str
        Its name.
    onset, detected : int
        First sample above the threshold and time of the decision [ns].
    size, bound : float
        Fault at the event, with sign, and bound on its error [rad].
    kind : str
        One of `lpv_core.decision.fault_classification.KINDS`.
    confidence : float
        One minus the probability of a healthy estimate like this: taking the bound as ``sigmas``
        standard deviations of a normal error, or from the mean time between false alarms.
    """

    event: AlarmEvent
    sensor_index: int
    sensor: str
    onset: int
    detected: int
    size: float
    bound: float
    kind: str
    confidence: float


_OK, _WARN, _ERROR, _STALE, _NOT_DIAGNOSABLE = (int(state) for state in SensorState)
_INITIALISING = int(Mode.INITIALISING)
_REST = NANOSECONDS
"""An estimate is trusted again when there was no reason against it for so long [ns]."""

DIAGNOSIS_CONSTANTS = record_type(
    ('bound', BOUND_CONSTANTS),
    ('consistency', CONSISTENCY_CONSTANTS),
    ('reckoning', RECKONING_CONSTANTS),
    ('sensor', SENSOR_CONSTANTS),
    ('threshold_factor', 'f8'),
    ('minimum_threshold', 'f8'),
    ('compensation_rate', 'f8'),
    ('safe_stop_bound', 'f8'),
    ('max_ambiguous_change', 'f8'),
)

ALARM_EVENT = record_type(
    ('happened', 'i8'),
    ('sensor', 'i8'),
    ('onset', 'i8'),
    ('detected', 'i8'),
    ('amount', 'f8'),
    ('bound', 'f8'),
    ('kind', 'i8'),
    ('by_change', '?'),
    ('inconsistent', '?'),
)
"""What an `Alarm` is made from; ``happened`` is an AlarmEvent, -1 for none."""

DECISION = record_type(
    ('bound', 'f8', (2,)),
    ('threshold', 'f8', (2,)),
    ('state', 'u1', (2,)),
    ('alarm', 'u1', (2,)),
    ('estimate', 'f8', (2,)),
    ('estimate_bound', 'f8', (2,)),
    ('confirmed_fault', 'f8', (2,)),
    ('inconsistent', '?'),
    ('trustworthy', '?'),
    ('events', ALARM_EVENT, (2,)),
)
"""Decision at one sample.

bound, threshold
    Of the levels f^, per physical sensor [rad].
state
    Of `SensorState`, per physical sensor.
alarm
    Confirmed faults.
estimate, estimate_bound
    The best that is known of the faults, and bound on its error: confirmed faults that were seen as
    a change are measured by that, all else by the level [rad].
confirmed_fault
    What is to be removed from the readings: confirmed faults, faded in and out where their size was
    not known at once; and jumps that are not confirmed yet, which are bridged for the dwell [rad].
inconsistent
    Rates, torques and model contradict each other; the cause is unknown.
trustworthy
    False if a confirmed fault cannot be compensated safely: the arm should stop.
events
    What happened at this sample, one entry a sensor.
"""

DIAGNOSIS_STATE = record_type(
    # Beside the parts' states: last stamp [ns]; what is removed from the readings of each sensor
    # [rad], whether that is being done, and what it lacks of the confirmed fault while it is faded
    # in [rad]; since when a level is beyond its bound without an alarm, and when there was a reason
    # not to trust the estimate last [ns].
    ('bound', BOUND_STATE),
    ('consistency', CONSISTENCY_STATE),
    ('reckoning', RECKONING_STATE),
    ('sensors', SENSOR_STATE, (2,)),
    ('stamp', 'i8'),
    ('applied', 'f8', (2,)),
    ('engaged', 'u1', (2,)),
    ('missing', 'f8', (2,)),
    ('above_since', 'i8', (2,)),
    ('doubted_at', 'i8'),
    ('decision', DECISION),
)


def diagnosis_constants(arm, gains, parameters: DiagnosisParameters) -> np.record:
    """Constants of `diagnose` for one arm.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.
    parameters : DiagnosisParameters
        Tuning.

    Returns
    -------
    numpy.record
        Of type `DIAGNOSIS_CONSTANTS`.
    """
    p = parameters
    sensor = new_record(
        SENSOR_CONSTANTS,
        changes=change_test(arm, p.false_alarm_hours, p.minimum_threshold),
        rates=rate_test(arm, gains),
        noise=arm.position_noise,
        step=arm.velocity_noise * arm.sample_time,
        dwell=math.ceil(p.dwell * NANOSECONDS),
        clear_dwell=math.ceil(p.clear_dwell * NANOSECONDS),
        hysteresis=p.hysteresis,
        latch=p.latch,
        decay=gains.observer.decay,
    )
    return new_record(
        DIAGNOSIS_CONSTANTS,
        sensor=sensor,
        bound=error_bound(arm, gains, p.sigmas, p.friction_uncertainty),
        consistency=consistency_test(arm, gains, sigmas_for(p.false_alarm_hours, arm.sample_time)),
        reckoning=dead_reckoning(arm),
        threshold_factor=p.threshold_factor,
        minimum_threshold=p.minimum_threshold,
        compensation_rate=p.compensation_rate,
        safe_stop_bound=p.safe_stop_bound,
        max_ambiguous_change=p.max_ambiguous_change,
    )


def diagnosis_history(arm) -> tuple[np.ndarray, ...]:
    """Empty past of both sensors.

    Parameters
    ----------
    arm : ArmParameters
        Its sample time.

    Returns
    -------
    tuple of ndarray
        Stamps (2, n) [ns] and values (2, n, 4), see `lpv_core.residual.sample_buffer`.
    """
    both = [new_history(round(_HISTORY / arm.sample_time)) for _ in range(2)]
    return tuple(np.stack(part) for part in zip(*both))


@njit
def reset_diagnosis(state) -> None:
    """Clear alarms and past."""
    reset_bound(state.bound)
    reset_consistency(state.consistency)
    reset_reckoning(state.reckoning)
    for i in range(2):
        reset_sensor(state.sensors[i])
    state.stamp = state.doubted_at = NEVER
    state.applied[:] = state.missing[:] = 0.0
    state.engaged[:] = 0


@njit
def diagnose(
    params: np.record, state: np.record, stamps: np.ndarray, values: np.ndarray, estimate: np.record
) -> None:
    """Decide on one estimate; the decision is in ``state.decision``.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    stamps, values : ndarray
        `diagnosis_history`.
    estimate : numpy.record
        Latest estimate.
    """
    if estimate.stamp < state.stamp:
        for i in range(2):
            restart_sensor(state.sensors[i])
        state.doubted_at = NEVER
    state.stamp = estimate.stamp
    d = state.decision
    update_dead_reckoning(params.reckoning, state.reckoning, estimate)
    update_bound(params.bound, state.bound, estimate, state.reckoning.lost)
    d.inconsistent = is_inconsistent(
        params.consistency, state.consistency, estimate, state.bound.momentum
    )
    for i in range(2):
        d.bound[i] = state.bound.bound[i]
        d.threshold[i] = max(params.threshold_factor * d.bound[i], params.minimum_threshold)
    for i in range(2):
        _decide_one(params, state, stamps[i], values[i], estimate, i)
    d.trustworthy = _is_trustworthy(params, state)
    _compensate(params, state, estimate.interval)


@njit
def _decide_one(params, state, stamps, values, estimate, i) -> None:
    d, sensor, reckoned = state.decision, state.sensors[i], state.reckoning
    sample = sensor.sample
    sample.stamp, sample.fault, sample.reading = (
        estimate.stamp,
        estimate.fault[i],
        estimate.sensor_position[i],
    )
    sample.residual, sample.allowance = reckoned.residual[i], reckoned.allowance[i]
    sample.threshold = d.threshold[i]
    sample.innovation = row_dot(
        params.reckoning.sensor_matrix, i, estimate.innovation[0], estimate.innovation[1]
    )
    sample.missing, sample.inconsistent = estimate.missing[i], d.inconsistent
    sample.lost = _is_lost(params, d, estimate, i)
    decided = decide(params.sensor, sensor, stamps, values)
    event = d.events[i]
    event.happened = decided
    if decided != NOTHING:
        event.sensor, event.onset, event.detected = i, sensor.onset, sensor.detected
        event.amount, event.bound, event.kind = sensor.amount, _bound(params, state, i), sensor.kind
        event.by_change, event.inconsistent = sensor.by_change, d.inconsistent
    d.alarm[i] = sensor.alarm
    d.state[i] = _state(sensor)


@njit
def _bound(params, state, i):
    """Bound on the error of the size of a fault."""
    bound, sensor = state.decision.bound[i], state.sensors[i]
    if not sensor.by_change or sensor.kind == INCONSISTENT:
        return bound
    return min(bound, size_error(params.sensor, sensor))


@njit
def _is_lost(params, sample, estimate, i):
    """Whether a level says nothing: gravity does not renew it, or not closely enough."""
    if estimate.mode == _INITIALISING or sample.bound[i] > params.safe_stop_bound:
        return True
    spread = params.bound.spread
    return (estimate.held[0] and spread[i, 0] > 0.0) or (estimate.held[1] and spread[i, 1] > 0.0)


@njit
def _state(sensor):
    sample = sensor.sample
    if sample.missing:
        return _STALE
    if sensor.alarm:
        return _ERROR
    if sample.lost:
        return _NOT_DIAGNOSABLE
    return _WARN if abs(sample.fault) > sample.threshold or sample.inconsistent else _OK


@njit
def _compensate(params, state, interval) -> None:
    """Follow confirmed faults: at once where a jump was seen, otherwise faded in, and out."""
    step = params.compensation_rate * interval
    for i in range(2):
        sensor = state.sensors[i]
        known = is_compensable(sensor)
        best = sensor.sample.fault
        if known:
            # Rates alone may lead away in time; gravity's bound holds.
            bound = state.decision.bound[i]
            best = min(max(removable(params.sensor, sensor), best - bound), best + bound)
        state.decision.estimate[i] = best
        state.decision.estimate_bound[i] = (
            _bound(params, state, i) if known else state.decision.bound[i]
        )
        # An arm that is stopped feels no step.
        fade = step if state.decision.trustworthy else math.inf
        if known:
            at_once = sensor.stepped or sensor.kind == NOISE or sensor.kind == SPIKE
            missing = state.missing[i] if state.engaged[i] else best - state.applied[i]
            missing = 0.0 if at_once else _toward_zero(missing, fade)
            # What the fault does meanwhile is followed; nothing beyond it is removed.
            state.applied[i] = min(max(best - missing, min(best, 0.0)), max(best, 0.0))
            state.missing[i] = best - state.applied[i]
        else:
            state.applied[i] = _toward_zero(state.applied[i], fade)
        state.engaged[i] = known
        state.decision.confirmed_fault[i] = state.applied[i] + suspected(sensor)


@njit
def _toward_zero(value, step):
    return max(value - step, 0.0) if value > 0.0 else min(value + step, 0.0)


@njit
def _is_trustworthy(params, state):
    """Whether the loop may go on, see `DECISION`."""
    trusted = True
    # An arm that was stopped does not go on and stop again with the noise.
    share = 1.0 if state.decision.trustworthy else params.sensor.hysteresis
    for i in range(2):
        sensor = state.sensors[i]
        above = abs(sensor.sample.fault) > sensor.sample.threshold
        if not (above and sensor.sample.lost and not sensor.alarm):
            state.above_since[i] = state.stamp
        # Beyond its bound where gravity tells nothing: something is wrong, not known what.
        if state.stamp - state.above_since[i] >= params.sensor.dwell > 0:
            trusted = False
        wide = abs(sensor.sample.fault) > share * sensor.sample.threshold
        if sensor.alarm and sensor.kind == INCONSISTENT and wide:
            trusted = False
        if is_unexplained(sensor) and abs(sensor.amount) > share * params.max_ambiguous_change:
            trusted = False
        # What did not begin with a jump rests on the estimate alone.
        relied = abs(sensor.amount) + _bound(params, state, i)
        if is_compensable(sensor) and not sensor.stepped and relied > params.safe_stop_bound:
            trusted = False
    if not trusted:
        state.doubted_at = state.stamp
    elif state.doubted_at != NEVER and state.stamp - state.doubted_at < _REST:
        trusted = False  # the stop itself shakes the estimate
    return trusted


def make_alarm(event: np.record, arm, parameters: DiagnosisParameters) -> Alarm:
    """The alarm of an event.

    Parameters
    ----------
    event : numpy.record
        Of type `ALARM_EVENT`.
    arm : ArmParameters
        Names of its sensors.
    parameters : DiagnosisParameters
        For the confidence.

    Returns
    -------
    Alarm
        The same, with confidence.
    """
    size, bound = float(event.amount), float(event.bound)
    confidence = math.erf(parameters.sigmas * abs(size) / max(bound, 1e-12) / math.sqrt(2.0))
    if event.by_change or event.kind == DROPOUT:
        confidence = 1.0 - 1.0 / (3600.0 * parameters.false_alarm_hours)
    if event.kind == INCONSISTENT or (event.inconsistent and not event.by_change):
        confidence *= 0.5
    index = int(event.sensor)
    return Alarm(
        AlarmEvent(event.happened),
        index,
        arm.sensor_names[index],
        int(event.onset),
        int(event.detected),
        size,
        bound,
        KINDS[event.kind],
        confidence,
    )


@dataclass
class Diagnosis:
    """Decision at one sample as `DECISION` has it, in Python's types.

    Attributes
    ----------
    bound, threshold, confirmed_fault : ndarray, shape (2,)
        Per physical sensor [rad].
    alarm : ndarray of bool, shape (2,)
        Confirmed faults.
    state : list of SensorState
        Per physical sensor.
    events : list of Alarm
        What changed at this sample.
    inconsistent, trustworthy : bool
        As in `DECISION`.
    """

    bound: np.ndarray
    threshold: np.ndarray
    state: list
    alarm: np.ndarray
    confirmed_fault: np.ndarray
    events: list
    inconsistent: bool
    trustworthy: bool


class Diagnoser:
    """Bounds, decisions of both sensors, consistency, and what to compensate.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.
    parameters : DiagnosisParameters, optional
        Tuning.

    Attributes
    ----------
    parameters : DiagnosisParameters
        Present tuning.
    constants, state : numpy.record
        Of types `DIAGNOSIS_CONSTANTS` and `DIAGNOSIS_STATE`.
    history : tuple of ndarray
        `diagnosis_history`.
    """

    def __init__(self, arm, gains, parameters: DiagnosisParameters | None = None) -> None:
        self._arm, self._gains = arm, gains
        self.state, self.history = new_record(DIAGNOSIS_STATE), diagnosis_history(arm)
        self.retune(parameters or DiagnosisParameters())
        self.reset()

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running; alarms stay as they are.

        Parameters
        ----------
        parameters : DiagnosisParameters
            The new tuning.
        """
        self.parameters = parameters
        self.constants = diagnosis_constants(self._arm, self._gains, parameters)

    def reset(self) -> None:
        """Clear alarms and past."""
        reset_diagnosis(self.state)

    def update(self, estimate: np.record) -> Diagnosis:
        """Decide on one estimate.

        Parameters
        ----------
        estimate : numpy.record
            Latest estimate, `lpv_core.observer.sampled_observer.ESTIMATE`.

        Returns
        -------
        Diagnosis
            Bounds, states, alarms and events.
        """
        diagnose(self.constants, self.state, *self.history, estimate)
        d = self.state.decision
        return Diagnosis(
            d.bound.copy(),
            d.threshold.copy(),
            [SensorState(s) for s in d.state],
            d.alarm.astype(bool),
            d.confirmed_fault.copy(),
            self.alarms(d.events),
            bool(d.inconsistent),
            bool(d.trustworthy),
        )

    def alarms(self, events: Iterable[np.record]) -> list[Alarm]:
        """Alarms of those entries in which something happened.

        Parameters
        ----------
        events : iterable of numpy.record
            Of type `ALARM_EVENT`.

        Returns
        -------
        list of Alarm
            In the same order.
        """
        return [
            make_alarm(event, self._arm, self.parameters)
            for event in events
            if event.happened != NOTHING
        ]
