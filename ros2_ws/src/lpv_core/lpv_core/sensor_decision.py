"""The decision about one position sensor: when a fault is confirmed, of which kind, and when over.

Three kinds of evidence count: the level of the fault estimate against its guaranteed bound, its
change over several windows (`lpv_core.change_test`), and missing data.  Evidence must last for the
dwell; shorter excursions are spikes.

All functions take the constants ``c`` (`SENSOR_CONSTANTS`), the state ``s`` (`SENSOR_STATE`), the
sensor's past ``stamps`` and ``values`` (`lpv_core.history`) and the present sample ``d``
(`SAMPLE`).  A decision is `NOTHING`, `RAISED`, `UPDATED` or `CLEARED`.
"""

from lpv_core.change_test import CHANGE_TEST, WINDOWS, change_limit, find_change
from lpv_core.fault_kind import (
    BIAS,
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
    shows_scale,
    span,
    step_of,
)
from lpv_core.history import EXPECTED, FAULT, READING, add_sample, first_since, median_before
from lpv_core.jit import njit
from lpv_core.observer import NANOSECONDS
from lpv_core.records import NEVER, record_type

NOTHING, RAISED, UPDATED, CLEARED = range(-1, 3)
_SPIKES = 3
"""So many excursions shorter than the dwell within `_SPIKE_TIME` are a fault of kind spike."""
_SPIKE_TIME = NANOSECONDS
_DECIDED = NANOSECONDS
"""The kind is settled so long after the alarm [ns]."""
_LOOK = 50_000_000
"""Interval of classification and of the test for noise and stuck readings [ns]."""
_RECENT = 50
"""Samples that show noise and standstill."""
_AROUND = 50
"""Samples before a step that its height is measured from."""
_MEAN_SHARE = 0.005
"""Share of a sample in the mean of a noisy reading."""
_DOUBT = 10.0
"""A bias from which f^ differs by so much, over the noise, may be a scale error where that fits."""
_DOUBTED, _UNMEASURED, _MEASURED, _IMPOSSIBLE = range(-4, 0)
"""Why there is no formula (yet)."""

SENSOR_CONSTANTS = record_type(
    ('changes', CHANGE_TEST), ('noise', 'f8'), ('dwell', 'i8'), ('clear_dwell', 'i8'),
    ('hysteresis', 'f8'), ('latch', '?'))
"""Limits of changes; standard deviation of readings [rad]; dwells [ns]; the rest as in
`DiagnosisParameters`."""

SAMPLE = record_type(
    ('stamp', 'i8'), ('fault', 'f8'), ('reading', 'f8'), ('expected', 'f8'), ('threshold', 'f8'),
    ('speed', 'f8'), ('missing', '?'), ('lost', '?'), ('inconsistent', '?'))
"""What is known of one sensor at one sample.

stamp [ns]; f^, y_p, S theta^ [rad]; the level that a healthy estimate stays below [rad]; bound on
the speed of the estimate's healthy error [rad/s]; no reading; gravity does not renew the estimate,
its level is no evidence; rates, torques and model contradict each other.
"""

SENSOR_STATE = record_type(
    # The alarm: whether there is one, its kind (index into KINDS), first and deciding sample [ns],
    # amount: change since the onset, or level [rad]; whether it rests on a change, and on a jump.
    ('alarm', '?'), ('kind', 'i8'), ('onset', 'i8'), ('detected', 'i8'), ('amount', 'f8'),
    ('by_change', '?'), ('stepped', '?'), ('reported', 'f8'), ('peak', 'f8'), ('baseline', 'f8'),
    # Evidence that is not confirmed: since when, over which window, f^ before it [rad].
    ('since', 'i8'), ('window', 'i8'), ('before', 'f8'), ('missing_since', 'i8'),
    ('below_since', 'i8'), ('look_at', 'i8'), ('spikes', 'i8', (_SPIKES,)),
    ('spike_count', 'i8'), ('end', 'i8'),
    # The fault as a formula of the reading: kind (or why there is none), whether motion has shown
    # which, height of the step and true reading at it [rad], by what f^ differs from the formula,
    # mean of a noisy reading [rad].
    ('formula', 'i8'), ('told', '?'), ('height', 'f8'), ('level', 'f8'), ('rest', 'f8'),
    ('average', 'f8'), ('sample', SAMPLE))


