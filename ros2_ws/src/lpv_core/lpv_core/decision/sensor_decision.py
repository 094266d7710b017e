"""The decision about one position sensor: when a fault is confirmed, of which kind, and when over.

Three kinds of evidence count: the level of the fault estimate against its guaranteed bound, changes
of the residual over several windows (`lpv_core.residual.change_detection`), and missing data.  Evidence must last
for the dwell; shorter excursions are spikes.

A fault that was seen as a change is measured by the residual, against what it was before: the level
is only known within its bound, and its healthy error moves.

All functions take the records of `lpv_core.decision.sensor_state`.  A decision is `NOTHING`,
`RAISED`, `UPDATED` or `CLEARED`.
"""

import math

from lpv_core.decision.fault_classification import (
    DROPOUT,
    INCONSISTENT,
    NOISE,
    SCALE,
    SPIKE,
    STUCK,
    UNCLASSIFIED,
    classify,
    fits_better,
    is_stuck,
    noise_level,
    span,
    standstill,
)
from lpv_core.decision.fault_magnitude import follow_fault, growth, measure_step, size_error
from lpv_core.decision.scale_filter import start_scale
from lpv_core.decision.sensor_state import SPIKES, UNMEASURED
from lpv_core.residual.change_detection import WINDOWS, change_limit, find_change, least_change
from lpv_core.residual.onset_estimation import fit_step_or_ramp, has_jumped, take_baseline
from lpv_core.residual.rate_sensor_test import IMPLICATED, RULED_OUT, UNDECIDED, rate_verdict
from lpv_core.residual.sample_buffer import ALLOWANCE, READING, add_sample, first_since
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS, NEVER

NOTHING, RAISED, UPDATED, CLEARED = range(-1, 3)
_SPIKE_TIME = NANOSECONDS
"""Excursions shorter than the dwell are a fault of kind spike if enough of them come within that
time, and until there has been none for as long [ns]."""
_DECIDED = NANOSECONDS
"""The kind is settled so long after the alarm [ns]."""
_LOOK = 50_000_000
"""Interval of classification and of the test for noise and stuck readings [ns]."""
_RECENT = 50
"""Samples that show noise and standstill."""
_NOISY = 150
"""Readings before so many samples were not yet noisy when noise is seen first."""
_BEFORE = 2.0
"""A course is looked for so many windows back: a slow one began before the window."""
_MOST_GROWTH = 0.25
"""What errors of the rates may add to a residual excuses no more than this part of a fault."""
_MEMORY = 10 * NANOSECONDS
"""A sensor is suspected first for so long after the end of its fault [ns]."""


@njit
def is_compensable(state):
    """Whether `lpv_core.decision.fault_magnitude.removable` may be removed from the reading."""
    return state.alarm and state.kind != INCONSISTENT


@njit
def is_unexplained(state):
    """Whether a reading has changed, and no rate sensor was convicted of it either."""
    return (
        state.alarm and state.kind == INCONSISTENT and state.by_change and not state.rate_implicated
    )


@njit
def suspected(state):
    """What an abrupt change that is not confirmed yet would be as a fault [rad], else 0."""
    if state.alarm or state.since == NEVER or state.window != 0:
        return 0.0
    return state.sample.residual - state.before


@njit
def decide(params, state, stamps, values) -> int:
    """Decide on the sample in ``state.sample``.

    Returns
    -------
    int
        What happened now.
    """
    sample = state.sample
    _update_rate_pull(params, state)
    if sample.missing:
        return _handle_missing(params, state, values)
    state.missing_since = NEVER
    if state.alarm and state.kind == DROPOUT and not _came_back_wrong(params, state):
        return _clear_after_dwell(params, state, True)
    if state.alarm:
        decided = _decide_alarm(params, state, stamps, values)
        follow_fault(params, state)
    else:
        decided = _decide_healthy(params, state, stamps, values)
    state.end = add_sample(
        stamps,
        values,
        state.end,
        sample.stamp,
        sample.residual,
        sample.reading,
        sample.allowance,
        sample.innovation,
    )
    state.last_allowance = sample.allowance
    return decided


@njit
def _update_rate_pull(params, state) -> None:
    """What a wrong rate that moves the residual makes of f^: it forgets with its decay rate.

    A convicted position sensor explains what moves the residual; no rate draws f^ then.
    """
    sample = state.sample
    if state.alarm and state.kind != INCONSISTENT:
        state.rate_pull = 0.0
    elif state.rate_pull_stamp != NEVER:
        interval = max(0.0, (sample.stamp - state.rate_pull_stamp) / NANOSECONDS)
        state.rate_pull += sample.residual - state.last_residual
        state.rate_pull *= max(0.0, 1.0 - params.decay * interval)
    state.rate_pull_stamp, state.last_residual = sample.stamp, sample.residual


