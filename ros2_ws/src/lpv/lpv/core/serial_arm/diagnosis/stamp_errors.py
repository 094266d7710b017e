"""Errors of stamps, which look like jumps of all joints that move."""

import numpy as np

from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.sampler import (
    DELAY,
    HISTORY,
    LATE,
    LEFT,
    SCALE_MEMORY,
    USUAL_JUMP,
    WRONG_RATE,
    Sampler,
    last_way,
    rate_before,
    readings_in_jump,
    steady_rate,
    usual_rate,
)
from lpv.core.support.jit import njit_in_place


@njit_in_place
def noise_of_gaps(sampler: Sampler, i: int, period: float) -> float:
    """Variance of e of the last sample but one by the readings' noise, over that at even periods.

    Rates that are differences over short periods are extrapolated over a long one.  Where a period
    is short, e does not shrink as much: stamps are wrong there.
    """
    k, time = HISTORY - 2, sampler.time
    before, after = time[k - 1] - time[k - 2], time[k + 1] - time[k]
    before = before if sampler.state[0].count > 3 else period  # else of before a gap, or none
    a, b = 0.5 * period / before, 0.5 * period / after
    whole = (1.0 + a) * (1.0 + a) + (1.0 + b) * (1.0 + b) + a * a + b * b
    return float(max(whole / readings_in_jump(sampler, i), 1.0))


@njit_in_place
def note_wrong_stamp(sampler: Sampler) -> None:
    """Note that a stamp was wrong, or samples are missing: others may be, too.

    What is seen of one within the samples that are kept is the same one.
    """
    state = sampler.state[0]
    if state.stamps == 0.0 or state.right_for > HISTORY:
        state.times_off += 1.0
    state.until_off += state.right_for
    state.stamps, state.right_for = 1.0, 0.0


@njit_in_place
def watch_stamps(sampler: Sampler) -> None:
    """Count a sample; stamps are right again once as many were as would hardly be by chance.

    By the share that was wrong until the last one, which is `WRONG_STAMPS` before any samples, none
    of so many is wrong as seldom as noise passes for a step.
    """
    state = sampler.state[0]
    state.right_for += 1.0
    if state.stamps == 1.0:
        share = (1.0 + state.times_off) / (1.0 / priors.WRONG_STAMPS + state.until_off)
        if state.right_for * share > 0.5 * sampler.lines[0].limit ** 2:
            state.stamps = state.times_off = state.until_off = 0.0


@njit_in_place
def doubt_stamps(sampler: Sampler, late: float) -> None:
    """Note that the last stamp but one is wrong; some that follow may be, too."""
    state, now = sampler.state[0], sampler.time[HISTORY - 2]
    note_wrong_stamp(sampler)
    if state.late_until < sampler.time[HISTORY - 1 - DELAY]:
        state.latest, state.late_from = 0.0, sampler.time[HISTORY - 3]
    state.latest = max(state.latest, late)
    state.late_until = now + HISTORY * (now - sampler.time[HISTORY - 3])


@njit_in_place
def longest_gap(sampler: Sampler) -> float:
    """Longest of the last periods, if samples are missing there; stamps around it are wrong [s]."""
    k, usual, longest = HISTORY - 2, np.inf, 0.0
    for j in range(2, HISTORY):
        period = sampler.time[j] - sampler.time[j - 1]
        if sampler.time[j - 1] > 0.0:
            usual = min(usual, period)
    for j in range(k - 2, k + 2):
        longest = max(longest, sampler.time[j] - sampler.time[j - 1])
    return longest if longest > LATE * usual else 0.0


@njit_in_place
def largest_rate(sampler: Sampler, i: int, end: int) -> float:
    """Largest rate of a joint in the last samples before one [rad/s].

    A derived rate of the last sample but one holds the jump that it would explain.
    """
    largest = 0.0
    for j in range(HISTORY - 6, end):
        if j != HISTORY - 2 or sampler.derived[i] == 0.0:
            largest = max(largest, abs(sampler.samples[j, 1, i]))
    return largest


@njit_in_place
def largest_by_stamps(sampler: Sampler, i: int, period: float) -> float:
    """Largest e of wrong stamps, over the rate [s]: of two of them, and of rates made of them."""
    return float(2.0 * LATE * (1.0 + sampler.derived[i]) * period)