@njit
def reset_sensor(s):
    """Clear alarm and past."""
    s.end = 0
    s.alarm, s.kind, s.by_change, s.stepped = False, UNCLASSIFIED, False, False
    s.onset = s.detected = 0
    s.amount = s.reported = s.peak = s.baseline = s.average = 0.0
    s.formula = _UNMEASURED
    forget(s)


@njit
def forget(s):
    """Drop evidence that is not confirmed yet, and what depends on old stamps."""
    s.since = s.below_since = s.missing_since = s.look_at = NEVER
    s.window, s.before, s.spike_count = -1, 0.0, 0


@njit
def restart_sensor(s):
    """Time started anew: stamps of before mean nothing; an alarm stays."""
    s.end = 0
    forget(s)


@njit
def is_compensable(s):
    """Whether `removable` may be removed from the reading."""
    return s.alarm and s.kind != DROPOUT and s.kind != INCONSISTENT


@njit
def removable(c, s):
    """What is to be removed from the reading of a sensor with an alarm.

    A step or a scale error whose size is known leaves a reading as good as that of a healthy
    sensor; of noise, its mean remains; spikes go one by one; else f^ itself, so that the loop
    closes on the state estimate.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.

    Returns
    -------
    float
        [rad].
    """
    if s.kind == SPIKE:
        away = s.amount - s.average
        return away if abs(away) > change_limit(c.changes, 0, s.sample.speed) else 0.0
    if s.kind == NOISE:
        return s.amount - s.average
    return _by_formula(s) if s.formula >= 0 else s.amount


@njit
def _by_formula(s):
    return s.height if s.formula == BIAS else _by_scale(s)


@njit
def _by_scale(s):
    return s.sample.reading * s.height / (s.level + s.height)


@njit
def suspected(s):
    """What an abrupt change that is not confirmed yet would be as a fault [rad], else 0."""
    if s.alarm or s.since == NEVER or s.window != 0:
        return 0.0
    return s.sample.fault - s.before


@njit
def decide(c, s, stamps, values):
    """Decide on the sample in ``s.sample``.

    Returns
    -------
    int
        What happened now.
    """
    d = s.sample
    if d.missing:
        return _silent(c, s)
    s.missing_since = NEVER
    if s.alarm and s.kind == DROPOUT:
        return _wait(c, s, True)
    if s.alarm:
        decided = _decide_alarm(c, s, stamps, values)
        _follow_fault(c, s)
    else:
        decided = _decide_healthy(c, s, stamps, values)
    s.end = add_sample(stamps, values, s.end, d.stamp, d.fault, d.reading, d.expected)
    return decided


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
def _silent(c, s):
    d = s.sample
    s.since = s.below_since = NEVER  # what comes next is new evidence
    if s.missing_since == NEVER:
        s.missing_since = d.stamp
    if s.alarm or not _lasts(s.missing_since, d, c.dwell):
        return NOTHING
    s.baseline = d.fault
    return _raise(c, s, DROPOUT, s.missing_since, False, False)


# ------------------------------------------------------------------ without an alarm


@njit
def _decide_healthy(c, s, stamps, values):
    d = s.sample
    if s.since != NEVER:
        return _pending(c, s, stamps, values)
    window, before = find_change(c.changes, stamps, values, s.end, d.stamp, d.fault, d.speed)
    if window < 0 and not _above(d):
        return _look(c, s, values)
    s.since, s.window, s.before = d.stamp, window, before
    return _pending(c, s, stamps, values)


@njit
def _above(d):
    return not d.lost and abs(d.fault) > d.threshold