@njit
def _gravity_confirms(state):
    """Whether gravity contradicts the reading by more than a wrong rate could have rate_pull f^."""
    sample = state.sample
    return (
        _above(sample)
        and (sample.fault - state.rate_pull) * math.copysign(1.0, sample.fault) > sample.threshold
    )


@njit
def _lasts(since, sample, time) -> bool:
    return sample.stamp - since >= time


@njit
def _start_check_if_due(state) -> bool:
    if state.next_check != NEVER and state.sample.stamp < state.next_check:
        return False
    first = state.next_check == NEVER
    state.next_check = state.sample.stamp + _LOOK
    return not first


# ------------------------------------------------------------------ no reading


@njit
def _handle_missing(params, state, values):
    sample = state.sample
    state.since = state.below_since = NEVER  # what comes next is new evidence
    if state.missing_since == NEVER:
        state.missing_since = sample.stamp
    if state.alarm or not _lasts(state.missing_since, sample, params.dwell):
        return NOTHING
    state.baseline, state.allowance_before = sample.residual, sample.allowance
    if state.end > 0:
        take_baseline(state, values, state.end - 1)
    return _raise(state, DROPOUT, state.missing_since, True, False)


@njit
def _came_back_wrong(params, state) -> bool:
    """Whether readings that are there again are not what dead reckoning expects."""
    state.amount = _size(state)
    if abs(state.amount) <= max(params.changes.smallest, size_error(params, state)):
        return False
    state.kind, state.stepped = UNCLASSIFIED, True
    return True


# ------------------------------------------------------------------ without an alarm


@njit
def _decide_healthy(params, state, stamps, values):
    sample = state.sample
    if state.since != NEVER:
        return _confirm_after_dwell(params, state, stamps, values)
    window, row, before = find_change(params.changes, stamps, values, state.end, sample)
    if window < 0 and not _above(sample):
        return _check_noise_and_stuck(params, state, stamps, values)
    state.since, state.window, state.before = sample.stamp, window, before
    state.allowed = values[row, ALLOWANCE] if window >= 0 else sample.allowance
    return _confirm_after_dwell(params, state, stamps, values)


@njit
def _above(sample) -> bool:
    return not sample.lost and abs(sample.fault) > sample.threshold


@njit
def _confirm_after_dwell(params, state, stamps, values):
    """Evidence since ``since``: confirm it after the dwell, or drop it."""
    d, level = state.sample, _above(state.sample)
    change = abs(d.residual - state.before) if state.window >= 0 else 0.0
    if not level and (
        state.window < 0
        or change <= change_limit(params.changes, state.window, d.allowance - state.allowed)
    ):
        return _discard_excursion(params, state, stamps, values)
    if not _lasts(state.since, d, params.dwell):
        return NOTHING
    if state.window >= 0:
        return _confirm_change(params, state, stamps, values)
    state.baseline, state.allowance_before = 0.0, d.allowance
    state.is_ambiguous = not _gravity_confirms(state)
    kind = INCONSISTENT if d.inconsistent or state.is_ambiguous else UNCLASSIFIED
    decided = _raise(state, kind, state.since, False, False)
    _reclassify(params, state, stamps, values)
    return decided


@njit
def _confirm_change(params, state, stamps, values):
    """Raise an alarm for a change: of the position sensor, or of cause unknown."""
    sample = state.sample
    row = first_since(
        stamps, state.end, state.since - round(_BEFORE * WINDOWS[state.window] * NANOSECONDS)
    )
    take_baseline(state, values, row)
    stepped, speed, onset = fit_step_or_ramp(state, stamps, values, row)
    verdict = RULED_OUT
    if stepped and not _above(sample) and _is_end(state):
        state.since, state.end = NEVER, 0
        return NOTHING
    if stepped:
        take_baseline(state, values, max(0, first_since(stamps, state.end, onset) - 1))
    elif not _gravity_confirms(state):
        verdict = rate_verdict(
            params.rates, stamps, values, state.end, state.baseline, onset, speed
        )
        if verdict == UNDECIDED and has_jumped(params, state, stamps, values):
            verdict = RULED_OUT
    # Whoever lied lately is not given the benefit of the doubt.
    state.is_ambiguous = verdict == UNDECIDED and sample.stamp >= state.recent_fault_until
    wrong_rates = verdict == IMPLICATED or (sample.inconsistent and not stepped)
    kind = INCONSISTENT if state.is_ambiguous or wrong_rates else UNCLASSIFIED
    decided = _raise(state, kind, onset, True, stepped)
    state.rate_implicated = verdict == IMPLICATED
    _reclassify(params, state, stamps, values)
    return decided


