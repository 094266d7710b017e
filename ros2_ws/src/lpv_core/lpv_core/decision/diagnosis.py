"""From fault estimates to alarms, to what is compensated, and to whether to go on at all."""

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from lpv_core.bound.error_bound import (
    BOUND_CONSTANTS,
    BOUND_STATE,
    error_bound,
    reset_bound,
    update_bound,
)
from lpv_core.certificate.gains import Gains
from lpv_core.decision.fault_kinds import DROPOUT, INCONSISTENT, KINDS, SCATTERED
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
    SENSOR_LIMITS,
    SENSOR_STATE,
    reset_sensor,
    restart_sensor,
)
from lpv_core.model.arm import ArmParameters
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
    reset_consistency,
    update_consistency,
)
from lpv_core.residual.noise_estimation import excess, innovation_gain
from lpv_core.residual.rate_sensor_test import rate_test
from lpv_core.residual.sample_buffer import SampleBuffer, buffer_of, new_buffers
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_PAST = 3.0
"""Past that is kept of each sensor [s]."""


class SensorState(IntEnum):
    """State of a sensor's diagnosis; values as in lpv_msgs/FaultEstimate."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
    NOT_DIAGNOSABLE = 4


GUARANTEED, STATISTICAL = 'guaranteed', 'statistical'
"""Bases of an alarm."""


class AlarmEvent(IntEnum):
    """Kinds of alarm events; values as in lpv_msgs/FaultAlarm."""

    RAISED = 0
    UPDATED = 1
    CLEARED = 2


@dataclass(frozen=True)
class DiagnosisParameters:
    """Tuning of the decision."""

    threshold_factor: float = 1.0  # threshold over bound; above 1 trades delay against false alarms
    minimum_threshold: float = 0.01  # no alarm below this size [rad]
    dwell: float = 0.01  # how long an estimate must stay above its threshold before the alarm [s]
    # how long it must stay below ``hysteresis`` times the threshold to clear [s]
    clear_dwell: float = 0.2
    hysteresis: float = 0.7  # fraction of the threshold at which an alarm may clear
    sigmas: float = 4.0  # multiple of the noise part in the bound
    friction_uncertainty: float = 0.3  # relative uncertainty of Coulomb friction
    # mean time between false alarms by noise, for the limits of changes [h]
    false_alarm_hours: float = 1000.0
    latch: bool = False  # alarms stay until they are reset, even if the fault is over
    # how fast a compensation without a known step is faded in and out [rad/s]
    compensation_rate: float = 0.5
    # a confirmed fault that did not begin with a jump cannot be compensated safely if its size and
    # bound together are larger [rad]; a level with a wider bound is no evidence
    safe_stop_bound: float = 1.5
    # largest change of unknown cause with which the arm goes on [rad]: if it is the position sensor
    # after all, the arm is off its path by as much
    max_ambiguous_change: float = 0.2


@dataclass(frozen=True)
class Alarm:
    """One alarm event of one sensor."""

    event: AlarmEvent  # raised, updated or cleared
    sensor_index: int  # index of the physical sensor
    sensor: str  # its name
    onset: int  # first sample above the threshold [ns]
    detected: int  # time of the decision [ns]
    size: float  # fault at the event, with sign [rad]
    bound: float  # on the error of the size [rad]
    kind: str  # one of `lpv_core.decision.fault_kinds.KINDS`
    # one minus the probability of a healthy estimate like this: taking the bound as ``sigmas``
    # standard deviations of a normal error, or from the mean time between false alarms
    confidence: float
    # `GUARANTEED` or `STATISTICAL` where the monitor tells them apart, else ''; no field of the
    # message, where the confidence of what is guaranteed is exactly 1
    basis: str = field(default='', kw_only=True)
    unit: str = field(default='rad', kw_only=True)  # of positions of the sensor


_OK, _WARN, _ERROR, _STALE, _NOT_DIAGNOSABLE = (int(state) for state in SensorState)
_INITIALISING = int(Mode.INITIALISING)
_REST = NANOSECONDS
"""An estimate is trusted again when there was no reason against it for this long [ns]."""

DIAGNOSIS_CONSTANTS = record_type(
    ('bound', BOUND_CONSTANTS),
    ('consistency', CONSISTENCY_CONSTANTS),
    ('reckoning', RECKONING_CONSTANTS),
    ('sensor', SENSOR_CONSTANTS),
    # As in `DiagnosisParameters`:
    ('threshold_factor', 'f8'),  # [1]
    ('minimum_threshold', 'f8'),  # [rad]
    ('compensation_rate', 'f8'),  # [rad/s]
    ('safe_stop_bound', 'f8'),  # [rad]
    ('max_ambiguous_change', 'f8'),  # [rad]
)

ALARM_EVENT = record_type(
    ('happened', 'i8'),  # an `AlarmEvent`, -1 for none
    ('sensor', 'i8'),  # its index
    ('onset', 'i8'),  # [ns]
    ('detected', 'i8'),  # [ns]
    ('amount', 'f8'),  # [rad]
    ('bound', 'f8'),  # [rad]
    ('kind', 'i8'),  # of `lpv_core.decision.fault_kinds.FaultKind`
    ('by_change', '?'),  # rests on a change of the residual
    ('inconsistent', '?'),  # rates, torques and model contradict each other
)
"""What an `Alarm` is made from."""

DECISION = record_type(
    # Per physical sensor:
    ('bound', 'f8', (2,)),  # of the levels f^ [rad]
    ('threshold', 'f8', (2,)),  # of the levels f^ [rad]
    ('state', 'u1', (2,)),  # of `SensorState`
    ('alarm', 'u1', (2,)),  # confirmed faults
    # The best that is known of the faults: confirmed faults that were seen as a change are measured
    # by that, all else by the level.
    ('estimate', 'f8', (2,)),  # [rad]
    ('estimate_bound', 'f8', (2,)),  # bound on its error [rad]
    # What is to be removed from the readings: confirmed faults, faded in and out where their size
    # was not known at once; and jumps that are not confirmed yet, bridged for the dwell.
    ('confirmed_fault', 'f8', (2,)),  # [rad]
    ('events', ALARM_EVENT, (2,)),  # what happened at this sample
    ('inconsistent', '?'),  # rates, torques and model contradict each other; cause unknown
    ('trustworthy', '?'),  # False if a fault cannot be compensated safely: the arm should stop
)
"""Decision at one sample."""

COMPENSATION = record_type(
    ('applied', 'f8'),  # what is removed from the reading [rad]
    ('engaged', '?'),  # whether a confirmed fault is removed
    ('missing', 'f8'),  # what it lacks of the confirmed fault while it is faded in [rad]
)

DIAGNOSIS_STATE = record_type(
    ('bound', BOUND_STATE),
    ('consistency', CONSISTENCY_STATE),
    ('reckoning', RECKONING_STATE),
    ('sensors', SENSOR_STATE, (2,)),
    ('compensation', COMPENSATION, (2,)),
    ('above_since', 'i8', (2,)),  # since when a level is above without an alarm [ns]
    ('stamp', 'i8'),  # of the last estimate [ns]
    ('distrusted_at', 'i8'),  # last reason not to trust the estimate [ns]
    ('decision', DECISION),
)


def diagnosis_constants(
    arm: ArmParameters, gains: Gains, parameters: DiagnosisParameters
) -> np.record:
    """Constants of `diagnose` for one arm, of type `DIAGNOSIS_CONSTANTS`."""
    p = parameters
    sensor = new_record(
        SENSOR_CONSTANTS,
        stated=new_record(
            SENSOR_LIMITS,
            changes=change_test(arm, p.false_alarm_hours, p.minimum_threshold),
            rates=rate_test(arm, gains),
            noise=arm.position_noise,
            # Second differences of r have those of the rates over two samples, too.
            scatter=math.hypot(
                arm.position_noise, arm.velocity_noise * arm.sample_time / math.sqrt(12.0)
            ),
            step=arm.velocity_noise * arm.sample_time,
        ),
        innovation_noise=arm.velocity_noise * innovation_gain(arm, gains),
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


def diagnosis_buffers(arm: ArmParameters) -> SampleBuffer:
    """Empty past of both sensors."""
    return new_buffers(2, round(_PAST / arm.sample_time))


@njit
def reset_diagnosis(state: np.record, buffers: SampleBuffer) -> None:
    """Clear alarms and past."""
    reset_bound(state.bound)
    reset_consistency(state.consistency)
    reset_reckoning(state.reckoning)
    for i in range(2):
        reset_sensor(state.sensors[i], buffer_of(buffers, i))
        compensation = state.compensation[i]
        compensation.applied = compensation.missing = 0.0
        compensation.engaged = False
    state.stamp = state.distrusted_at = NEVER


@njit
def diagnose(
    params: np.record, state: np.record, buffers: SampleBuffer, estimate: np.record
) -> None:
    """Decide on one estimate; the decision is in ``state.decision``.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    buffers : SampleBuffer
        `diagnosis_buffers`.
    estimate : numpy.record
        Latest estimate, of type `lpv_core.observer.sampled_observer.ESTIMATE`.
    """
    if estimate.stamp < state.stamp:
        for i in range(2):
            restart_sensor(state.sensors[i], buffer_of(buffers, i))
        state.distrusted_at = NEVER
    state.stamp = estimate.stamp
    decision, bound, consistency = state.decision, state.bound, state.consistency
    update_dead_reckoning(params.reckoning, state.reckoning, estimate)
    update_bound(params.bound, bound, estimate, state.reckoning)
    noise = _largest_excess(state)
    update_consistency(params.consistency, consistency, estimate, bound.momentum, noise)
    decision.inconsistent = consistency.inconsistent
    for i in range(2):
        # Noise that is larger than stated widens the bound as far as that is noise.
        decision.bound[i] = bound.bound[i] + (noise - 1.0) * params.bound.noise[i]
        decision.threshold[i] = max(
            params.threshold_factor * decision.bound[i], params.minimum_threshold
        )
    for i in range(2):
        _decide_sensor(params, state, buffer_of(buffers, i), estimate, i)
    _update_trust(params, state)
    for i in range(2):
        _compensate(params, state, estimate.interval, i)


@njit
def _largest_excess(state: np.record) -> float:
    """Factor by which any noise is larger than stated; the observer mixes them all."""
    largest = 1.0
    for i in range(2):
        noise = state.sensors[i].noise
        for ratio in (noise.reading, noise.rate):
            largest = max(largest, excess(ratio, noise.windows))
    return largest


@njit
def _decide_sensor(
    params: np.record, state: np.record, buffer: SampleBuffer, estimate: np.record, i: int
) -> None:
    decision, sensor = state.decision, state.sensors[i]
    _fill_sample(params, state, estimate, i)
    happened = decide(params.sensor, sensor, buffer)
    event, alarm = decision.events[i], sensor.alarm
    event.happened = happened
    if happened != NOTHING:
        event.sensor, event.onset, event.detected = i, alarm.onset, alarm.detected
        event.amount, event.bound, event.kind = alarm.amount, _bound(params, state, i), alarm.kind
        event.by_change, event.inconsistent = alarm.by_change, decision.inconsistent
    decision.alarm[i] = alarm.active
    decision.state[i] = _state(sensor)


@njit
def _fill_sample(params: np.record, state: np.record, estimate: np.record, i: int) -> None:
    decision, reckoned, sample = state.decision, state.reckoning, state.sensors[i].sample
    matrix, innovation = params.reckoning.sensor_matrix, estimate.innovation
    sample.stamp, sample.fault = estimate.stamp, estimate.fault[i]
    sample.reading, sample.missing = estimate.sensor_position[i], estimate.missing[i]
    sample.residual, sample.allowance = reckoned.residual[i], reckoned.allowance[i]
    sample.rate = reckoned.rate[i]
    sample.innovation = row_dot(matrix, i, innovation[0], innovation[1])
    sample.threshold, sample.inconsistent = decision.threshold[i], decision.inconsistent
    sample.lost = _is_lost(params, decision, estimate, i)


@njit
def _bound(params: np.record, state: np.record, i: int) -> float:
    """Bound on the error of the size of a fault."""
    bound, sensor = state.decision.bound[i], state.sensors[i]
    if not sensor.alarm.by_change or sensor.alarm.kind == INCONSISTENT:
        return bound
    return min(bound, size_error(sensor))


@njit
def _is_lost(params: np.record, decision: np.record, estimate: np.record, i: int) -> bool:
    """Whether a level says nothing: gravity does not renew it, or not closely enough."""
    if estimate.mode == _INITIALISING or decision.bound[i] > params.safe_stop_bound:
        return True
    spread = params.bound.spread
    return (estimate.held[0] and spread[i, 0] > 0.0) or (estimate.held[1] and spread[i, 1] > 0.0)


@njit
def _state(sensor: np.record) -> int:
    sample = sensor.sample
    if sample.missing:
        return _STALE
    if sensor.alarm.active:
        return _ERROR
    if sample.lost:
        return _NOT_DIAGNOSABLE
    return _WARN if abs(sample.fault) > sample.threshold or sample.inconsistent else _OK


@njit
def _compensate(params: np.record, state: np.record, interval: float, i: int) -> None:
    """Follow a confirmed fault: at once where a jump was seen, otherwise faded in, and out."""
    decision, sensor, own = state.decision, state.sensors[i], state.compensation[i]
    known, best, bound = is_compensable(sensor), sensor.sample.fault, decision.bound[i]
    decision.estimate_bound[i] = bound
    if known:
        # Rates alone may lead away in time; gravity's bound holds.
        best = min(max(removable(sensor), best - bound), best + bound)
        decision.estimate_bound[i] = _bound(params, state, i)
    decision.estimate[i] = best
    # An arm that is stopped feels no step.
    fade = params.compensation_rate * interval if decision.trustworthy else math.inf
    if known:
        at_once = sensor.alarm.stepped or sensor.alarm.kind in SCATTERED
        missing = own.missing if own.engaged else best - own.applied
        missing = 0.0 if at_once else _toward_zero(missing, fade)
        # What the fault does meanwhile is followed; nothing beyond it is removed.
        own.applied = min(max(best - missing, min(best, 0.0)), max(best, 0.0))
        own.missing = best - own.applied
    else:
        own.applied = _toward_zero(own.applied, fade)
    own.engaged = known
    decision.confirmed_fault[i] = own.applied + suspected(sensor)


@njit
def _toward_zero(value: float, step: float) -> float:
    return max(value - step, 0.0) if value > 0.0 else min(value + step, 0.0)


@njit
def _update_trust(params: np.record, state: np.record) -> None:
    """Whether the loop may go on: no reason against it, now and shortly before."""
    decision, trusted = state.decision, True
    for i in range(2):
        sensor = state.sensors[i]
        above = abs(sensor.sample.fault) > sensor.sample.threshold
        if not (above and sensor.sample.lost and not sensor.alarm.active):
            state.above_since[i] = state.stamp
        trusted = trusted and _is_trusted(params, state, i)
    if not trusted:
        state.distrusted_at = state.stamp
    elif state.distrusted_at != NEVER and state.stamp - state.distrusted_at < _REST:
        trusted = False  # the stop itself shakes the estimate
    decision.trustworthy = trusted


@njit
def _is_trusted(params: np.record, state: np.record, i: int) -> bool:
    """Whether nothing that is known of a sensor speaks against going on."""
    sensor, sample, alarm = state.sensors[i], state.sensors[i].sample, state.sensors[i].alarm
    # An arm that was stopped does not go on and stop again with the noise.
    share = 1.0 if state.decision.trustworthy else params.sensor.hysteresis
    # Beyond its bound where gravity tells nothing: something is wrong, not known what.
    if state.stamp - state.above_since[i] >= params.sensor.dwell > 0:
        return False
    wide = abs(sample.fault) > share * sample.threshold
    if alarm.active and alarm.kind == INCONSISTENT and wide:
        return False
    if is_unexplained(sensor) and abs(alarm.amount) > share * params.max_ambiguous_change:
        return False
    # What did not begin with a jump rests on the estimate alone.
    relied = abs(alarm.amount) + _bound(params, state, i)
    return not (is_compensable(sensor) and not alarm.stepped and relied > params.safe_stop_bound)


def make_alarm(event: np.record, arm: ArmParameters, parameters: DiagnosisParameters) -> Alarm:
    """The alarm of an event of type `ALARM_EVENT`, with the sensor's name and the confidence."""
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
