"""Steps, spikes and noise of readings.

A reading that jumps shows in

    e_k = y_k - y_(k-1) - T (v_(k-1) + v_(k+1)) / 2,

which leaves out v_k: where rates are differences of the same reading, v_k jumps with it.  Rates
that are independent may leave out another one; where they are wrong, e repeats itself.  A wrong
stamp shows as e = v dt in all joints: a repeated sample is late by a period.  Where only one joint
moves, a step is told from a wrong stamp by the samples that follow.  A reading that jumps again and
again is noisy.
"""

import numpy as np

from lpv.core.serial_arm.diagnosis.lines import (
    AFTER,
    is_step_between_lines,
    learn_line_scale,
    set_line_jumps,
)
from lpv.core.serial_arm.diagnosis.sampler import (
    HIDDEN,
    HISTORY,
    LATE,
    LEFT,
    LIVELY,
    MOST,
    NOISE_MEMORY,
    NOISY,
    NONE,
    QUIET,
    QUIET_COUNT,
    ROUNDING,
    SPIKE,
    STEP,
    WRONG_RATE,
    Sampler,
    last_way,
    learn_scale,
    mean_rate,
    measure_stop,
    rate_before,
    readings_in_jump,
    smallest_jump,
    steady_rate,
)
from lpv.core.serial_arm.diagnosis.stamp_errors import (
    doubt_stamps,
    expected_jitter,
    largest_by_stamps,
    largest_rate,
    learn_jitter,
    longest_gap,
    may_be_stamp,
    noise_of_gaps,
    note_wrong_stamp,
    wrong_stamp,
)
from lpv.core.support.jit import njit_in_place

_NOISE_COUNT = 4.5
"""Jumps among those that are noise: a spike in a reading and in the rate that is derived from it
makes four."""


@njit_in_place
def set_jumps(sampler: Sampler) -> None:
    """Write e of the last sample but one, less what a wrong stamp explains."""
    k, n, beyond = HISTORY - 2, sampler.scale.shape[0], False
    period = sampler.time[k] - sampler.time[k - 1]
    if sampler.state[0].seen == 0.0:
        sampler.state[0].jitter, sampler.state[0].seen = expected_jitter(period), 1.0
    for i in range(n):
        rate = 0.0 if sampler.noisy[i] == 1 else rate_before(sampler, i)
        stamps = sampler.state[0].jitter * readings_in_jump(sampler, i)
        more = noise_of_gaps(sampler, i, period) if sampler.derived[i] == 1.0 else 1.0
        sampler.usual[i] = np.sqrt(more * sampler.scale[i] ** 2 + stamps * rate * rate)
        sampler.jumps[k, i] = 0.0
        if not _is_followed_at_rest(sampler, i):
            sampler.jumps[k, i] = last_way(sampler, i) - period * mean_rate(sampler, i)
        sampler.doubtful[k, i] = 0
        beyond = beyond or _is_beyond(sampler, i, k)
    if not beyond:
        return
    late = wrong_stamp(sampler, period)
    for i in range(n):
        if not _is_followed_at_rest(sampler, i):
            sampler.jumps[k, i] = _unexplained(sampler, i, period, late)
    gap, together = longest_gap(sampler), 0
    if late != 0.0:
        doubt_stamps(sampler, abs(late))
        for i in range(n):
            if sampler.derived[i] == 1.0:  # the e before holds the same jump of the rate
                sampler.doubtful[k - 1, i] = 2
    for i in range(n):  # noisy readings jump by themselves
        if sampler.noisy[i] == 0 and _is_beyond(sampler, i, k):
            together += 1
    for i in range(n):
        # What is usual may have changed until a jump is named.
        nearly = abs(sampler.jumps[k, i]) > MOST * smallest_jump(sampler, i)
        if sampler.noisy[i] == 1 or not nearly:
            continue
        # Readings that jump together, or after they were repeated, have a cause outside the
        # sensor, if their motion explains it.
        explained = LATE * gap * largest_rate(sampler, i, HISTORY)
        if together > 1 or sampler.filled[i] > 0:
            most = largest_by_stamps(sampler, i, period)
            explained = max(explained, most * largest_rate(sampler, i, k))
        if abs(sampler.jumps[k, i]) < explained:
            sampler.doubtful[k, i] = 3 if gap > 0.0 else 2
            doubt_stamps(sampler, LATE * period)
        elif _is_wrong_rate(sampler, i):
            sampler.doubtful[k - 2 : k + 1, i] = WRONG_RATE
        elif may_be_stamp(sampler, i, period):
            sampler.doubtful[k, i] = 1