@njit_in_place
def wrong_stamp(sampler: Sampler, period: float) -> float:
    """By how much the stamp of the last sample but one is wrong, 0 if that explains nothing [s].

    It has to explain two joints at least, and more than it spoils: a joint may have jumped as well.
    """
    jumps, n, late, best = sampler.jumps[HISTORY - 2], sampler.scale.shape[0], 0.0, 1
    for c in range(n):
        rate, slow = steady_rate(sampler, c), priors.SLOW_RATE * sampler.unit[c]
        if _tells_no_stamp(sampler, c) or abs(rate) < slow:
            continue
        if abs(jumps[c]) > largest_by_stamps(sampler, c, period) * abs(rate):
            continue
        gained, common, weight = 0, 0.0, 0.0
        for i in range(n):
            own = steady_rate(sampler, i)
            way, usual = jumps[c] / rate * own, USUAL_JUMP * sampler.usual[i]
            if _tells_no_stamp(sampler, i):
                continue
            if max(abs(way), abs(jumps[i])) <= usual:
                continue
            if abs(jumps[i] - way) < max(0.5 * abs(way), usual):
                gained, share = gained + 1, own / sampler.unit[i] ** 2
                common, weight = common + jumps[i] * share, weight + own * share
            else:
                gained -= abs(jumps[i]) <= usual
        if gained > best:
            best, late = gained, common / weight
    return late


@njit_in_place
def _tells_no_stamp(sampler: Sampler, i: int) -> bool:
    """Whether e of a joint says nothing of stamps.

    Noisy readings jump by themselves, repeated ones where they go on, and e of a wrong rate is its.
    """
    wrong = sampler.doubtful[HISTORY - 3, i] == WRONG_RATE
    return bool(sampler.noisy[i] == 1 or sampler.filled[i] > 0 or wrong)


@njit_in_place
def may_be_stamp(sampler: Sampler, i: int, period: float) -> bool:
    """Whether a wrong stamp explains the jump of one joint, and no other joint contradicts.

    Where the reading has gone on at its rate before, it is the next one that jumps: the rate after
    this one, if it is derived, holds that jump.
    """
    jumps, rate = sampler.jumps[HISTORY - 2], steady_rate(sampler, i)
    ahead = last_way(sampler, i) - period * sampler.samples[HISTORY - 3, 1, i]
    if sampler.derived[i] == 1.0 and abs(ahead) < LEFT * abs(jumps[i]):
        return False
    # Where stamps have been wrong, two in a row may be.  Rates that carry jumps tell no motion.
    usual = abs(usual_rate(sampler, i))
    wrong = 2.0 if sampler.state[0].stamps == 1.0 else 1.0 + 0.5 * sampler.derived[i]
    largest = LATE * wrong * period * usual + USUAL_JUMP * sampler.usual[i]
    if rate == 0.0 or abs(jumps[i]) > largest:
        return False
    for j in range(sampler.scale.shape[0]):
        way = jumps[i] / rate * steady_rate(sampler, j)
        usual = max(0.5 * abs(way), USUAL_JUMP * sampler.usual[j])
        if j != i and abs(jumps[j] - way) > usual and sampler.filled[j] == 0:
            return False
    return True


@njit_in_place
def expected_jitter(period: float) -> float:
    """Variance of stamps before any were seen [s2]."""
    return priors.WRONG_STAMPS * (LATE * period) ** 2


@njit_in_place
def learn_jitter(sampler: Sampler) -> None:
    """Learn the usual error of stamps from the joint that shows it best, of those that move.

    Errors of other readings may be correlated with its own.
    """
    k, state, power, late = HISTORY - 2, sampler.state[0], 0.0, 0.0
    for i in range(sampler.scale.shape[0]):
        if sampler.noisy[i] == 1 or sampler.filled[i] > 0 or sampler.doubtful[k, i] > 0:
            continue
        rate = rate_before(sampler, i) * np.sqrt(readings_in_jump(sampler, i))
        if abs(rate) > np.sqrt(power) * sampler.scale[i]:
            power, late = (rate / sampler.scale[i]) ** 2, sampler.jumps[k, i] / rate
    expected = power * expected_jitter(sampler.time[k] - sampler.time[k - 1])
    if expected == 0.0:
        return
    weight = (expected / (1.0 + expected)) ** 2
    seen = min(late * late, ROBUST**2 * (state.jitter + 1.0 / power)) - 1.0 / power
    state.seen = min(state.seen + weight, SCALE_MEMORY)
    state.jitter += weight * (seen - state.jitter) / state.seen
    state.jitter = max(state.jitter, 0.0)
