"""The decision about one position sensor: when a fault is confirmed, of which kind, and when over.

Three kinds of evidence count: the level of the fault estimate against its guaranteed bound, changes
of the residual over several windows (`lpv_core.change_test`), and missing data.  Evidence must last
for the dwell; shorter excursions are spikes.

A fault that was seen as a change is measured by the residual, against what it was before: the level
is only known within its bound, and its healthy error moves.

All functions take the records of `lpv_core.sensor_record`.  A decision is `NOTHING`,
`RAISED`, `UPDATED` or `CLEARED`.
"""

import math

from lpv_core.change_origin import fit_course, has_jumped, take_baseline
from lpv_core.change_test import WINDOWS, change_limit, find_change, least_change
from lpv_core.fault_kind import (
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
from lpv_core.fault_size import follow_fault, growth, measure_step, size_error
from lpv_core.history import ALLOWANCE, READING, add_sample, first_since
from lpv_core.jit import njit
from lpv_core.observer import NANOSECONDS
from lpv_core.rate_fault import GUILTY, INNOCENT, UNKNOWN, rate_verdict
from lpv_core.records import NEVER
from lpv_core.scale_filter import start_scale
from lpv_core.sensor_record import SPIKES, UNMEASURED

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
def is_compensable(s):
    """Whether `lpv_core.fault_size.removable` may be removed from the reading."""
    return s.alarm and s.kind != INCONSISTENT


@njit
def is_unexplained(s):
    """Whether a reading has changed, and no rate sensor was convicted of it either."""
    return s.alarm and s.kind == INCONSISTENT and s.by_change and not s.acquitted


@njit
def suspected(s):
    """What an abrupt change that is not confirmed yet would be as a fault [rad], else 0."""
    if s.alarm or s.since == NEVER or s.window != 0:
        return 0.0
    return s.sample.residual - s.before


@njit
def decide(c, s, stamps, values):
    """Decide on the sample in ``s.sample``.

    Returns
    -------
    int
        What happened now.
    """
    d = s.sample
    _draw(c, s)
    if d.missing:
        return _silent(c, s, values)
    s.missing_since = NEVER
    if s.alarm and s.kind == DROPOUT and not _came_back_wrong(c, s):
        return _wait(c, s, True)
    if s.alarm:
        decided = _decide_alarm(c, s, stamps, values)
        follow_fault(c, s)
    else:
        decided = _decide_healthy(c, s, stamps, values)
    s.end = add_sample(stamps, values, s.end, d.stamp, d.residual, d.reading,
                       d.allowance, d.innovation)
    s.last_allowance = d.allowance
    return decided


@njit
def _draw(c, s):
    """What a wrong rate that moves the residual makes of f^: it forgets with its decay rate.

    A convicted position sensor explains what moves the residual; no rate draws f^ then.
    """
    d = s.sample
    if s.alarm and s.kind != INCONSISTENT:
        s.drawn = 0.0
    elif s.drawn_at != NEVER:
        interval = max(0.0, (d.stamp - s.drawn_at) / NANOSECONDS)
        s.drawn += d.residual - s.last_residual
        s.drawn *= max(0.0, 1.0 - c.decay * interval)
    s.drawn_at, s.last_residual = d.stamp, d.residual


@njit
def _convicts(s):
    """Whether gravity contradicts the reading by more than a wrong rate could have drawn f^."""
    d = s.sample
    return _above(d) and (d.fault - s.drawn) * math.copysign(1.0, d.fault) > d.threshold


@njit
def _lasts(since, d, time):
    return d.stamp - since >= time


@njit
def _due(s):
    if s.look_at != NEVER and s.sample.stamp < s.look_at:
        return False
    first = s.look_at == NEVER
    s.look_at = s.sample.stamp + _LOOK
    return not first


# ------------------------------------------------------------------ no reading


@njit
def _silent(c, s, values):
    d = s.sample
    s.since = s.below_since = NEVER  # what comes next is new evidence
    if s.missing_since == NEVER:
        s.missing_since = d.stamp
    if s.alarm or not _lasts(s.missing_since, d, c.dwell):
        return NOTHING
    s.baseline, s.allowance_before = d.residual, d.allowance
    if s.end > 0:
        take_baseline(s, values, s.end - 1)
    return _raise(s, DROPOUT, s.missing_since, True, False)


@njit
def _came_back_wrong(c, s):
    """Whether readings that are there again are not what dead reckoning expects."""
    s.amount = _size(s)
    if abs(s.amount) <= max(c.changes.smallest, size_error(c, s)):
        return False
    s.kind, s.stepped = UNCLASSIFIED, True
    return True


# ------------------------------------------------------------------ without an alarm


@njit
def _decide_healthy(c, s, stamps, values):
    d = s.sample
    if s.since != NEVER:
        return _pending(c, s, stamps, values)
    window, row, before = find_change(c.changes, stamps, values, s.end, d)
    if window < 0 and not _above(d):
        return _look(c, s, stamps, values)
    s.since, s.window, s.before = d.stamp, window, before
    s.allowed = values[row, ALLOWANCE] if window >= 0 else d.allowance
    return _pending(c, s, stamps, values)


@njit
def _above(d):
    return not d.lost and abs(d.fault) > d.threshold


@njit
def _pending(c, s, stamps, values):
    """Evidence since ``since``: confirm it after the dwell, or drop it."""
    d, level = s.sample, _above(s.sample)
    change = abs(d.residual - s.before) if s.window >= 0 else 0.0
    if not level and (s.window < 0
                      or change <= change_limit(c.changes, s.window, d.allowance - s.allowed)):
        return _drop(c, s, stamps, values)
    if not _lasts(s.since, d, c.dwell):
        return NOTHING
    if s.window >= 0:
        return _confirm_change(c, s, stamps, values)
    s.baseline, s.allowance_before = 0.0, d.allowance
    s.doubted = not _convicts(s)
    kind = INCONSISTENT if d.inconsistent or s.doubted else UNCLASSIFIED
    decided = _raise(s, kind, s.since, False, False)
    _name(c, s, stamps, values)
    return decided


@njit
def _confirm_change(c, s, stamps, values):
    """Raise an alarm for a change: of the position sensor, or of cause unknown."""
    d = s.sample
    row = first_since(stamps, s.end, s.since - round(_BEFORE * WINDOWS[s.window] * NANOSECONDS))
    take_baseline(s, values, row)
    stepped, speed, onset = fit_course(s, stamps, values, row)
    verdict = INNOCENT
    if stepped and not _above(d) and _is_end(s):
        s.since, s.end = NEVER, 0
        return NOTHING
    if stepped:
        take_baseline(s, values, max(0, first_since(stamps, s.end, onset) - 1))
    elif not _convicts(s):
        verdict = rate_verdict(c.rates, stamps, values, s.end, s.baseline, onset, speed)
        if verdict == UNKNOWN and has_jumped(c, s, stamps, values):
            verdict = INNOCENT
    # Whoever lied lately is not given the benefit of the doubt.
    s.doubted = verdict == UNKNOWN and d.stamp >= s.convicted_until
    wrong_rates = verdict == GUILTY or (d.inconsistent and not stepped)
    kind = INCONSISTENT if s.doubted or wrong_rates else UNCLASSIFIED
    decided = _raise(s, kind, onset, True, stepped)
    s.acquitted = verdict == GUILTY
    _name(c, s, stamps, values)
    return decided


@njit
def _is_end(s):
    """Whether a jump brings f^ back from where healthy estimates hardly are: more likely the end of
    a fault that stayed unnoticed than a new one that cancels a healthy error."""
    d = s.sample
    before = d.fault - (d.residual - s.before)
    return abs(before) > 0.5 * d.threshold and abs(d.fault) < 0.5 * abs(before)


@njit
def _drop(c, s, stamps, values):
    """An excursion shorter than the dwell is a spike if it was one of the shortest window."""
    d = s.sample
    if s.window == 0:
        kept = 0
        for k in range(s.spike_count):
            if s.spikes[k] > d.stamp - _SPIKE_TIME:
                s.spikes[kept] = s.spikes[k]
                kept += 1
        s.spikes[kept] = d.stamp
        s.spike_count = kept + 1
    s.since = NEVER
    if s.spike_count < SPIKES:
        return NOTHING
    s.spike_count = 0
    onset, s.spikes[0] = s.spikes[0], d.stamp  # from here on, the latest one
    take_baseline(s, values, max(0, first_since(stamps, s.end, onset - c.dwell) - 1))
    return _raise(s, SPIKE, onset, True, False)


@njit
def _look(c, s, stamps, values):
    """From time to time: readings that stand still, and noise."""
    if not _due(s) or s.end < _RECENT:
        return NOTHING
    scatter = _scatter(s, values)
    if is_stuck(values, s.end, c.noise):
        first = standstill(values, s.end, c.noise)
        kind, row, onset = STUCK, first - 1, stamps[first]
    elif scatter > 3.0 * c.noise:
        kind, row, onset = NOISE, s.end - _NOISY, s.sample.stamp
    else:
        return NOTHING
    take_baseline(s, values, max(row, 0, s.end - len(values) // 2))
    decided = _raise(s, kind, onset, True, False)
    s.scatter = scatter
    return decided


@njit
def _raise(s, kind, onset, by_change, stepped):
    d = s.sample
    s.alarm, s.kind, s.by_change, s.stepped = True, kind, by_change, stepped
    s.doubted = s.doubted and kind == INCONSISTENT
    s.acquitted = False
    s.onset, s.detected = onset, d.stamp
    s.amount = s.reported = _size(s)
    s.level_before = d.fault - s.amount
    s.peak = abs(s.amount)
    s.since = s.below_since = s.look_at = NEVER
    s.measured, s.filter.used, s.average, s.scatter = UNMEASURED, False, 0.0, 0.0
    return RAISED


@njit
def _size(s):
    return (s.sample.residual if s.by_change else s.sample.fault) - s.baseline


# ------------------------------------------------------------------ with an alarm


@njit
def _decide_alarm(c, s, stamps, values):
    d = s.sample
    s.amount = _size(s)
    s.peak = max(s.peak, abs(s.amount))
    changing = False
    if s.by_change and s.kind == INCONSISTENT:
        window, _, _ = find_change(c.changes, stamps, values, s.end, d)
        changing = window >= 0
    decided = _weigh_cause(c, s)
    over = _is_over(c, s, values, changing)
    waited = _wait(c, s, over)
    if over or decided != NOTHING:
        return waited if waited != NOTHING else decided
    if _due(s):
        if _judge_again(c, s, stamps, values) or _name(c, s, stamps, values):
            decided = UPDATED
        if s.kind == NOISE or s.kind == SPIKE:
            s.scatter = _scatter(s, values)
        if s.measured == UNMEASURED and s.stepped:
            measure_step(s, stamps, values)
    if s.kind == SPIKE or s.kind == NOISE:
        return decided
    if abs(s.amount - s.reported) > max(d.threshold, 0.5 * abs(s.reported)):
        decided = UPDATED
    if decided == UPDATED:
        s.reported = s.amount
    return decided


@njit
def _weigh_cause(c, s):
    """Whether it is the position sensor at all; UPDATED if that is seen otherwise now."""
    d = s.sample
    if s.doubted and not d.inconsistent:
        if not _convicts(s) or d.fault * s.amount <= 0.0:
            return NOTHING
        s.doubted, s.kind = False, UNCLASSIFIED
        return UPDATED
    s.doubted = False
    if s.kind == INCONSISTENT or not (s.kind <= SCALE or s.kind == UNCLASSIFIED):
        return NOTHING
    # Wrong rates, torques or a wrong model feign courses, as long as there is no step; rates that
    # are wrong for long move the residual away from what gravity says.
    apart = s.by_change and not d.lost and (
        abs(d.fault - s.amount) > d.threshold + size_error(c, s))
    if not apart and (s.stepped or not d.inconsistent):
        return NOTHING
    s.kind = INCONSISTENT
    return UPDATED


@njit
def _judge_again(c, s, stamps, values):
    """Whether a doubt is over, now that more samples show what the rate did at the onset."""
    d = s.sample
    if not (s.doubted and s.by_change) or d.inconsistent or _lasts(s.detected, d, _DECIDED):
        return False
    row = first_since(stamps, s.end, 2 * s.onset - d.stamp)
    _, speed, onset = fit_course(s, stamps, values, row)
    verdict = rate_verdict(c.rates, stamps, values, s.end, s.baseline, onset, speed)
    s.doubted, s.acquitted = verdict == UNKNOWN, verdict == GUILTY
    if verdict == INNOCENT:
        s.kind = UNCLASSIFIED
    return verdict == INNOCENT


@njit
def _is_over(c, s, values, changing):
    d = s.sample
    if s.kind == SPIKE or s.kind == NOISE or s.kind == STUCK:
        return _quiet(c, s, values)
    if not s.by_change:
        # A link without gravity information does not renew a level.
        return not d.lost and abs(s.amount) <= c.hysteresis * d.threshold
    if s.kind == INCONSISTENT:
        # Errors of the rates stay in the residual when they are over.
        back = abs(d.fault - s.level_before) <= max(0.5 * abs(s.amount), c.changes.smallest)
        return back and not changing and not _above(d)
    level = (c.hysteresis * min(d.threshold, least_change(c.changes))
             + min(growth(c, s), _MOST_GROWTH * s.peak))
    if s.kind == SCALE and abs(s.filter.scale * (d.reading - s.amount)) <= 2.0 * level:
        return False  # the fault is small where the angle is
    return abs(s.amount) <= level and not _above(d)


@njit
def _quiet(c, s, values):
    """Whether a fault without a lasting size is over."""
    d, recent = s.sample, values[max(0, s.end - _RECENT):s.end]
    if len(recent) < 10:
        return False
    if s.kind == SPIKE and d.stamp - s.spikes[0] < _SPIKE_TIME:
        return False
    if s.kind == STUCK and span(recent[:, READING]) < c.noise:
        return False  # a healthy reading shows its noise even at rest
    limit = max(least_change(c.changes), c.hysteresis * d.threshold)
    if abs(s.amount) >= limit + growth(c, s):
        return False
    return _scatter(s, values) < 2.0 * c.noise and not is_stuck(values, s.end, c.noise)


@njit
def _wait(c, s, over):
    if not over or c.latch:
        s.below_since = NEVER
        return NOTHING
    if s.below_since == NEVER:
        s.below_since = s.sample.stamp
    if not _lasts(s.below_since, s.sample, c.clear_dwell):
        return NOTHING
    s.alarm, s.below_since, s.look_at = False, NEVER, NEVER
    if s.kind != INCONSISTENT:
        s.convicted_until = s.sample.stamp + _MEMORY
    if s.kind != SPIKE:
        # Changes are counted from here on: the end of a fault is not the start of one.
        s.end = 0
    return CLEARED


@njit
def _scatter(s, values):
    return noise_level(values[max(0, s.end - _RECENT):s.end])


@njit
def _name(c, s, stamps, values):
    """Name the kind anew; whether it is another one."""
    if s.doubted and s.by_change:  # what no rate sensor does
        stuck = is_stuck(values, s.end, c.noise)
        if stuck or s.end >= _RECENT and _scatter(s, values) > 3.0 * c.noise:
            s.doubted, s.kind = False, STUCK if stuck else NOISE
            return True
    if s.kind == INCONSISTENT or STUCK <= s.kind <= NOISE or s.kind == DROPOUT:
        return False
    if s.kind == SPIKE:
        if _scatter(s, values) <= 3.0 * c.noise:
            return False
        s.kind = NOISE
        return True
    # Later courses are those of the arm more than of the fault; but motion tells a scale error.
    late = s.kind != UNCLASSIFIED and _lasts(s.detected, s.sample, _DECIDED)
    row = first_since(stamps, s.end, s.onset)
    kind = classify(stamps, values, row, s.end, s.onset, s.baseline, c.noise)
    if kind == s.kind or kind == UNCLASSIFIED:
        return False
    time = (stamps[row:s.end] - s.onset) / NANOSECONDS
    if late and not fits_better(kind, s.kind, time, values[row:s.end], s.baseline):
        return False
    s.kind = kind
    if kind == SCALE:
        start_scale(c, s, values, row)
    return True