@njit
def _is_end(state) -> bool:
    """Whether a jump brings f^ back from where healthy estimates hardly are: more likely the end of
    a fault that stayed unnoticed than a new one that cancels a healthy error."""
    sample = state.sample
    before = sample.fault - (sample.residual - state.before)
    return abs(before) > 0.5 * sample.threshold and abs(sample.fault) < 0.5 * abs(before)


@njit
def _discard_excursion(params, state, stamps, values):
    """An excursion shorter than the dwell is a spike if it was one of the shortest window."""
    sample = state.sample
    if state.window == 0:
        kept = 0
        for k in range(state.spike_count):
            if state.spikes[k] > sample.stamp - _SPIKE_TIME:
                state.spikes[kept] = state.spikes[k]
                kept += 1
        state.spikes[kept] = sample.stamp
        state.spike_count = kept + 1
    state.since = NEVER
    if state.spike_count < SPIKES:
        return NOTHING
    state.spike_count = 0
    onset, state.spikes[0] = state.spikes[0], sample.stamp  # from here on, the latest one
    take_baseline(state, values, max(0, first_since(stamps, state.end, onset - params.dwell) - 1))
    return _raise(state, SPIKE, onset, True, False)


@njit
def _check_noise_and_stuck(params, state, stamps, values):
    """From time to time: readings that stand still, and noise."""
    if not _start_check_if_due(state) or state.end < _RECENT:
        return NOTHING
    scatter = _scatter(state, values)
    if is_stuck(values, state.end, params.noise):
        first = standstill(values, state.end, params.noise)
        kind, row, onset = STUCK, first - 1, stamps[first]
    elif scatter > 3.0 * params.noise:
        kind, row, onset = NOISE, state.end - _NOISY, state.sample.stamp
    else:
        return NOTHING
    take_baseline(state, values, max(row, 0, state.end - len(values) // 2))
    decided = _raise(state, kind, onset, True, False)
    state.scatter = scatter
    return decided


@njit
def _raise(state, kind, onset, by_change, stepped):
    sample = state.sample
    state.alarm, state.kind, state.by_change, state.stepped = True, kind, by_change, stepped
    state.is_ambiguous = state.is_ambiguous and kind == INCONSISTENT
    state.rate_implicated = False
    state.onset, state.detected = onset, sample.stamp
    state.amount = state.reported = _size(state)
    state.level_before = sample.fault - state.amount
    state.peak = abs(state.amount)
    state.since = state.below_since = state.next_check = NEVER
    state.measured, state.filter.used, state.average, state.scatter = UNMEASURED, False, 0.0, 0.0
    return RAISED


@njit
def _size(state):
    return (state.sample.residual if state.by_change else state.sample.fault) - state.baseline


# ------------------------------------------------------------------ with an alarm


@njit
def _decide_alarm(params, state, stamps, values):
    sample = state.sample
    state.amount = _size(state)
    state.peak = max(state.peak, abs(state.amount))
    changing = False
    if state.by_change and state.kind == INCONSISTENT:
        window, _, _ = find_change(params.changes, stamps, values, state.end, sample)
        changing = window >= 0
    decided = _weigh_cause(params, state)
    over = _is_over(params, state, values, changing)
    waited = _clear_after_dwell(params, state, over)
    if over or decided != NOTHING:
        return waited if waited != NOTHING else decided
    if _start_check_if_due(state):
        if _retest_rate_sensor(params, state, stamps, values) or _reclassify(
            params, state, stamps, values
        ):
            decided = UPDATED
        if state.kind == NOISE or state.kind == SPIKE:
            state.scatter = _scatter(state, values)
        if state.measured == UNMEASURED and state.stepped:
            measure_step(state, stamps, values)
    if state.kind == SPIKE or state.kind == NOISE:
        return decided
    if abs(state.amount - state.reported) > max(sample.threshold, 0.5 * abs(state.reported)):
        decided = UPDATED
    if decided == UPDATED:
        state.reported = state.amount
    return decided


@njit
def _weigh_cause(params, state):
    """Whether it is the position sensor at all; UPDATED if that is seen otherwise now."""
    sample = state.sample
    if state.is_ambiguous and not sample.inconsistent:
        if not _gravity_confirms(state) or sample.fault * state.amount <= 0.0:
            return NOTHING
        state.is_ambiguous, state.kind = False, UNCLASSIFIED
        return UPDATED
    state.is_ambiguous = False
    if state.kind == INCONSISTENT or not (state.kind <= SCALE or state.kind == UNCLASSIFIED):
        return NOTHING
    # Wrong rates, torques or a wrong model feign courses, as long as there is no step; rates that
    # are wrong for long move the residual away from what gravity says.
    apart = (
        state.by_change
        and not sample.lost
        and (abs(sample.fault - state.amount) > sample.threshold + size_error(params, state))
    )
    if not apart and (state.stepped or not sample.inconsistent):
        return NOTHING
    state.kind = INCONSISTENT
    return UPDATED


@njit
def _retest_rate_sensor(params, state, stamps, values) -> bool:
    """Whether a doubt is over, now that more samples show what the rate did at the onset."""
    sample = state.sample
    if (
        not (state.is_ambiguous and state.by_change)
        or sample.inconsistent
        or _lasts(state.detected, sample, _DECIDED)
    ):
        return False
    row = first_since(stamps, state.end, 2 * state.onset - sample.stamp)
    _, speed, onset = fit_step_or_ramp(state, stamps, values, row)
    verdict = rate_verdict(params.rates, stamps, values, state.end, state.baseline, onset, speed)
    state.is_ambiguous, state.rate_implicated = verdict == UNDECIDED, verdict == IMPLICATED
    if verdict == RULED_OUT:
        state.kind = UNCLASSIFIED
    return verdict == RULED_OUT


@njit
def _is_over(params, state, values, changing):
    sample = state.sample
    if state.kind == SPIKE or state.kind == NOISE or state.kind == STUCK:
        return _has_settled(params, state, values)
    if not state.by_change:
        # A link without gravity information does not renew a level.
        return not sample.lost and abs(state.amount) <= params.hysteresis * sample.threshold
    if state.kind == INCONSISTENT:
        # Errors of the rates stay in the residual when they are over.
        back = abs(sample.fault - state.level_before) <= max(
            0.5 * abs(state.amount), params.changes.smallest
        )
        return back and not changing and not _above(sample)
    level = params.hysteresis * min(sample.threshold, least_change(params.changes)) + min(
        growth(params, state), _MOST_GROWTH * state.peak
    )
    if (
        state.kind == SCALE
        and abs(state.filter.scale * (sample.reading - state.amount)) <= 2.0 * level
    ):
        return False  # the fault is small where the angle is
    return abs(state.amount) <= level and not _above(sample)


@njit
def _has_settled(params, state, values) -> bool:
    """Whether a fault without a lasting size is over."""
    d, recent = state.sample, values[max(0, state.end - _RECENT) : state.end]
    if len(recent) < 10:
        return False
    if state.kind == SPIKE and d.stamp - state.spikes[0] < _SPIKE_TIME:
        return False
    if state.kind == STUCK and span(recent[:, READING]) < params.noise:
        return False  # a healthy reading shows its noise even at rest
    limit = max(least_change(params.changes), params.hysteresis * d.threshold)
    if abs(state.amount) >= limit + growth(params, state):
        return False
    return _scatter(state, values) < 2.0 * params.noise and not is_stuck(
        values, state.end, params.noise
    )


@njit
def _clear_after_dwell(params, state, over):
    if not over or params.latch:
        state.below_since = NEVER
        return NOTHING
    if state.below_since == NEVER:
        state.below_since = state.sample.stamp
    if not _lasts(state.below_since, state.sample, params.clear_dwell):
        return NOTHING
    state.alarm, state.below_since, state.next_check = False, NEVER, NEVER
    if state.kind != INCONSISTENT:
        state.recent_fault_until = state.sample.stamp + _MEMORY
    if state.kind != SPIKE:
        # Changes are counted from here on: the end of a fault is not the start of one.
        state.end = 0
    return CLEARED


@njit
def _scatter(state, values):
    return noise_level(values[max(0, state.end - _RECENT) : state.end])


@njit
def _reclassify(params, state, stamps, values) -> bool:
    """Name the kind anew; whether it is another one."""
    if state.is_ambiguous and state.by_change:  # what no rate sensor does
        stuck = is_stuck(values, state.end, params.noise)
        if stuck or state.end >= _RECENT and _scatter(state, values) > 3.0 * params.noise:
            state.is_ambiguous, state.kind = False, STUCK if stuck else NOISE
            return True
    if state.kind == INCONSISTENT or STUCK <= state.kind <= NOISE or state.kind == DROPOUT:
        return False
    if state.kind == SPIKE:
        if _scatter(state, values) <= 3.0 * params.noise:
            return False
        state.kind = NOISE
        return True
    # Later courses are those of the arm more than of the fault; but motion tells a scale error.
    late = state.kind != UNCLASSIFIED and _lasts(state.detected, state.sample, _DECIDED)
    row = first_since(stamps, state.end, state.onset)
    kind = classify(stamps, values, row, state.end, state.onset, state.baseline, params.noise)
    if kind == state.kind or kind == UNCLASSIFIED:
        return False
    time = (stamps[row : state.end] - state.onset) / NANOSECONDS
    if late and not fits_better(kind, state.kind, time, values[row : state.end], state.baseline):
        return False
    state.kind = kind
    if kind == SCALE:
        start_scale(params, state, values, row)
    return True