@njit_in_place
def _is_wrong_rate(sampler: Sampler, i: int) -> bool:
    """Whether e repeats itself, as it does where a rate of its own is wrong: a step shows once."""
    k = HISTORY - 2
    if sampler.derived[i] == 1.0 or sampler.state[0].count < 5:
        return False
    first, before, own = _apart(sampler, i, k - 2), _apart(sampler, i, k - 1), _apart(sampler, i, k)
    if sampler.doubtful[k - 1, i] == WRONG_RATE:  # where it ends, e is half as large
        return abs(own - before) <= abs(before)
    return max(abs(own - before), abs(before - first)) < LEFT * abs(before)


@njit_in_place
def _apart(sampler: Sampler, i: int, k: int) -> float:
    """By how much a reading is faster than its rate, if that is what e says [rad/s]."""
    return float(sampler.jumps[k, i] / (sampler.time[k] - sampler.time[k - 1]))


@njit_in_place
def _is_followed_at_rest(sampler: Sampler, i: int) -> bool:
    """Whether the last reading but one did not change at all, so that only its estimate moved."""
    return bool(sampler.followed[i] != 0.0 and max(sampler.still[i] - 1, sampler.held[i]) > 0)


@njit_in_place
def _is_beyond(sampler: Sampler, i: int, k: int) -> bool:
    """Whether a reading jumped at a sample."""
    return bool(abs(sampler.jumps[k, i]) > smallest_jump(sampler, i))


@njit_in_place
def _unexplained(sampler: Sampler, i: int, period: float, late: float) -> float:
    """What neither a wrong stamp nor rates explain of a way [rad]; of independent ones, any two.

    A joint that shakes faster than it is sampled does not jump, nor does one whose rate is wrong.
    A reading that has not changed did not jump either, whatever a rate of its own says: it is late,
    or frozen.
    """
    k, rate, way = HISTORY - 2, sampler.samples[:, 1, i], last_way(sampler, i)
    if abs(way) <= ROUNDING:
        return 0.0
    way -= late * steady_rate(sampler, i)
    least = way - period * mean_rate(sampler, i)
    if sampler.derived[i] == 0.0:
        for other in (k - 1, k + 1):
            rest = way - 0.5 * period * (rate[k] + rate[other])
            least = rest if abs(rest) < abs(least) else least
    return least


@njit_in_place
def find_jumps(sampler: Sampler) -> None:
    """After a large e, name clear steps at once, and what else it is 3 samples later."""
    n, k, waits = sampler.scale.shape[0], HISTORY - 2, sampler.state[0].pending >= 0
    even = set_line_jumps(sampler)
    for i in range(n):
        beyond = _is_beyond(sampler, i, k)
        _watch_noise(sampler, i, beyond)
        if sampler.noisy[i] == 1:
            continue
        if beyond:
            sampler.state[0].pending = max(sampler.state[0].pending, 0)
        elif not waits and not (sampler.still[i] > HISTORY and sampler.lively[i] > LIVELY):
            own = sampler.scale[i] / sampler.usual[i]
            learn_scale(sampler, i, sampler.jumps[k, i] * own, 1.0)
            if even:
                learn_line_scale(sampler, i)
    if sampler.state[0].pending < 0:
        learn_jitter(sampler)
    if waits:
        sampler.state[0].pending += 1
    elif sampler.state[0].pending < 0:
        if even:
            _find_small_steps(sampler)
        return
    for i in range(n):
        if sampler.noisy[i] == 0 and _is_clear_step(sampler, i):
            _remove_step(sampler, i, k)
            sampler.jumps[k - 1, i] = 0.0
    if sampler.state[0].pending < 3:
        return
    sampler.state[0].pending = -1
    for i in range(n):
        if sampler.found[i] == NONE and sampler.noisy[i] == 0:
            _name_jump(sampler, i)


@njit_in_place
def _find_small_steps(sampler: Sampler) -> None:
    """Name steps that e leaves in doubt, and the samples around them do not."""
    for i in range(sampler.scale.shape[0]):
        if sampler.noisy[i] == 1 or not is_step_between_lines(sampler, i):
            continue
        sampler.jumps[AFTER, i] = sampler.lines[i].jump
        _remove_step(sampler, i, AFTER)
        sampler.lines[i].found = 1.0
        sampler.jumps[AFTER - 1, i] = sampler.jumps[AFTER + 1, i] = 0.0


