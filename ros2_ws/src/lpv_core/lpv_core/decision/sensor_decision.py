"""The decision about one position sensor: when a fault is confirmed, of which kind, and when over.

Three kinds of evidence count: the level of the fault estimate against its guaranteed bound, changes
of the residual over several windows (`lpv_core.residual.change_detection`), and missing data.
Evidence must last for the dwell; shorter excursions are spikes.

A fault that was seen as a change is measured by the residual, against what it was before: the level
is only known within its bound, and its healthy error moves.

All functions take constants and state of `lpv_core.decision.sensor_state`, and the sensor's past
(`lpv_core.residual.sample_buffer`).  A decision is `NOTHING`, `RAISED`, `UPDATED` or `CLEARED`.
What an alarm may be updated to is in `lpv_core.decision.fault_kinds.MAY_BECOME`.
"""

import math

import numpy as np

from lpv_core.decision.fault_classification import classify, fits_better, is_stuck, span, standstill
from lpv_core.decision.fault_kinds import (
    DROPOUT,
    INCONSISTENT,
    MAY_BECOME,
    NOISE,
    SCALE,
    SCATTERED,
    SPIKE,
    STUCK,
    TIME_PROFILES,
    UNCLASSIFIED,
    WITHOUT_SIZE,
)
from lpv_core.decision.fault_magnitude import follow_fault, growth, measure_step, size_error
from lpv_core.decision.scale_filter import start_scale
from lpv_core.decision.sensor_state import SPIKES, UNMEASURED, update_limits
from lpv_core.residual.change_detection import WINDOWS, change_limit, find_change, least_change
from lpv_core.residual.noise_estimation import noise_level
from lpv_core.residual.onset_estimation import fit_step_or_ramp, has_jumped, take_baseline
from lpv_core.residual.rate_sensor_test import (
    IMPLICATED,
    RULED_OUT,
    UNDECIDED,
    Movement,
    rate_verdict,
)
from lpv_core.residual.sample_buffer import (
    ALLOWANCE,
    READING,
    RESIDUAL,
    SampleBuffer,
    add_sample,
    clear_buffer,
    first_since,
)
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS, NEVER

NOTHING, RAISED, UPDATED, CLEARED = range(-1, 3)
_SPIKE_TIME = NANOSECONDS
"""Excursions shorter than the dwell are a fault of kind spike if enough of them come within that
time, and until there has been none for as long [ns]."""
_DECIDED = NANOSECONDS
"""The kind is settled this long after the alarm [ns]."""
_CHECK_INTERVAL = 50_000_000
"""Interval of classification and of the test for noise and stuck readings [ns]."""
_RECENT = 50
"""Samples that show noise and standstill."""
_NOISY = 150
"""Readings before so many samples were not yet noisy when noise is seen first."""
_NOISE_RATIO = 3.0
"""A reading is noisy if it scatters by so many times its stated standard deviation."""
_BEFORE = 2.0
"""An onset is looked for so many windows back: a slow change began before the window."""
_MOST_GROWTH = 0.25
"""What errors of the rates may add to a residual excuses no more than this part of a fault."""
_MEMORY = 10 * NANOSECONDS
"""A sensor is suspected first for this long after the end of its fault [ns]."""


@njit
def is_compensable(state: np.record) -> bool:
    """Whether `lpv_core.decision.fault_magnitude.removable` may be removed from the reading."""
    return state.alarm.active and state.alarm.kind != INCONSISTENT


@njit
def is_unexplained(state: np.record) -> bool:
    """Whether a reading has changed for a cause that is not known."""
    alarm = state.alarm
    unknown = alarm.active and alarm.kind == INCONSISTENT
    return unknown and alarm.by_change and not alarm.rate_implicated


@njit
def suspected(state: np.record) -> float:
    """What an abrupt change that is not confirmed yet would be as a fault [rad], else 0."""
    evidence = state.evidence
    if state.alarm.active or evidence.since == NEVER or evidence.window != 0:
        return 0.0
    return state.sample.residual - evidence.residual


