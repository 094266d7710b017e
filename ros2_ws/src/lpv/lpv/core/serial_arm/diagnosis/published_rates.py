"""Published rates beside the differences of their readings: lag, noise, contradictions."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.balance import READINGS_AT_EDGES
from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.sampler import (
    HISTORY,
    JUMP_SCALE,
    NOISE_MEMORY,
    SCALE_MEMORY,
    USUAL_JUMP,
    Sampler,
    readings_in_jump,
)
from lpv.core.support.jit import njit_in_place

CONTRADICTIONS = 3.0
"""Times that a rate contradicts its reading lately to be wrong: as often as it is compared."""
_REMEMBERED = 10.0
"""Samples for which differences are remembered, and as many more for each period that rates lag: of
a rate that turns, a filter's is within what fades by 1/e in e = 2.7 lags."""
LAGGING = 1.0
"""Lag of published rates, in periods, from which on differences of the readings take their place:
twice that of such differences."""
_MOST = 0.5
"""Share of the power of what rates differ by that their lag explains to be most of it."""


@njit_in_place
def keep_probe(sampler: Sampler, time: float, y: FloatArray, v: FloatArray) -> None:
    """Keep a sample of those that tell whether rates are derived from their readings."""
    k, n = sampler.state[0].probed, y.shape[0]
    if k >= 0:
        row = sampler.probe[k]
        row[0] = time
        for i in range(n):
            row[1 + i], row[1 + n + i] = y[i], v[i]
    sampler.state[0].probed += 1


@njit_in_place
def watch_lag(sampler: Sampler, i: int, way: float, rate: float, period: float) -> None:
    """Learn from a sample by how much a published rate lags behind the differences of its reading.

    A rate that is late by d differs from them by d times its change over a period.
    """
    before = sampler.published[0, i]
    sampler.published[0, i] = rate
    if sampler.derived[i] == 0.0 or sampler.state[0].count == 0:
        return
    change, more = rate - before, way / period - 0.5 * (rate + before)
    sampler.published[1, i] += more * change
    sampler.published[2, i] += change * change
    sampler.published[3, i] += more * more


@njit_in_place
def watch_contrast(sampler: Sampler, i: int, difference: float, rate: float, lag: float) -> None:
    """Compare a rate that is said to be derived from its reading with the reading's differences.

    Whatever averages differences is between the smallest and the largest one lately, and a plain
    difference is as near to the newest one as ever.  A counter that overflows, or a wrong sign, is
    neither, and moves less than the joint; a difference that a stamp turns round, by at most `LATE`
    periods, is at most half the rate.
    """
    own, count = sampler.contrast[i], sampler.state[0].count
    if sampler.derived[i] == 0.0 or count == 0:
        return
    kept = 1.0 - 1.0 / (_REMEMBERED * (1.0 + lag))
    own.largest = max(difference, kept * own.largest)
    own.smallest = min(difference, kept * own.smallest)
    apart, usual, learned = abs(rate - difference), own.usual, count > NOISE_MEMORY
    opposite = rate * difference < 0.0 and abs(rate) < abs(difference)
    contrary = opposite and apart > max(own.largest, -own.smallest)
    if not contrary:
        power = (min(apart, ROBUST * usual) if learned else apart) ** 2
        own.usual = np.sqrt(usual * usual + (power - usual * usual) / min(count, SCALE_MEMORY))
    is_between = own.smallest <= rate <= own.largest
    is_usual = lag > 0.0 or not learned or apart <= JUMP_SCALE * usual
    moves = sampler.still[i] + sampler.held[i] == 0 and count > CONTRADICTIONS
    # Differences over less than a period, taken by a faster driver, have more noise.
    wrong = moves and contrary and apart > USUAL_JUMP * usual and not (is_between and is_usual)
    own.wrong = 1.0 if wrong else 0.0
    own.times_wrong += own.wrong - own.times_wrong / NOISE_MEMORY
    if wrong and own.times_wrong > CONTRADICTIONS - 0.5:  # less what is forgotten
        own.contrary_at, own.apart = sampler.time[HISTORY - 1], rate - difference


@njit_in_place
def rate_lag(sampler: Sampler, share: float = _MOST) -> float:
    """Periods by which published rates are late, 0 if not later than the half of a difference.

    They are filtered then, all of them by one driver, and say less than the readings do.  With a
    smaller ``share`` of what they differ by, also where jitter of the stamps hides it.
    """
    late = _late_rates(sampler, share)
    return late if late > LAGGING else 0.0


@njit_in_place
def balance_lag(sampler: Sampler) -> float:
    """Periods by which derived rates of the samples are late: differences, by the half of one."""
    late = _late_rates(sampler, _MOST)
    return 0.5 if late > LAGGING else max(late, 0.0)


@njit_in_place
def rate_noise(sampler: Sampler, i: int, interval: float) -> float:
    """Variance of what noise of a reading makes of a balance's change of its rate [rad2/s2].

    Balances are of intervals of a length [s].  Before the noise is known, it is more.
    """
    reading = sampler.calm[i] / readings_in_jump(sampler, i) / (interval * interval)
    return float(sampler.derived[i] * readings_at_edges(sampler) * reading)


@njit_in_place
def readings_at_edges(sampler: Sampler) -> float:
    """`READINGS_AT_EDGES`, but rates between two differences hold two readings in place of each."""
    lag = balance_lag(sampler)
    return READINGS_AT_EDGES * ((1.0 - lag) * (1.0 - lag) + lag * lag)


@njit_in_place
def _late_rates(sampler: Sampler, share: float) -> float:
    """Periods by which published rates are late, if a share of what they differ by shows it."""
    late, power, whole = 0.0, 0.0, 0.0
    for i in range(sampler.derived.shape[0]):
        whole += sampler.published[3, i]
    if whole == 0.0:  # they do not differ, or have sensors of their own
        return 0.0
    whole = 0.0
    for i in range(sampler.derived.shape[0]):
        one = sampler.unit[i] ** 2
        late += sampler.published[1, i] / one
        power += sampler.published[2, i] / one
        whole += sampler.published[3, i] / one
    return late / power if late * late > share * power * whole else 0.0