@njit_in_place
def _watch_noise(sampler: Sampler, i: int, beyond: bool) -> None:
    """Count jumps of a reading; many are noise, and no steps."""
    count, square, before, seen = sampler.noise[:, i]
    jump = sampler.jumps[HISTORY - 2, i]
    if sampler.noisy[i] == 0 and count < QUIET_COUNT:
        square, before, seen = 0.0, sampler.correction[i], 0.0
    count += 1.0 if beyond and sampler.doubtful[HISTORY - 2, i] == 0 else 0.0
    count -= count / NOISE_MEMORY
    if sampler.noisy[i] == 1 or beyond:
        seen = min(seen + 1.0, NOISE_MEMORY)
        square += (jump * jump - square) / seen
    if sampler.noisy[i] == 0 and count > _NOISE_COUNT:
        sampler.noisy[i] = 1
        sampler.found[i] = NOISY
        sampler.lively[i] = 0.0  # the noise ends, too: readings that rest then are healthy
        wrong = sampler.correction[i] - before
        sampler.correction[i] = before
        for k in range(HISTORY):
            sampler.samples[k, 0, i] += wrong
    elif sampler.noisy[i] == 1 and count < QUIET_COUNT:
        sampler.noisy[i] = 0
        sampler.found[i] = QUIET
    sampler.noise[0, i], sampler.noise[1, i] = count, square
    sampler.noise[2, i], sampler.noise[3, i] = before, seen


@njit_in_place
def _is_clear_step(sampler: Sampler, i: int) -> bool:
    """Whether the last sample but one jumped and the last one confirms it, whatever the rates."""
    k, samples = HISTORY - 2, sampler.samples
    jump = sampler.jumps[k, i]
    if sampler.doubtful[k, i] > 0 or sampler.doubtful[k - 1, i] > 0:
        return False
    # The e before a step is half as large where the rate is derived.
    if abs(jump) <= smallest_jump(sampler, i) or _shakes(sampler, i, k, jump):
        return False
    way = samples[k + 1, 0, i] - samples[k - 1, 0, i] - jump
    period = sampler.time[k + 1] - sampler.time[k - 1]
    before, after = samples[k - 1, 1, i], samples[k + 1, 1, i]
    largest = max(abs(way - period * before), abs(way - 0.5 * period * (before + after)))
    return largest < LEFT * abs(jump)


@njit_in_place
def _shakes(sampler: Sampler, i: int, end: int, jump: float) -> bool:
    """Whether e was large before a jump, too, and no stamp explains it: the joint shakes."""
    for k in range(end):
        if sampler.doubtful[k, i] == 0 and abs(sampler.jumps[k, i]) >= 2.0 * LEFT * abs(jump):
            return True
    return False


@njit_in_place
def _name_jump(sampler: Sampler, i: int) -> None:
    """Tell steps, spikes and wrong rates apart by the pattern of e, and remove them."""
    first, last = HISTORY - 5, HISTORY - 2
    largest = 0.0
    for k in range(first, last):
        largest = max(largest, abs(sampler.jumps[k, i]))
    peak = first
    while abs(sampler.jumps[peak, i]) < MOST * largest or (
        peak + 1 < last and _is_before_step(sampler, i, peak)
    ):
        peak += 1
    size, after = sampler.jumps[peak, i], sampler.jumps[peak + 1, i]
    if abs(size) <= smallest_jump(sampler, i) or _is_stop(sampler, i, peak):
        return
    doubt = sampler.doubtful[peak, i]
    if abs(after + size) < LEFT * abs(size):
        way = _gone_one_way(sampler, i, peak) if doubt == 0 else 0.0
        if abs(way) > LEFT * abs(size):
            sampler.found[i], sampler.size[i] = HIDDEN, way
            if sampler.derived[i] == 1.0:
                sampler.samples[peak - 1 :, 1, i] = sampler.samples[peak - 2, 1, i]
            return
        doubt = max(doubt, sampler.doubtful[peak + 1, i])
        sampler.found[i], sampler.size[i] = SPIKE if doubt == 0 else NONE, size
        if doubt > 0:
            note_wrong_stamp(sampler)
        middle = 0.5 * (sampler.samples[peak - 1, 0, i] + sampler.samples[peak + 1, 0, i])
        sampler.samples[peak, 0, i] = middle
        _smooth_rates(sampler, i, peak, 2)
        return
    if peak + 2 <= last and abs(after) < LEFT * abs(size):
        again = sampler.jumps[peak + 2, i]
        if abs(again - size) < LEFT * abs(size):
            _smooth_rates(sampler, i, peak + 1, 1)
            return
    if doubt == 0 or (doubt == 1 and sampler.state[0].stamps == 0.0 and _lasts(sampler, i, peak)):
        if not _shakes(sampler, i, peak - 1, size):
            _remove_step(sampler, i, peak)
    elif doubt == 3:
        sampler.found[i], sampler.size[i] = HIDDEN, size


