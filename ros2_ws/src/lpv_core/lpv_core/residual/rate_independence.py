"""Whether measured rates are independent of the positions, or derived from them.

Many drivers compute rates as (filtered) differences of the encoder's positions.  Then position and
rate go wrong together, and dead reckoning cannot contradict the reading: drifts, scale errors and
standstill of an encoder are not found, jumps only as long as the rate's spike is seen.

What the arm does is smooth; noise and quantisation are not.  The high-frequency part of a rate that
is derived is a linear combination of that of the differences of positions at neighbouring samples;
that of an independent sensor is not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

INDEPENDENT, DERIVED, NO_RATES, UNDECIDED = range(4)
"""What rates may be."""
RATE_SOURCES = ('independent', 'derived', 'none', 'undecided')
"""Their names; the first three are what an arm file may state."""

_LEAD, _LAGS = 2, 8
"""Differences from so many samples ahead of the rate, and so many in all, may have made it."""
_SAMPLES = 200
"""Fewest samples for a decision."""
_DERIVED, _INDEPENDENT = 0.5, 0.2
"""Explained share of the variance above which rates are derived, below which independent."""
_ROUGH = 0.1
"""Fourth over second differences of a rate with noise [1]; white noise has 3.4."""
_MOVED = 1e-3
"""Rates that are zero all the time are none if the position moves by more [rad]."""


@dataclass(frozen=True)
class RateSource:
    """What the rates of one sensor are."""

    source: str  # one of `RATE_SOURCES`
    # share of the rate's high-frequency variance that differences of the positions explain [1]; NaN
    # where that cannot be told
    explained: float


@njit
def rate_source_of(stamps: np.ndarray, position: np.ndarray, rate: np.ndarray) -> tuple[int, float]:
    """Compiled core of `rate_source`: index into `RATE_SOURCES`, and explained share."""
    count = len(stamps)
    if count < _SAMPLES:
        return UNDECIDED, math.nan
    if np.all(rate == 0.0):
        moved = position.max() - position.min() > _MOVED
        return (NO_RATES if moved else UNDECIDED), math.nan
    speed = np.zeros(count)
    for k in range(1, count):
        speed[k] = (position[k] - position[k - 1]) * NANOSECONDS / max(stamps[k] - stamps[k - 1], 1)
    rough_speed, rough_rate = _fourth_differences(speed[1:]), _fourth_differences(rate[1:])
    gram, cross, power = np.zeros((_LAGS, _LAGS)), np.zeros(_LAGS), 0.0
    for k in range(_LAGS, len(rough_rate) - _LEAD):
        power += rough_rate[k] * rough_rate[k]
        for i in range(_LAGS):
            one = rough_speed[k + _LEAD - i]
            cross[i] += one * rough_rate[k]
            for j in range(_LAGS):
                gram[i, j] += one * rough_speed[k + _LEAD - j]
    trace = 0.0
    for i in range(_LAGS):
        trace += gram[i, i]
    second = rate[2:] - 2.0 * rate[1:-1] + rate[:-2]
    if trace == 0.0 or power <= _ROUGH * _ROUGH * np.sum(second * second):
        return UNDECIDED, math.nan  # rest, or a motion without any noise
    for i in range(_LAGS):
        gram[i, i] += 1e-9 * trace
    explained = float(np.dot(cross, np.linalg.solve(gram, cross))) / power
    if explained > _DERIVED:
        return DERIVED, explained
    return (INDEPENDENT if explained < _INDEPENDENT else UNDECIDED), explained


@njit
def _fourth_differences(x: np.ndarray) -> np.ndarray:
    """What is not smooth in a signal."""
    return x[4:] - 4.0 * x[3:-1] + 6.0 * x[2:-2] - 4.0 * x[1:-3] + x[:-4]


def rate_source(
    stamps: Sequence[int] | np.ndarray, position: np.ndarray, rate: np.ndarray
) -> RateSource:
    """What the rates of one sensor are, from a recording in motion.

    Parameters
    ----------
    stamps : array_like of int, shape (n,)
        Times of the samples [ns], increasing; some hundred of them.
    position, rate : array_like, shape (n,)
        Of one sensor [rad], [rad/s]; rows with values that are not finite are left out.

    Returns
    -------
    RateSource
        ``undecided`` with too few samples, or at rest.
    """
    position, rate = (np.asarray(v, float) for v in (position, rate))
    times = np.asarray(stamps, np.int64)
    kept = np.isfinite(position)
    if kept.any() and not np.isfinite(rate).any():
        return RateSource('none', math.nan)
    kept &= np.isfinite(rate)
    source, explained = rate_source_of(times[kept], position[kept], rate[kept])
    return RateSource(RATE_SOURCES[source], float(explained))


def contradicts(stated: str, found: str) -> bool:
    """Whether what the arm file states of the rates is not what was found."""
    return found != RATE_SOURCES[UNDECIDED] and found != stated
