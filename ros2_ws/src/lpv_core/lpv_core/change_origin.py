"""Where a change of a residual comes from: when it began, from what, and through whose fault."""

from lpv_core.history import ALLOWANCE, RESIDUAL, first_since, median_before
from lpv_core.jit import njit
from lpv_core.observer import NANOSECONDS
from lpv_core.rate_fault import INNOCENT, UNKNOWN, rate_verdict

AROUND = 50
"""Samples before a fault that its size is measured from."""
_OUT = 4.0
"""An onset is known within the time in which the residual moves so many standard deviations."""
_FEW = 5
_STRAIGHT = 0.35
"""Half-way in time a straight course has gone half its way, a parabola a quarter."""
_NEAR = 20_000_000
"""Uncertainty of an onset [ns]."""


@njit
def take_baseline(s, values, row):
    """Keep what a fault is measured from.

    Parameters
    ----------
    s, values
        See `lpv_core.sensor_record`.
    row : int
        Last row before the fault.
    """
    s.baseline = median_before(values, row, AROUND)
    s.allowance_before = values[row, ALLOWANCE]


@njit
def fit_course(s, stamps, values, row):
    """Whether a residual has jumped or begun to move, and when.

    A reading can jump; what wrong rates do to the residual takes time.  Least squares fits of a
    step, r_0 + h for t >= t_0, and of a straight course, r_0 + b (t - t_0) for t >= t_0: for each
    t_0 the best h and b follow from sums over the samples since then.

    Parameters
    ----------
    s, stamps, values
        See `lpv_core.sensor_record`; ``s.baseline`` is r_0.
    row : int
        Last row before the change.

    Returns
    -------
    tuple of bool, float and int
        Whether the step fits better; b [rad/s], of no meaning for a step; and t_0 [ns].
    """
    now = s.sample.stamp
    count, times, squares = 1.0, 0.0, 0.0  # the present sample, at time zero
    away, products = s.sample.residual - s.baseline, 0.0
    step, jumped, course, speed, began = away * away, now, 0.0, 0.0, now
    for k in range(s.end - 1, row - 1, -1):
        time, value = (stamps[k] - now) / NANOSECONDS, values[k, RESIDUAL] - s.baseline
        power = squares - 2.0 * time * times + time * time * count
        cross = products - time * away
        if count > 1.0 and cross * cross > course * power:  # one sample alone has jumped
            course, speed, began = cross * cross / power, cross / power, stamps[k]
        count, times, squares = count + 1.0, times + time, squares + time * time
        away, products = away + value, products + value * time
        if away * away > step * count:
            step, jumped = away * away / count, stamps[k]
    stepped = step >= course
    return stepped, speed, jumped if stepped else began


@njit
def _is_straight(s, stamps, values, onset):
    """Whether the residual moved as it does if it started suddenly."""
    middle = first_since(stamps, s.end, (onset + s.sample.stamp) // 2)
    if middle >= s.end:
        return False
    half = median_before(values, middle, _FEW) - s.baseline
    return half / (s.sample.residual - s.baseline) > _STRAIGHT


@njit
def judge_rate(c, s, stamps, values, onset, speed):
    """Whether a slow change may be the rate sensor's.

    Parameters
    ----------
    c, s, stamps, values
        See `lpv_core.sensor_record`.
    onset : int
        When the residual began to move [ns].
    speed : float
        Of the residual [rad/s].

    Returns
    -------
    int
        As `lpv_core.rate_fault.rate_verdict`; a course that did not begin suddenly excuses nobody.
    """
    reach = max(_NEAR, round(_OUT * c.noise / abs(speed) * NANOSECONDS))
    first = first_since(stamps, s.end, onset - reach)
    last = first_since(stamps, s.end, onset + reach)
    verdict = rate_verdict(c.rates, values, s.end, first, last, speed)
    if verdict == INNOCENT and not _is_straight(s, stamps, values, onset):
        return UNKNOWN
    return verdict