@njit
def _pending(c, s, stamps, values):
    """Evidence since ``since``: confirm it after the dwell, or drop it."""
    d, level = s.sample, _above(s.sample)
    change = s.window >= 0 and (abs(d.fault - s.before)
                                > change_limit(c.changes, s.window, d.speed))
    if not (change or level):
        return _drop(c, s)
    if not _lasts(s.since, d, c.dwell):
        return NOTHING
    if not level and abs(d.fault) < 0.5 * abs(s.before):
        # Back towards zero: more likely the end of a fault that stayed unnoticed than a new
        # one that cancels a healthy error.
        s.since = NEVER
        s.end = 0
        return NOTHING
    s.baseline = s.before if s.window >= 0 else 0.0
    stepped = s.window >= 0 and _is_step(s, stamps, values)
    kind = INCONSISTENT if d.inconsistent and not stepped else UNCLASSIFIED
    decided = _raise(c, s, kind, s.since, s.window >= 0, stepped)
    if kind == UNCLASSIFIED:
        _name(c, s, stamps, values)
    return decided


@njit
def _is_step(s, stamps, values):
    """Whether most of a change came from one sample to the next.

    A reading can jump; what wrong rates, torques or models do to the estimate takes time.
    """
    start = s.since - round(1.5 * WINDOWS[s.window] * NANOSECONDS)
    row = first_since(stamps, s.end, start)
    largest = 0.0
    for k in range(row, s.end):
        after = values[k + 1, FAULT] if k + 1 < s.end else s.sample.fault
        largest = max(largest, abs(after - values[k, FAULT]))
    return largest >= 0.5 * abs(s.sample.fault - s.before)


@njit
def _drop(c, s):
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
    if s.spike_count < _SPIKES:
        return NOTHING
    s.spike_count = 0
    s.baseline = s.before
    return _raise(c, s, SPIKE, s.spikes[0], True, False)


@njit
def _look(c, s, values):
    """From time to time: readings that stand still, and noise."""
    if not _due(s) or s.end < _RECENT:
        return NOTHING
    recent = values[s.end - _RECENT:s.end]
    if is_stuck(recent, c.noise):
        kind = STUCK
    elif noise_level(recent) > 3.0 * c.noise:
        kind = NOISE
    else:
        return NOTHING
    s.baseline = median_before(values, s.end - 1)
    return _raise(c, s, kind, s.sample.stamp, True, False)


@njit
def _raise(c, s, kind, onset, by_change, stepped):
    d = s.sample
    s.alarm, s.kind, s.by_change, s.stepped = True, kind, by_change, stepped
    s.onset, s.detected = onset, d.stamp
    s.amount = s.reported = d.fault - s.baseline
    s.peak = abs(s.amount)
    s.since = s.below_since = s.look_at = NEVER
    s.formula, s.told, s.average = _UNMEASURED, False, 0.0
    return RAISED


# ------------------------------------------------------------------ with an alarm


@njit
def _decide_alarm(c, s, stamps, values):
    d = s.sample
    s.amount = d.fault - s.baseline
    s.peak = max(s.peak, abs(s.amount))
    course = s.kind <= SCALE or s.kind == UNCLASSIFIED
    if d.inconsistent and not s.stepped and course:
        # Wrong rates, torques or a wrong model feign courses, as long as there is no step.
        s.kind = INCONSISTENT
        return UPDATED
    if s.kind == SPIKE or s.kind == NOISE or s.kind == STUCK:
        over = _quiet(c, s, values)
    else:
        # A link without gravity information does not renew a level; a change it still sees.
        over = (s.by_change or not d.lost) and abs(s.amount) <= _clear_level(c, s)
    decided = _wait(c, s, over)
    if over:
        return decided
    if decided == NOTHING and _due(s):
        if _name(c, s, stamps, values):
            decided = UPDATED
        if s.kind != UNCLASSIFIED:
            _find_formula(c, s, stamps, values)
    if s.kind == SPIKE or s.kind == NOISE:
        return decided
    if abs(s.amount - s.reported) > max(d.threshold, 0.5 * abs(s.reported)):
        decided = UPDATED
    if decided == UPDATED:
        s.reported = s.amount
    return decided


