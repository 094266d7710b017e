"""Where a change of a residual comes from: when it began, from what, and through whose fault."""

import math

from lpv_core.change_test import WINDOWS
from lpv_core.history import ALLOWANCE, RESIDUAL, first_since, median_before
from lpv_core.jit import njit
from lpv_core.observer import NANOSECONDS
from lpv_core.rate_fault import INNOCENT, UNKNOWN, rate_verdict

AROUND = 50
"""Samples before a fault that its size is measured from."""
_OUT = 4.0
"""A residual so many standard deviations away is out of the noise."""
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
def _leaving(c, s, values, row):
    """First row after which the residual stays out of the noise around its baseline."""
    first = s.end
    while first > row and abs(values[first - 1, RESIDUAL] - s.baseline) > _OUT * c.noise:
        first -= 1
    return first


@njit
def find_slope(c, s, stamps, values, row):
    """Mean speed of a residual that moves, and when it began.

    Parameters
    ----------
    c, s, stamps, values
        See `lpv_core.sensor_record`.
    row : int
        Last row before the motion.

    Returns
    -------
    tuple of float and int
        [rad/s], [ns].
    """
    first = _leaving(c, s, values, row)
    left = stamps[first] if first < s.end else s.since
    away, hidden = s.sample.residual - s.baseline, _OUT * c.noise
    time = max(s.sample.stamp - left, 1)
    moved = max(abs(away) - hidden, hidden)
    onset = left - round(min(hidden / moved, 1.0) * time)
    return math.copysign(moved, away) / time * NANOSECONDS, onset


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


@njit
def is_step(s, stamps, values):
    """Whether most of a change came from one sample to the next.

    A reading can jump; what wrong rates do to the residual takes time.

    Parameters
    ----------
    s, stamps, values
        See `lpv_core.sensor_record`.

    Returns
    -------
    bool
        True for a jump.
    """
    start = s.since - round(1.5 * WINDOWS[s.window] * NANOSECONDS)
    row = first_since(stamps, s.end, start)
    largest = 0.0
    for k in range(row, s.end):
        after = values[k + 1, RESIDUAL] if k + 1 < s.end else s.sample.residual
        largest = max(largest, abs(after - values[k, RESIDUAL]))
    return largest >= 0.5 * abs(s.sample.residual - s.before)
