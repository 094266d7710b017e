"""Whether measured rates are independent of the positions, or derived from them.

Many drivers compute rates as (filtered) differences of the encoder's positions.  Then position and
rate go wrong together, and dead reckoning cannot contradict the reading: drifts, scale errors and
standstill of an encoder are not found, jumps only as long as the rate's spike is seen.

What the arm does is smooth; noise and quantisation are not.  The high-frequency part of a rate that
is derived is a filtered version of that of the differences of positions: a recursion of second
order on both, whatever the filter's cutoff and delay.  That of an independent sensor is not.

Independence must be proved.  Where rates have no noise but their rounding, where the differences
have none, or where what they have grows with the speed (stamps that jitter put noise into
differences that derived rates do not have), the answer is ``undecided``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv.core.support.jit import njit
from lpv.core.support.limits import SMALL
from lpv.core.support.timestamps import NANOSECONDS

INDEPENDENT, DERIVED, NO_RATES, UNDECIDED = range(4)
"""What rates may be."""
RATE_SOURCES = ('independent', 'derived', 'none', 'undecided')
"""Their names; the first three are what an arm file may state."""

_LEAD, _LAGS, _PAST = 2, 8, 2
"""Differences from so many samples ahead of the rate, so many in all, and so many rates before it
may have made it: filters of second order, and delays."""
_SAMPLES = 200
"""Fewest samples for a decision: of noise, ten columns explain a twentieth by chance."""
_DERIVED, _INDEPENDENT = 0.5, 0.2
"""Explained share of the variance above which rates are derived, most of it, and below which they
are independent, four times that by chance."""
_ROUGH = 0.1
"""Fourth over second differences of a rate with noise [1]; white noise has 3.4."""
_SLOW = 0.3
"""Share of the samples, the slowest, in which jitter of stamps hardly shows."""
_STEADY = 0.5
"""Noise of the differences in the slow samples over that in all: less is jitter, or motion."""
_ROUNDED = 3.0
"""Power of the noise of a rate over that of its rounding, beyond which it has noise of its own."""
_GAIN = 70.0
"""Power of white noise through fourth differences: 1 + 16 + 36 + 16 + 1."""


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
    if count < _SAMPLES or not (np.isfinite(position).all() and np.isfinite(rate).all()):
        return UNDECIDED, math.nan
    if np.all(rate == 0.0):
        moved = position.max() - position.min() > SMALL
        return (NO_RATES if moved else UNDECIDED), math.nan
    speed = np.zeros(count)
    for k in range(1, count):
        speed[k] = (position[k] - position[k - 1]) * NANOSECONDS / max(stamps[k] - stamps[k - 1], 1)
    rough_speed, rough_rate = _fourth_differences(speed[1:]), _fourth_differences(rate[1:])
    second = rate[2:] - 2.0 * rate[1:-1] + rate[:-2]
    power, speed_power = np.mean(rough_rate**2), np.mean(rough_speed**2)
    if speed_power == 0.0 or power <= _ROUGH * _ROUGH * np.mean(second * second):
        return UNDECIDED, math.nan  # rest, or a motion without any noise
    size = np.abs(rate[3:-2])
    slow = size <= np.quantile(size, _SLOW)
    explained = max(
        _explained(rough_rate, rough_speed, np.ones(len(size), np.bool_)),
        _explained(rough_rate, rough_speed, slow),
    )
    if explained > _DERIVED:
        return DERIVED, explained
    own_noise = power > _ROUNDED * _GAIN * _rounding(rate) ** 2 / 12.0
    steady = np.mean(rough_speed[slow] ** 2) > _STEADY * _STEADY * speed_power
    proved = explained < _INDEPENDENT and own_noise and steady
    return (INDEPENDENT if proved else UNDECIDED), explained


@njit
def _explained(rate: np.ndarray, speed: np.ndarray, kept: np.ndarray) -> float:
    """Share of the variance that rates before leave, and that the speeds around explain."""
    size = _PAST + _LAGS
    gram, cross, power, count = np.zeros((size, size)), np.zeros(size), 0.0, 0
    row = np.zeros(size)
    for k in range(_LAGS, len(rate) - _LEAD):
        if not kept[k]:
            continue
        for i in range(_PAST):
            row[i] = rate[k - 1 - i]
        for i in range(_LAGS):
            row[_PAST + i] = speed[k + _LEAD - i]
        count += 1
        power += rate[k] * rate[k]
        for i in range(size):
            cross[i] += row[i] * rate[k]
            for j in range(size):
                gram[i, j] += row[i] * row[j]
    scale = np.sqrt(np.diag(gram))
    for i in range(size):
        if scale[i] == 0.0:  # a reading that rests
            scale[i] = 1.0
    for i in range(size):
        cross[i] /= scale[i]
        for j in range(size):
            gram[i, j] /= scale[i] * scale[j]
        gram[i, i] += 1e-9
    if power == 0.0 or count < 3 * size:
        return 0.0
    past = np.linalg.solve(gram[:_PAST, :_PAST].copy(), cross[:_PAST])
    before = (power - np.dot(cross[:_PAST], past)) / (count - _PAST)
    after = (power - np.dot(cross, np.linalg.solve(gram, cross))) / (count - size)
    return 1.0 - max(after, 0.0) / before if before > 0.0 else 1.0


@njit
def _rounding(values: np.ndarray) -> float:
    """Step that nearly all differences of values are multiples of; 0 if there is none."""
    changes = np.abs(values[1:] - values[:-1])
    changes = changes[changes > 1e-12 * np.max(np.abs(values))]
    if len(changes) == 0:
        return 0.0
    step = np.min(changes)
    multiples = changes / step
    whole = np.mean(np.abs(multiples - np.round(multiples)) < 0.05)
    return float(step) if whole > 0.95 else 0.0


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