@njit
def decide(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """Decide on the sample in ``state.sample``; returns what happened now."""
    sample, alarm = state.sample, state.alarm
    update_limits(params, state, buffer)
    _update_rate_pull(params, state)
    if sample.missing:
        return _handle_missing(params, state, buffer)
    state.missing_since = NEVER
    if alarm.active and alarm.kind == DROPOUT:
        alarm.amount = _size(state)
        if abs(alarm.amount) <= max(state.limits.changes.smallest, size_error(state)):
            return _clear_after_dwell(params, state, buffer, True)
        # Readings are there again, and are not what dead reckoning expects.
        alarm.kind, alarm.stepped = UNCLASSIFIED, True
    if alarm.active:
        decided = _decide_alarm(params, state, buffer)
        follow_fault(state)
    else:
        decided = _decide_healthy(params, state, buffer)
    add_sample(buffer, sample)
    state.last_allowance = sample.allowance
    return decided


@njit
def _update_rate_pull(params: np.record, state: np.record) -> None:
    """What a wrong rate that moves the residual makes of f^: it forgets with its decay rate.

    A confirmed fault of the position sensor explains what moves the residual: no rate does then.
    """
    sample, pull = state.sample, state.rate_pull
    if is_compensable(state):
        pull.level = 0.0
    elif pull.stamp != NEVER:
        interval = max(0.0, (sample.stamp - pull.stamp) / NANOSECONDS)
        pull.level += sample.residual - pull.residual
        pull.level *= max(0.0, 1.0 - params.decay * interval)
    pull.stamp, pull.residual = sample.stamp, sample.residual


@njit
def _gravity_confirms(state: np.record) -> bool:
    """Whether gravity contradicts the reading by more than a wrong rate could have moved f^."""
    sample = state.sample
    beyond = (sample.fault - state.rate_pull.level) * math.copysign(1.0, sample.fault)
    return _above(sample) and beyond > sample.threshold


@njit
def _above(sample: np.record) -> bool:
    return not sample.lost and abs(sample.fault) > sample.threshold


@njit
def _has_lasted(since: int, sample: np.record, time: int) -> bool:
    return sample.stamp - since >= time


@njit
def _start_check_if_due(state: np.record) -> bool:
    if state.next_check != NEVER and state.sample.stamp < state.next_check:
        return False
    first = state.next_check == NEVER
    state.next_check = state.sample.stamp + _CHECK_INTERVAL
    return not first


@njit
def _scatter(buffer: SampleBuffer) -> float:
    count = buffer.used[0]
    return noise_level(buffer.values[max(0, count - _RECENT) : count], RESIDUAL)


@njit
def _size(state: np.record) -> float:
    sample = state.sample
    return (sample.residual if state.alarm.by_change else sample.fault) - state.before.residual


# ------------------------------------------------------------------ no reading


@njit
def _handle_missing(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    sample = state.sample
    state.evidence.since = state.below_since = NEVER  # what comes next is new evidence
    if state.missing_since == NEVER:
        state.missing_since = sample.stamp
    if state.alarm.active or not _has_lasted(state.missing_since, sample, params.dwell):
        return NOTHING
    state.before.residual, state.before.allowance = sample.residual, sample.allowance
    if buffer.used[0] > 0:
        take_baseline(state, buffer, buffer.used[0] - 1)
    return _raise(state, DROPOUT, state.missing_since, True, False)


# ------------------------------------------------------------------ without an alarm


@njit
def _decide_healthy(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    sample, evidence = state.sample, state.evidence
    if evidence.since != NEVER:
        return _confirm_after_dwell(params, state, buffer)
    window, row, before = find_change(state.limits.changes, buffer, sample)
    if window < 0 and not _above(sample):
        return _check_noise_and_stuck(params, state, buffer)
    evidence.since, evidence.window, evidence.residual = sample.stamp, window, before
    evidence.allowance = buffer.values[row, ALLOWANCE] if window >= 0 else sample.allowance
    return _confirm_after_dwell(params, state, buffer)


@njit
def _confirm_after_dwell(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """Confirm evidence after the dwell, or drop it."""
    sample, evidence = state.sample, state.evidence
    if not (_above(sample) or _has_changed(params, state)):
        return _discard_excursion(params, state, buffer)
    if not _has_lasted(evidence.since, sample, params.dwell):
        return NOTHING
    if evidence.window >= 0:
        return _confirm_change(params, state, buffer)
    state.before.residual, state.before.allowance = 0.0, sample.allowance
    state.alarm.is_ambiguous = not _gravity_confirms(state)
    unknown = sample.inconsistent or state.alarm.is_ambiguous
    kind = INCONSISTENT if unknown else UNCLASSIFIED
    decided = _raise(state, kind, evidence.since, False, False)
    _reclassify(params, state, buffer)
    return decided


@njit
def _has_changed(params: np.record, state: np.record) -> bool:
    """Whether the change that was evidence is still there."""
    sample, evidence = state.sample, state.evidence
    if evidence.window < 0:
        return False
    error = sample.allowance - evidence.allowance
    limit = change_limit(state.limits.changes, evidence.window, error)
    return abs(sample.residual - evidence.residual) > limit


@njit
def _confirm_change(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """Raise an alarm for a change: of the position sensor, or of cause unknown."""
    sample, evidence, alarm = state.sample, state.evidence, state.alarm
    back = round(_BEFORE * WINDOWS[evidence.window] * NANOSECONDS)
    row = first_since(buffer, evidence.since - back)
    take_baseline(state, buffer, row)
    stepped, speed, onset = fit_step_or_ramp(state, buffer, row)
    verdict = RULED_OUT
    if stepped and not _above(sample) and _is_end(state):
        evidence.since = NEVER
        clear_buffer(buffer)
        return NOTHING
    if stepped:
        take_baseline(state, buffer, max(0, first_since(buffer, onset) - 1))
    elif not _gravity_confirms(state):
        movement = Movement(state.before.residual, onset, speed)
        verdict = rate_verdict(state.limits.rates, buffer, movement)
        if verdict == UNDECIDED and has_jumped(state, buffer):
            verdict = RULED_OUT
    # After a recent fault of the sensor, another one is more likely than one of its rate sensor.
    alarm.is_ambiguous = verdict == UNDECIDED and sample.stamp >= state.recent_fault_until
    wrong_rates = verdict == IMPLICATED or (sample.inconsistent and not stepped)
    kind = INCONSISTENT if alarm.is_ambiguous or wrong_rates else UNCLASSIFIED
    decided = _raise(state, kind, onset, True, stepped)
    alarm.rate_implicated = verdict == IMPLICATED
    _reclassify(params, state, buffer)
    return decided


@njit
def _is_end(state: np.record) -> bool:
    """Whether a jump brings f^ back from where healthy estimates hardly are: more likely the end of
    a fault that stayed unnoticed than a new one that cancels a healthy error."""
    sample = state.sample
    before = sample.fault - (sample.residual - state.evidence.residual)
    return abs(before) > 0.5 * sample.threshold and abs(sample.fault) < 0.5 * abs(before)


@njit
def _discard_excursion(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """An excursion shorter than the dwell is a spike if it was one of the shortest window."""
    sample, spikes = state.sample, state.spikes
    if state.evidence.window == 0:
        kept = 0
        for k in range(spikes.count):
            if spikes.stamps[k] > sample.stamp - _SPIKE_TIME:
                spikes.stamps[kept] = spikes.stamps[k]
                kept += 1
        spikes.stamps[kept] = sample.stamp
        spikes.count = kept + 1
    state.evidence.since = NEVER
    if spikes.count < SPIKES:
        return NOTHING
    spikes.count = 0
    onset, spikes.stamps[0] = spikes.stamps[0], sample.stamp  # from here on, the latest one
    take_baseline(state, buffer, max(0, first_since(buffer, onset - params.dwell) - 1))
    return _raise(state, SPIKE, onset, True, False)


@njit
def _check_noise_and_stuck(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """From time to time: readings that stand still, and noise."""
    count = buffer.used[0]
    if not _start_check_if_due(state) or count < _RECENT:
        return NOTHING
    scatter = _scatter(buffer)
    if is_stuck(state.limits, buffer):
        first = standstill(state.limits, buffer)
        kind, row, onset = STUCK, first - 1, buffer.stamps[first]
    elif scatter > _NOISE_RATIO * state.limits.scatter:
        kind, row, onset = NOISE, count - _NOISY, state.sample.stamp
    else:
        return NOTHING
    take_baseline(state, buffer, max(row, 0, count - len(buffer.values) // 2))
    decided = _raise(state, kind, onset, True, False)
    state.scatter.deviation = scatter
    return decided


@njit
def _raise(state: np.record, kind: int, onset: int, by_change: bool, stepped: bool) -> int:
    sample, alarm = state.sample, state.alarm
    alarm.active, alarm.kind, alarm.by_change, alarm.stepped = True, kind, by_change, stepped
    alarm.is_ambiguous = alarm.is_ambiguous and kind == INCONSISTENT
    alarm.rate_implicated = False
    alarm.onset, alarm.detected = onset, sample.stamp
    alarm.amount = alarm.reported = _size(state)
    alarm.peak = abs(alarm.amount)
    state.before.level = sample.fault - alarm.amount
    state.evidence.since = state.below_since = state.next_check = NEVER
    state.step.measured, state.scale.used = UNMEASURED, False
    state.scatter.average = state.scatter.deviation = 0.0
    return RAISED


# ------------------------------------------------------------------ with an alarm


@njit
def _decide_alarm(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    alarm = state.alarm
    alarm.amount = _size(state)
    alarm.peak = max(alarm.peak, abs(alarm.amount))
    changing = False
    if alarm.by_change and alarm.kind == INCONSISTENT:
        changing = find_change(state.limits.changes, buffer, state.sample)[0] >= 0
    decided = _update_cause(params, state)
    over = _is_over(params, state, buffer, changing)
    cleared = _clear_after_dwell(params, state, buffer, over)
    if over or decided != NOTHING:
        return cleared if cleared != NOTHING else decided
    if _start_check_if_due(state):
        decided = _check_alarm(params, state, buffer)
    if alarm.kind in SCATTERED:
        return decided
    if abs(alarm.amount - alarm.reported) > max(state.sample.threshold, 0.5 * abs(alarm.reported)):
        decided = UPDATED
    if decided == UPDATED:
        alarm.reported = alarm.amount
    return decided


@njit
def _check_alarm(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """From time to time: cause and kind of an alarm, height of a step, scatter of noise."""
    updated = _retest_rate_sensor(params, state, buffer) or _reclassify(params, state, buffer)
    if state.alarm.kind in SCATTERED:
        state.scatter.deviation = _scatter(buffer)
    if state.step.measured == UNMEASURED and state.alarm.stepped:
        measure_step(state, buffer)
    return UPDATED if updated else NOTHING


@njit
def _update_cause(params: np.record, state: np.record) -> int:
    """Whether it is the position sensor at all; UPDATED if that has changed."""
    sample, alarm = state.sample, state.alarm
    if alarm.is_ambiguous and not sample.inconsistent:
        if not _gravity_confirms(state) or sample.fault * alarm.amount <= 0.0:
            return NOTHING
        alarm.is_ambiguous, alarm.kind = False, UNCLASSIFIED
        return UPDATED
    alarm.is_ambiguous = False
    if not MAY_BECOME[alarm.kind, INCONSISTENT]:
        return NOTHING
    # Wrong rates, torques or a wrong model look like slow faults, as long as there is no step;
    # rates that are wrong for long move the residual away from what gravity says.
    difference = abs(sample.fault - alarm.amount)
    apart = (
        alarm.by_change and not sample.lost and difference > sample.threshold + size_error(state)
    )
    if not apart and (alarm.stepped or not sample.inconsistent):
        return NOTHING
    alarm.kind = INCONSISTENT
    return UPDATED


@njit
def _retest_rate_sensor(params: np.record, state: np.record, buffer: SampleBuffer) -> bool:
    """Test the rate sensor again, now that more samples show what the rate did at the onset; True
    if that rules it out."""
    sample, alarm = state.sample, state.alarm
    if (
        not (alarm.is_ambiguous and alarm.by_change)
        or sample.inconsistent
        or _has_lasted(alarm.detected, sample, _DECIDED)
    ):
        return False
    row = first_since(buffer, 2 * alarm.onset - sample.stamp)
    _, speed, onset = fit_step_or_ramp(state, buffer, row)
    verdict = rate_verdict(
        state.limits.rates, buffer, Movement(state.before.residual, onset, speed)
    )
    alarm.is_ambiguous, alarm.rate_implicated = verdict == UNDECIDED, verdict == IMPLICATED
    if verdict == RULED_OUT:
        alarm.kind = UNCLASSIFIED
    return verdict == RULED_OUT


@njit
def _is_over(params: np.record, state: np.record, buffer: SampleBuffer, changing: bool) -> bool:
    sample, alarm = state.sample, state.alarm
    if alarm.kind in WITHOUT_SIZE:
        return _has_settled(params, state, buffer)
    if not alarm.by_change:
        # A link without gravity information does not renew a level.
        return not sample.lost and abs(alarm.amount) <= params.hysteresis * sample.threshold
    if alarm.kind == INCONSISTENT:
        # Errors of the rates stay in the residual when they are over.
        away = abs(sample.fault - state.before.level)
        back = away <= max(0.5 * abs(alarm.amount), state.limits.changes.smallest)
        return back and not changing and not _above(sample)
    level = params.hysteresis * min(sample.threshold, least_change(state.limits.changes)) + min(
        growth(state), _MOST_GROWTH * alarm.peak
    )
    expected = abs(state.scale.scale * (sample.reading - alarm.amount))
    if alarm.kind == SCALE and expected <= 2.0 * level:
        return False  # the fault is small where the angle is
    return abs(alarm.amount) <= level and not _above(sample)


@njit
def _has_settled(params: np.record, state: np.record, buffer: SampleBuffer) -> bool:
    """Whether a fault without a lasting size is over."""
    sample, alarm, count = state.sample, state.alarm, buffer.used[0]
    recent = buffer.values[max(0, count - _RECENT) : count]
    if len(recent) < 10:
        return False
    if alarm.kind == SPIKE and sample.stamp - state.spikes.stamps[0] < _SPIKE_TIME:
        return False
    if alarm.kind == STUCK and span(recent[:, READING]) < state.limits.noise:
        return False  # a healthy reading shows its noise even at rest
    limit = max(least_change(state.limits.changes), params.hysteresis * sample.threshold)
    if abs(alarm.amount) >= limit + growth(state):
        return False
    return _scatter(buffer) < 2.0 * state.limits.scatter and not is_stuck(state.limits, buffer)


@njit
def _clear_after_dwell(
    params: np.record, state: np.record, buffer: SampleBuffer, over: bool
) -> int:
    alarm = state.alarm
    if not over or params.latch:
        state.below_since = NEVER
        return NOTHING
    if state.below_since == NEVER:
        state.below_since = state.sample.stamp
    if not _has_lasted(state.below_since, state.sample, params.clear_dwell):
        return NOTHING
    alarm.active, state.below_since, state.next_check = False, NEVER, NEVER
    if alarm.kind != INCONSISTENT:
        state.recent_fault_until = state.sample.stamp + _MEMORY
    if alarm.kind != SPIKE:
        # Changes are counted from here on: the end of a fault is not the start of one.
        clear_buffer(buffer)
    return CLEARED


@njit
def _reclassify(params: np.record, state: np.record, buffer: SampleBuffer) -> bool:
    """Update the kind; whether it has changed."""
    alarm, kind = state.alarm, _latest_kind(params, state, buffer)
    if not MAY_BECOME[alarm.kind, kind]:
        return False
    alarm.is_ambiguous, alarm.kind = False, kind
    if kind == SCALE:
        start_scale(state, buffer, first_since(buffer, alarm.onset))
    return True


@njit
def _latest_kind(params: np.record, state: np.record, buffer: SampleBuffer) -> int:
    """The kind by the latest samples; the present one where they do not tell another."""
    alarm = state.alarm
    if alarm.is_ambiguous and alarm.by_change:  # no rate sensor makes a reading stuck or noisy
        if is_stuck(state.limits, buffer):
            return STUCK
        enough = buffer.used[0] >= _RECENT
        return (
            NOISE
            if enough and _scatter(buffer) > _NOISE_RATIO * state.limits.scatter
            else alarm.kind
        )
    if alarm.kind == SPIKE:
        return NOISE if _scatter(buffer) > _NOISE_RATIO * state.limits.scatter else SPIKE
    if alarm.kind not in TIME_PROFILES:
        return alarm.kind
    row, baseline = first_since(buffer, alarm.onset), state.before.residual
    kind = classify(state.limits, buffer, row, alarm.onset, baseline)
    if kind == alarm.kind or kind == UNCLASSIFIED:
        return alarm.kind
    # Later time profiles are those of the arm more than of the fault; but motion tells a scale
    # error.
    if alarm.kind != UNCLASSIFIED and _has_lasted(alarm.detected, state.sample, _DECIDED):
        count = buffer.used[0]
        time = (buffer.stamps[row:count] - alarm.onset) / NANOSECONDS
        if not fits_better(kind, alarm.kind, time, buffer.values[row:count], baseline):
            return alarm.kind
    return kind
