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

from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.limits import SMALL
from lpv.core.support.timestamps import NANOSECONDS

_UNDECIDED = 'undecided'
_LEAD, _LAGS, _PAST = 2, 8, 2
"""Differences from so many samples ahead of the rate, so many in all, and so many rates before it
may have made it: filters of second order, and delays."""
SAMPLES = 100
"""Fewest samples for a decision: of noise, ten columns explain a tenth by chance."""
_CHANGES = 40
"""Fewest changes of the rate, four a column: what is rounded and hardly moves is explained by a
few of the readings' changes."""
PROVED = 0.9
"""Explained share of the variance above which rates are surely derived."""
_DERIVED, _INDEPENDENT = 0.5, 0.2
"""Explained share of the variance above which rates are derived, most of it, and below which they
are independent, twice that by chance."""
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

_AVERAGED = 0.1
"""Time over which ways and rates are compared: shorter ones may be noise and rounding alone [s]."""
_FOLLOWS = 0.7
"""Least correlation of ways with rates of which they follow."""


@dataclass(frozen=True)
class RateSource:
    """What the rates of one sensor are."""

    source: str  # one of `description.RATE_SOURCES`, or 'undecided'
    # share of the rate's high-frequency variance that differences of the positions explain [1]; NaN
    # where that cannot be told
    explained: float


def _source_of(stamps: np.ndarray, position: np.ndarray, rate: np.ndarray) -> tuple[str, float]:
    """Source and explained share; all values are finite."""
    if len(stamps) < SAMPLES:
        return _UNDECIDED, math.nan
    if not rate.any():
        return ('none' if np.ptp(position) > SMALL else _UNDECIDED), math.nan
    speed = np.diff(position) * NANOSECONDS / np.maximum(np.diff(stamps), 1)
    rough_speed, rough_rate = np.diff(speed, 4), np.diff(rate, 4)
    second = np.diff(rate, 2)
    power, speed_power = np.mean(rough_rate**2), np.mean(rough_speed**2)
    changes = np.count_nonzero(np.diff(rate))
    if changes < _CHANGES or speed_power == 0.0 or power <= _ROUGH**2 * np.mean(second**2):
        return _UNDECIDED, math.nan  # rest, or a motion without any noise
    size = np.abs(rate[3:-2])
    slow = size <= np.quantile(size, _SLOW)
    explained = max(
        _explained(rough_rate, rough_speed, np.ones(len(size), bool)),
        _explained(rough_rate, rough_speed, slow),
    )
    if explained > _DERIVED:
        return 'derived', explained
    own_noise = power > _ROUNDED * _GAIN * _rounding(rate) ** 2 / 12.0
    steady = np.mean(rough_speed[slow] ** 2) > _STEADY**2 * speed_power
    proved = explained < _INDEPENDENT and own_noise and steady
    return ('independent' if proved else _UNDECIDED), explained


def _explained(rate: np.ndarray, speed: np.ndarray, kept: np.ndarray) -> float:
    """Share of the variance that rates before leave, and that the speeds around explain."""
    at = np.arange(_LAGS, len(speed) - _LEAD)
    at = at[kept[at]]
    past = [rate[at - 1 - i] for i in range(_PAST)]
    rows, value = np.stack([*past, *(speed[at + _LEAD - i] for i in range(_LAGS))]), rate[at]
    count, size, power = len(at), len(rows), float(value @ value)
    if power == 0.0 or count < 3 * size:
        return 0.0
    scale = np.sqrt((rows**2).sum(1))
    rows /= np.where(scale > 0.0, scale, 1.0)[:, None]  # zero: a reading that rests
    gram, cross = rows @ rows.T + 1e-9 * np.eye(size), rows @ value
    own = cross[:_PAST]
    before = (power - own @ np.linalg.solve(gram[:_PAST, :_PAST], own)) / (count - _PAST)
    after = (power - cross @ np.linalg.solve(gram, cross)) / (count - size)
    return float(1.0 - max(after, 0.0) / before) if before > 0.0 else 1.0


def _rounding(values: np.ndarray) -> float:
    """Step that nearly all differences of values are multiples of; 0 if there is none."""
    changes = np.abs(np.diff(values))
    changes = changes[changes > 1e-12 * np.abs(values).max()]
    if len(changes) == 0:
        return 0.0
    multiples = changes / changes.min()
    whole = np.mean(np.abs(multiples - np.round(multiples)) < 0.05)
    return float(changes.min()) if whole > 0.95 else 0.0


def other_rates(
    arm: SerialArm, stamps: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> str:
    """Rates in another unit than positions, or of the other sign, as text; empty if none are."""
    # Between samples the mean rate counts, so that sampling does not matter; noise is averaged.
    steps = np.diff(stamps)[:, None] / NANOSECONDS
    moved, driven = np.diff(position, axis=0), 0.5 * (velocity[1:] + velocity[:-1]) * steps
    known = np.isfinite(moved) & np.isfinite(driven)
    starts = np.unique(np.searchsorted(np.cumsum(steps), np.arange(0.0, steps.sum(), _AVERAGED)))
    moved, driven = (np.add.reduceat(np.where(known, x, 0.0), starts) for x in (moved, driven))
    far = np.abs(moved).sum(axis=0) >= SMALL
    power, product = (driven**2).sum(axis=0), (moved * driven).sum(axis=0)
    follows = np.abs(product) > _FOLLOWS * np.sqrt(power * (moved**2).sum(axis=0))
    for j in np.flatnonzero(far & follows & (power > 0.0)):
        joint, ratio = arm.joints[j], product[j] / power[j]
        unit, factor = ('millimetres', 1e3) if joint.is_prismatic else ('degrees', 180.0 / np.pi)
        causes = {f'positions in {unit}?': factor, f'rates in {unit}?': 1.0 / factor,
                  'rates that count the other way round?': -1.0}  # fmt: skip
        for cause, size in causes.items():
            if 0.7 < ratio / size < 1.4:
                return f'{joint.name} moves {ratio:.3g} times as far as its rate says: {cause}'
    return ''


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
    return RateSource(*_source_of(times[kept], position[kept], rate[kept]))


def contradicts(stated: str, found: str) -> bool:
    """Whether what the arm file states of the rates is not what was found."""
    return found not in {_UNDECIDED, stated}