@njit
def _clear_level(c, s):
    level = s.sample.threshold
    if s.by_change:
        change = 2.0 * change_limit(c.changes, 0, s.sample.speed)
        level = min(level, max(change, 0.5 * s.peak))
    return c.hysteresis * level


@njit
def _quiet(c, s, values):
    """Whether a fault without a lasting size is over."""
    d, recent = s.sample, values[max(0, s.end - _RECENT):s.end]
    if len(recent) < 10:
        return False
    if s.kind == STUCK and span(recent, READING, 0) < c.noise:
        return False  # a healthy reading shows its noise even at rest
    if abs(s.amount) >= max(change_limit(c.changes, 0, d.speed), c.hysteresis * d.threshold):
        return False
    return noise_level(recent) < 2.0 * c.noise and not is_stuck(recent, c.noise)


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
    # Changes are counted from here on: the end of a fault is not the start of one.
    s.end = 0
    return CLEARED


@njit
def _name(c, s, stamps, values):
    """Name the kind anew; whether it is another one."""
    if s.kind == INCONSISTENT or s.kind == DROPOUT or s.kind == STUCK:
        return False
    if s.kind == SPIKE:
        if noise_level(values[max(0, s.end - _RECENT):s.end]) <= 3.0 * c.noise:
            return False
        s.kind = NOISE
        return True
    # Later courses are those of the arm more than of the fault; but motion tells a scale error.
    late = s.kind != UNCLASSIFIED and _lasts(s.detected, s.sample, _DECIDED)
    if late and s.kind != BIAS and s.kind != SCALE:
        return False
    row = first_since(stamps, s.end, s.onset)
    kind = classify(stamps[row:s.end], values[row:s.end], s.onset, s.baseline, c.noise)
    if kind == s.kind or kind == UNCLASSIFIED:
        return False
    if late and not fits_better(kind, s.kind, values[row:s.end], s.baseline):
        return False
    s.kind = kind
    return True


# ------------------------------------------------------------------ size of a known fault


@njit
def _measure_step(s, stamps, values):
    """Height of a step and the true reading at it, as soon as there are samples around it."""
    row = first_since(stamps, s.end, s.onset)
    first = max(row - _AROUND, 0, s.end - len(stamps) // 2)
    if row - first < _AROUND // 2 or s.end - row < _AROUND // 2:
        s.formula = _IMPOSSIBLE
        return
    last = min(row + _AROUND, s.end)
    s.height = step_of(stamps[first:last], values[first:last], row - first)
    s.level = values[row - 1, EXPECTED] + s.baseline
    s.formula = _MEASURED


@njit
def _find_formula(c, s, stamps, values):
    """Take the formula of the kind; motion has to tell a bias from a scale error."""
    if s.formula == _UNMEASURED and s.stepped:
        _measure_step(s, stamps, values)
    if not s.told:
        row = first_since(stamps, s.end, s.onset)
        s.told = shows_scale(values[row:s.end], s.baseline, c.noise)
        if s.formula == _DOUBTED and s.told:
            s.formula = _MEASURED
    if s.formula != _MEASURED or (s.kind != BIAS and s.kind != SCALE):
        return
    if abs(s.level + s.height) > 0.1 * abs(s.height):
        s.formula = s.kind
        s.rest = s.amount - _by_formula(s)


@njit
def _follow_fault(c, s):
    """Drop the formula when f^ leaves it: the fault is over, or another one has come."""
    d, limit = s.sample, change_limit(c.changes, 0, s.sample.speed)
    if s.kind == NOISE or (s.kind == SPIKE and abs(s.amount - s.average) <= limit):
        s.average += _MEAN_SHARE * (s.amount - s.average)
    if s.formula < 0:
        return
    rest = s.amount - _by_formula(s)
    if abs(rest - s.rest) > limit or abs(rest) > d.threshold:
        s.formula = _IMPOSSIBLE
    elif s.kind != s.formula:
        s.formula = _MEASURED
    elif not s.told and abs(rest) > _DOUBT * c.noise and (
            2.0 * abs(s.amount - _by_scale(s)) < abs(rest)):
        s.formula = _DOUBTED
    s.rest = rest