@njit_in_place
def _is_before_step(sampler: Sampler, i: int, k: int) -> bool:
    """Whether e is that before a step, whose derived rate it holds: half of it at even periods."""
    own, after = sampler.jumps[k, i], sampler.jumps[k + 1, i]
    period, following = sampler.time[k] - sampler.time[k - 1], sampler.time[k + 1] - sampler.time[k]
    share = 0.5 * sampler.derived[i] * period / following
    return bool(abs(own + share * after) < LEFT * abs(own) and abs(after) > abs(own))


@njit_in_place
def _is_stop(sampler: Sampler, i: int, peak: int) -> bool:
    """Whether a joint that stopped dead would make such an e.

    A rate that changes by dv at once, anywhere between two samples, makes e of up to T dv / 2, and
    until then the joint may have gone on with its acceleration.  Steps of a reading leave the rates
    before them as they are, and those from the second one after them on; one that slips within a
    few samples gets faster first, which no joint does at once.
    """
    rates, period = sampler.samples[:, 1, i], sampler.time[peak] - sampler.time[peak - 1]
    before, last, after = rates[peak - 2], rates[peak - 1], rates[peak + 2]
    if abs(after) >= max(abs(before), abs(last)):
        return False
    change = 0.5 * max(abs(after - before), abs(after - last)) + abs(last - before)
    return bool(MOST * abs(sampler.jumps[peak, i]) <= period * change + sampler.usual[i])


@njit_in_place
def _gone_one_way(sampler: Sampler, i: int, peak: int) -> float:
    """Way since a jump that the rate before does not explain, 0 if it went back and forth [rad]."""
    first, way, whole = peak - 2, 0.0, 0.0
    for k in range(first + 1, HISTORY):
        period = sampler.time[k] - sampler.time[k - 1]
        step = sampler.samples[k, 0, i] - sampler.samples[k - 1, 0, i]
        step -= period * sampler.samples[first, 1, i]
        way, whole = way + step, whole + abs(step)
    return way if abs(way) > MOST * whole else 0.0


@njit_in_place
def _lasts(sampler: Sampler, i: int, peak: int) -> bool:
    """Whether a reading has gone on from where a jump that may be a wrong stamp's took it."""
    before, after, samples = peak - 2, min(peak + 2, HISTORY - 1), sampler.samples
    rate = 0.5 * (samples[before, 1, i] + samples[min(after + 1, HISTORY - 1), 1, i])
    way = samples[after, 0, i] - samples[before, 0, i]
    rest, size = way - rate * (sampler.time[after] - sampler.time[before]), sampler.jumps[peak, i]
    return bool(rest * np.sign(size) > MOST * abs(size))


@njit_in_place
def _remove_step(sampler: Sampler, i: int, peak: int) -> None:
    """Take a step out of all readings since its first one."""
    size = sampler.jumps[peak, i]
    if sampler.doubtful[peak, i] > 0:  # it was no wrong stamp's, and counts as a jump
        sampler.noise[0, i] += 1.0
    sampler.found[i] = STEP
    sampler.size[i] = size
    sampler.since[i] = HISTORY - peak
    sampler.lines[i].found = 0.0
    sampler.correction[i] += size
    for k in range(peak, HISTORY):
        sampler.samples[k, 0, i] -= size
    sampler.jumps[peak, i] = 0.0
    if sampler.still[i] > 0:  # it did not move by the step
        measure_stop(sampler, i)
    _smooth_rates(sampler, i, peak, 1)


@njit_in_place
def _smooth_rates(sampler: Sampler, i: int, start: int, count: int) -> None:
    """Replace rates that carry a jump by those around them."""
    before, after = sampler.samples[start - 1, 1, i], sampler.samples[start + count, 1, i]
    for k in range(start, start + count):
        sampler.samples[k, 1, i] = 0.5 * (before + after)
