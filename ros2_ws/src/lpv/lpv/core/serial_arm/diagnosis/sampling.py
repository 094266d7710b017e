"""From samples to momentum balances: jumps of readings, means of some samples, intervals.

A reading that jumps shows in

    e_k = y_k - y_(k-1) - T (v_(k-1) + v_(k+1)) / 2,

which leaves out v_k: where rates are differences of the same reading, v_k jumps with it.  Rates
that are independent may leave out another one.  A wrong stamp shows as e = v dt in all joints: a
repeated sample is late by a period.  Where only one joint moves, a step is told from a wrong stamp
by the samples that follow.  A reading that jumps again and again is noisy.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.balance import (
    READINGS_AT_EDGES,
    Balance,
    add_block,
    close_interval,
    drop_interval,
)
from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.priors import SLOW_RATE, WRONG_STAMPS
from lpv.core.support.jit import njit_in_place

DELAY = 5
"""Samples after which one enters the balance: until then it is moved if a late driver repeated it,
and jumps are known, whose e needs the next sample, and whose kind three more."""
HISTORY = DELAY + 3
"""Samples that are kept: two before that of the balance tell whether a reading went on steadily."""
LEFT = 0.3
"""What is left of a jump or a fault, over its size, where it is over."""
MOST = 1.0 - LEFT
"""The share of it that says that it is there: more than the e, half as large, beside a step of a
derived rate, and less than what is usual changes by until a jump is named."""
NONE, STEP, SPIKE, NOISY, QUIET, HIDDEN, CONTRARY = range(7)
"""What was found at a reading: `NOISY` and `QUIET` say that it began, or ceased, to be noisy,
`HIDDEN` that it may have jumped where samples are missing, or over several samples, `CONTRARY` that
its rate, said to be derived from it, contradicts it."""
LARGEST, SMALLEST, USUAL, APART, WRONG, TIMES_WRONG, CONTRARY_AT, REPLACED = range(8)
"""Rows of `Sampler.contrast`: the largest and the smallest difference of the reading lately; by how
much its published rate differs from them usually, and now [rad/s]; 1 where it contradicts them, how
often it did lately, and when last [s]; 1 while differences replace it."""
CONTRADICTIONS = 3.0
"""Times that a rate contradicts its reading lately to be wrong: as often as it is compared."""
_REMEMBERED = 10.0
"""Samples for which differences are remembered, and as many more for each period that rates lag: of
a rate that turns, a filter's is within what fades by 1/e in e = 2.7 lags."""
COUNT, IN_BLOCK, IN_INTERVAL, PENDING, BLOCKS, PROBED = range(6)
"""Entries of `Sampler.counters`: samples since the start, in the block; blocks in the interval;
sensor-independent age of a jump that waits for its kind, -1 if none; blocks written; samples in the
probe, or those until one begins, times -1."""
(
    INTERVAL_START, BLOCK_START, STAMPS, TIMES, JITTER, SEEN, LATEST, LATE_FROM, LATE_UNTIL,
    IN_DOUBT,
) = range(10)  # fmt: skip
"""Entries of `Sampler.clock` [s]; the third one is 1 once a stamp has been wrong, then comes the
sum of the block's stamps; the usual variance of stamps [s2], and of how many it was learned; by how
much stamps were wrong lately, from and until when, and by how much those of the block may be."""
ROUNDING = 1e-12
"""Change of a reading that rounding explains, where it was found from joint positions [rad]."""
JUMP_SCALE = 10.0
"""A jump is larger than so many times the usual size of e."""
LATE = 1.5
"""Largest error of a stamp, over the time since the sample before; halfway between one period and
two, samples after so many have others lost before them."""
_USUAL = 0.5 * JUMP_SCALE
"""Sizes of e, over the usual one, that are nothing special."""
BEFORE_STOP = 3
"""Periods before a reading comes to rest over which its speed is measured."""
LAGGING = 1.0
"""Lag of published rates, in periods, from which on differences of the readings take their place:
twice that of such differences."""
SCALE_MEMORY = 256.0
"""Samples over which the usual size of e, and that a reading has noise, are learned."""
LIVELY = 0.02
"""Share of changes that go back and forth from which on a reading has noise, and never rests."""
NOISE_MEMORY = 32.0
"""Samples over which jumps of a reading are counted."""
_NOISE_COUNT = 4.5
"""Jumps among those that are noise: a spike in a reading and in the rate that is derived from it
makes four."""
_QUIET_COUNT = 0.5
"""... and from which on the noise is over."""


class Sampler(NamedTuple):
    """Samples on their way into the balance."""

    time: FloatArray  # stamps of the last samples, newest last, shape (HISTORY,) [s]
    samples: FloatArray  # readings, rates, torques, shape (HISTORY, 3, n)
    jumps: FloatArray  # e of each, shape (HISTORY, n)
    scale: FloatArray  # usual size of e by the readings, shape (n,) [rad]
    usual: FloatArray  # (n,) that of the last e, by the errors of stamps, too [rad]
    calm: FloatArray  # (n,) square of scale where it was small, over the blocks kept [rad2]
    smallest: FloatArray  # smallest jump that is looked for, shape (n,) [rad]
    correction: FloatArray  # (n,) jumps that are removed from the reading [rad]
    followed: FloatArray  # (n,) fault that changes, and is removed, too [rad]
    drift: FloatArray  # (n,) its rate [rad/s]
    curve: FloatArray  # (n,) its acceleration [rad/s2]
    share: FloatArray  # (n,) of the reading that is removed as a scale error [-]
    rate_error: FloatArray  # (n,) bias of the rate sensor that is removed [rad/s]
    derived: FloatArray  # 1 where the rate is derived from the reading, shape (n,)
    sums: FloatArray  # of the current block, shape (3, n)
    # (capacity, 3 n + 4) ring: y, v, tau of blocks; mean time, length, place, error of stamps
    blocks: FloatArray
    found: IntArray  # `NONE` or what else of the last sample, shape (n,)
    size: FloatArray  # height of a jump that was found, or may be hidden, shape (n,) [rad]
    since: IntArray  # samples since that step, itself included, shape (n,)
    raw: FloatArray  # last reading as it came, shape (n,) [rad]
    still: IntArray  # samples for which the reading has not changed at all, shape (n,)
    held: IntArray  # the same before the last change, if that was the last sample, shape (n,)
    lively: FloatArray  # (n,) share of changes that go back and forth by more than rounding
    stop: FloatArray  # rate of the reading before it came to rest, shape (n,) [rad/s]
    grain: FloatArray  # (n,) smallest change of the reading, at least its rounding step [rad]
    noise: FloatArray  # (3, n) jumps lately, usual e^2 while noisy [rad2], correction before [rad]
    noisy: IntArray  # (n,) 1 while a reading is noisy
    doubtful: IntArray  # (HISTORY, n) 1: a wrong stamp explains e; 2: of several joints; 3: a gap
    filled: IntArray  # (n,) samples that e will still hold a reading that was filled in
    # (4, n) published rates of the last sample [rad/s]; products of what the readings' differences
    # are more than the rates around them with the changes of these, and squares of both [rad2/s2]
    published: FloatArray
    contrast: FloatArray  # (8, n) what published rates are compared with, see `LARGEST`
    probe: FloatArray  # (P, 2 n + 1) samples in a row as they came: time, readings, rates
    counters: IntArray  # (6,)
    clock: FloatArray  # moments, shape (10,) [s]


def new_sampler(
    derived: FloatArray, scale: FloatArray, smallest: FloatArray, capacity: int, probe: int
) -> Sampler:
    """A sampler without samples, for ``capacity`` blocks, and a probe of so many samples.

    ``derived``, shape (n,), is 1 where a rate is derived from its reading.  ``scale`` is the usual
    size of e to begin with, ``smallest`` the smallest jump, shape (n,) [rad].
    """
    n = len(derived)
    counters = np.zeros(6, np.int64)
    counters[PENDING] = -1
    return Sampler(
        np.zeros(HISTORY), np.zeros((HISTORY, 3, n)), np.zeros((HISTORY, n)), scale.copy(),
        scale.copy(), scale * scale, smallest.copy(), np.zeros(n), np.zeros(n), np.zeros(n),
        np.zeros(n), np.zeros(n), np.zeros(n),
        derived.copy(), np.zeros((3, n)), np.zeros((capacity, 3 * n + 4)), np.zeros(n, np.int64),
        np.zeros(n), np.zeros(n, np.int64),
        np.zeros(n), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n), np.zeros(n),
        np.full(n, np.inf),
        np.zeros((3, n)),
        np.zeros(n, np.int64), np.zeros((HISTORY, n), np.int64), np.zeros(n, np.int64),
        np.zeros((4, n)), np.zeros((8, n)), np.zeros((probe, 2 * n + 1)), counters,
        np.zeros(10))  # fmt: skip


@njit_in_place
def push_sample(
    sampler: Sampler, time: float, y: FloatArray, v: FloatArray, torque: FloatArray
) -> None:
    """Append a sample, with faults that are known removed, and test the one before for jumps.

    ``found`` and ``size`` of the sampler say what has been found at samples before.
    """
    n = y.shape[0]
    period = time - sampler.time[HISTORY - 1]
    if sampler.counters[PROBED] < sampler.probe.shape[0]:
        _probe(sampler, time, y, v)
    for k in range(HISTORY - 1):
        sampler.time[k] = sampler.time[k + 1]
        for i in range(n):
            sampler.jumps[k, i] = sampler.jumps[k + 1, i]
            sampler.doubtful[k, i] = sampler.doubtful[k + 1, i]
            for part in range(3):
                sampler.samples[k, part, i] = sampler.samples[k + 1, part, i]
    sampler.time[HISTORY - 1] = time
    follows = sampler.counters[COUNT] > 0  # else the sample before is on the other side of a gap
    lag = rate_lag(sampler)
    for i in range(n):
        sampler.found[i] = NONE
        sampler.filled[i] = max(sampler.filled[i] - 1, 0)
        change = sampler.curve[i] * period  # none before the first sample
        sampler.followed[i] += (sampler.drift[i] + 0.5 * change) * period
        sampler.drift[i] += change
        reading, way = y[i] - removed(sampler, i, y[i]), y[i] - sampler.raw[i]
        sampler.held[i] = 0
        if abs(way) > ROUNDING:
            sampler.held[i], sampler.still[i] = sampler.still[i], 0
            if follows:
                _watch_change(sampler, i, way)
        else:
            sampler.still[i] += 1
            if sampler.still[i] == 1:
                _measure_stop(sampler, i)
        _watch_lag(sampler, i, way, v[i], period)
        _watch_contrast(sampler, i, way / period, v[i], lag)
        sampler.raw[i] = y[i]
        sampler.samples[HISTORY - 1, 0, i] = reading
        rate = v[i] - sampler.derived[i] * (sampler.drift[i] + sampler.share[i] * v[i])
        rate -= sampler.rate_error[i]
        first = HISTORY - 1 if follows else 0  # nothing is known of before
        for k in range(first, HISTORY):
            sampler.samples[k, 1, i] = rate
        sampler.samples[HISTORY - 1, 2, i] = torque[i]
    for i in range(n):
        wrong = sampler.contrast[WRONG, i] + sampler.contrast[REPLACED, i] > 0.0
        if follows and (wrong or (lag > 0.0 and sampler.derived[i] == 1.0)):
            way = sampler.samples[HISTORY - 1, 0, i] - sampler.samples[HISTORY - 2, 0, i]
            sampler.samples[HISTORY - 1, 1, i] = way / period
    _fill_repeated(sampler)
    if sampler.counters[COUNT] > 1 and period > LATE * (
        sampler.time[HISTORY - 2] - sampler.time[HISTORY - 3]
    ):
        sampler.clock[STAMPS] = 1.0
    sampler.counters[COUNT] += 1
    if sampler.counters[COUNT] >= 3:
        _set_jumps(sampler)
        _find_jumps(sampler)
    for i in range(n):  # a jump goes first; a rate that is wrong is so again
        own = sampler.contrast[:, i]
        if sampler.found[i] == NONE and own[WRONG] > own[REPLACED] and own[CONTRARY_AT] == time:
            sampler.found[i] = CONTRARY


@njit_in_place
def _probe(sampler: Sampler, time: float, y: FloatArray, v: FloatArray) -> None:
    """Keep a sample of those that tell whether rates are derived from their readings."""
    k, n = sampler.counters[PROBED], y.shape[0]
    if k >= 0:
        row = sampler.probe[k]
        row[0] = time
        for i in range(n):
            row[1 + i], row[1 + n + i] = y[i], v[i]
    sampler.counters[PROBED] += 1


@njit_in_place
def _measure_stop(sampler: Sampler, i: int) -> None:
    """Rate that a reading had before it came to rest; noise tells none."""
    last = HISTORY - 1 - sampler.still[i]
    first = last - BEFORE_STOP
    if sampler.noisy[i] == 1 or sampler.counters[COUNT] <= BEFORE_STOP:
        sampler.stop[i] = 0.0
    elif first >= 0:
        way = sampler.samples[last, 0, i] - sampler.samples[first, 0, i]
        sampler.stop[i] = way / (sampler.time[last] - sampler.time[first])


@njit_in_place
def _watch_lag(sampler: Sampler, i: int, way: float, rate: float, period: float) -> None:
    """Learn from a sample by how much a published rate lags behind the differences of its reading.

    A rate that is late by d differs from them by d times its change over a period.
    """
    before = sampler.published[0, i]
    sampler.published[0, i] = rate
    if sampler.derived[i] == 0.0 or sampler.counters[COUNT] == 0:
        return
    change, more = rate - before, way / period - 0.5 * (rate + before)
    sampler.published[1, i] += more * change
    sampler.published[2, i] += change * change
    sampler.published[3, i] += more * more


@njit_in_place
def _watch_contrast(sampler: Sampler, i: int, difference: float, rate: float, lag: float) -> None:
    """Compare a rate that is said to be derived from its reading with the reading's differences.

    Whatever averages differences is between the smallest and the largest one lately, and a plain
    difference is as near to the newest one as ever.  A counter that overflows, or a wrong sign, is
    neither, and moves less than the joint; a difference that a stamp turns round, by at most `LATE`
    periods, is at most half the rate.
    """
    own, count = sampler.contrast[:, i], sampler.counters[COUNT]
    if sampler.derived[i] == 0.0 or count == 0:
        return
    kept = 1.0 - 1.0 / (_REMEMBERED * (1.0 + lag))
    own[LARGEST] = max(difference, kept * own[LARGEST])
    own[SMALLEST] = min(difference, kept * own[SMALLEST])
    apart, usual, learned = abs(rate - difference), own[USUAL], count > NOISE_MEMORY
    opposite = rate * difference < 0.0 and abs(rate) < abs(difference)
    contrary = opposite and apart > max(own[LARGEST], -own[SMALLEST])
    if not contrary:
        power = (min(apart, ROBUST * usual) if learned else apart) ** 2
        own[USUAL] = np.sqrt(usual * usual + (power - usual * usual) / min(count, SCALE_MEMORY))
    is_between = own[SMALLEST] <= rate <= own[LARGEST]
    is_usual = lag > 0.0 or not learned or apart <= JUMP_SCALE * usual
    moves = sampler.still[i] + sampler.held[i] == 0 and count > CONTRADICTIONS
    # Differences over less than a period, taken by a faster driver, have more noise.
    wrong = moves and contrary and apart > _USUAL * usual and not (is_between and is_usual)
    own[WRONG] = 1.0 if wrong else 0.0
    own[TIMES_WRONG] += own[WRONG] - own[TIMES_WRONG] / NOISE_MEMORY
    if wrong and own[TIMES_WRONG] > CONTRADICTIONS - 0.5:  # less what is forgotten
        own[CONTRARY_AT], own[APART] = sampler.time[HISTORY - 1], rate - difference


@njit_in_place
def rate_lag(sampler: Sampler) -> float:
    """Periods by which published rates are late, 0 if not later than the half of a difference.

    They are filtered then, all of them by one driver, and say less than the readings do.
    """
    late = _late_rates(sampler)
    return late if late > LAGGING else 0.0


@njit_in_place
def balance_lag(sampler: Sampler) -> float:
    """Periods by which derived rates of the samples are late: differences, by the half of one."""
    late = _late_rates(sampler)
    return 0.5 if late > LAGGING else max(late, 0.0)


@njit_in_place
def rate_noise(sampler: Sampler, i: int, interval: float) -> float:
    """Variance of what noise of a reading makes of a balance's change of its rate [rad2/s2].

    Balances are of intervals of a length [s].  Rates between two differences hold two readings in
    place of each.  Before the noise is known, it is more.
    """
    lag = balance_lag(sampler)
    share = ((1.0 - lag) * (1.0 - lag) + lag * lag) / (interval * interval)
    reading = sampler.calm[i] / readings_in_jump(sampler, i)
    return float(sampler.derived[i] * READINGS_AT_EDGES * share * reading)


@njit_in_place
def _late_rates(sampler: Sampler) -> float:
    """Periods by which published rates are late, if most of what they differ by shows it."""
    late, power, whole = 0.0, 0.0, 0.0
    for i in range(sampler.derived.shape[0]):
        late += sampler.published[1, i]
        power += sampler.published[2, i]
        whole += sampler.published[3, i]
    return late / power if late * late > 0.5 * power * whole else 0.0


@njit_in_place
def _fill_repeated(sampler: Sampler) -> None:
    """Move readings that were repeated to where the joints were: their driver was late.

    They went evenly to their new readings, if their rates before explain these, else on at those.
    """
    now, n, evenly = HISTORY - 1, sampler.scale.shape[0], True
    for i in range(n):
        held, reading = sampler.held[i], sampler.samples[:, 0, i]
        if held > 0 and not _is_late(sampler, i):  # it rested
            if sampler.derived[i] == 1.0 and sampler.counters[COUNT] > 0:
                time = (held + 1) * (sampler.time[now] - sampler.time[now - 1])
                sampler.samples[now, 1, i] = (reading[now] - reading[now - 1]) / time
        elif held > 0:
            time, way, rate = _since_change(sampler, i)
            # It slowed down, as far as its rounding tells.
            less = abs(way) < ROBUST * sampler.grain[i] and way * (rate * time - way) >= 0.0
            evenly = evenly and (less or abs(way - rate * time) <= smallest_jump(sampler, i))
            # Its e is that of all samples in which it was repeated: these are filled in evenly.
            rounded = _is_rounded(sampler, i, way)
            _learn_scale(sampler, i, way if rounded else way - rate * time, held + 1.0)
    for i in range(n):
        if sampler.held[i] == 0 or not _is_late(sampler, i):
            continue
        old = now - 1 - sampler.held[i]
        time, way, rate = _since_change(sampler, i)
        rate = way / time if evenly else rate
        for k in range(old + 1, now):
            since = sampler.time[k] - sampler.time[old]
            sampler.samples[k, 0, i] = sampler.samples[old, 0, i] + rate * since
        sampler.filled[i] = 3  # e of the last sample but one holds three readings
        if sampler.derived[i] == 1.0:
            sampler.samples[old + 1 :, 1, i] = rate


@njit_in_place
def _is_late(sampler: Sampler, i: int) -> bool:
    """Whether the samples in which a reading was repeated are still to enter the balance."""
    return bool(sampler.held[i] <= min(DELAY, sampler.counters[COUNT] - 2))


@njit_in_place
def _since_change(sampler: Sampler, i: int) -> tuple[float, float, float]:
    """Time since the change before the last one, way since then, and rate that it should have had.

    Rates of readings that go back and forth by their rounding are none.
    """
    now, old, rate = HISTORY - 1, HISTORY - 2 - sampler.held[i], sampler.samples[:, 1, i]
    way = sampler.samples[now, 0, i] - sampler.samples[old, 0, i]
    time = sampler.time[now] - sampler.time[old]
    if _is_rounded(sampler, i, way):
        return time, way, way / time
    return time, way, rate[old] if sampler.derived[i] == 1.0 else 0.5 * (rate[old] + rate[now])


@njit_in_place
def _is_rounded(sampler: Sampler, i: int, way: float) -> bool:
    """Whether a change of a reading that was repeated may be that of its rounding.

    One that has gone on at every sample shows no small changes, whatever it is rounded to.
    """
    old, reading = HISTORY - 2 - sampler.held[i], sampler.samples[:, 0, i]
    steady = old > 1 and (reading[old] - reading[old - 1]) * way > 0.0
    steady = steady and (reading[old - 1] - reading[old - 2]) * way > 0.0
    return bool(abs(way) < ROBUST * sampler.grain[i] and not steady)


@njit_in_place
def _watch_change(sampler: Sampler, i: int, change: float) -> None:
    """Learn rounding and noise of a reading from a change of it, before its sample is kept."""
    last, k = sampler.samples[:, 0, i], HISTORY - 2
    sampler.grain[i] = min(sampler.grain[i], abs(change))
    if sampler.noisy[i] == 1:
        return
    # More than one step of its rounding.
    least, before, first = 1.5 * sampler.grain[i], last[k] - last[k - 1], last[k - 1] - last[k - 2]
    alternates = change * before < 0.0 and before * first < 0.0
    beyond = min(abs(change), abs(before), abs(first)) > least
    sampler.lively[i] += (
        (1.0 if alternates and beyond else 0.0) - sampler.lively[i]
    ) / SCALE_MEMORY


@njit_in_place
def removed(sampler: Sampler, i: int, reading: float) -> float:
    """What is taken out of a reading of sensor i [rad]."""
    return float(sampler.correction[i] + sampler.followed[i] + sampler.share[i] * reading)


def put_back(sampler: Sampler, i: int, count: int) -> None:
    """Put what was taken out of the last readings of sensor i back, at each what it was then."""
    (offset, drift), share = _removed_since(sampler, i, count), sampler.share[i]
    reading, rate = sampler.samples[-count:, 0, i], sampler.samples[-count:, 1, i]
    reading[:] = (reading + offset) / (1.0 - share)
    rate[:] = (rate + drift) / (1.0 - sampler.derived[i] * share)


def take_out(sampler: Sampler, i: int, count: int) -> None:
    """Take faults that are known out of the last readings of sensor i, which are as they came."""
    (offset, drift), share = _removed_since(sampler, i, count), sampler.share[i]
    reading, rate = sampler.samples[-count:, 0, i], sampler.samples[-count:, 1, i]
    reading[:] = (1.0 - share) * reading - offset
    rate[:] = (1.0 - sampler.derived[i] * share) * rate - drift


def _removed_since(sampler: Sampler, i: int, count: int) -> tuple[FloatArray, FloatArray]:
    """What is taken out of the last readings and their rates, but for a share of them."""
    since = sampler.time[-count:] - sampler.time[-1]
    drift, curve = sampler.drift[i], sampler.curve[i]
    offset = sampler.correction[i] + sampler.followed[i] + (drift + 0.5 * curve * since) * since
    return offset, sampler.derived[i] * (drift + curve * since)


@njit_in_place
def _set_jumps(sampler: Sampler) -> None:
    """Write e of the last sample but one, less what a wrong stamp explains."""
    k, n, beyond = HISTORY - 2, sampler.scale.shape[0], False
    period = sampler.time[k] - sampler.time[k - 1]
    if sampler.clock[SEEN] == 0.0:
        sampler.clock[JITTER], sampler.clock[SEEN] = _expected_jitter(period), 1.0
    for i in range(n):
        rate = 0.0 if sampler.noisy[i] == 1 else _rate_before(sampler, i)
        stamps = sampler.clock[JITTER] * readings_in_jump(sampler, i)
        more = _noise_of_gaps(sampler, i, period) if sampler.derived[i] == 1.0 else 1.0
        sampler.usual[i] = np.sqrt(more * sampler.scale[i] ** 2 + stamps * rate * rate)
        sampler.jumps[k, i] = 0.0
        if not _is_followed_at_rest(sampler, i):
            sampler.jumps[k, i] = _way(sampler, i) - period * _mean_rate(sampler, i)
        sampler.doubtful[k, i] = 0
        beyond = beyond or _is_beyond(sampler, i, k)
    if not beyond:
        return
    late = _wrong_stamp(sampler, period)
    for i in range(n):
        if not _is_followed_at_rest(sampler, i):
            sampler.jumps[k, i] = _unexplained(sampler, i, period, late)
    gap, together = _gap(sampler), 0
    if late != 0.0:
        _doubt_stamps(sampler, abs(late))
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
        explained = LATE * gap * _largest_rate(sampler, i, HISTORY)
        if together > 1 or sampler.filled[i] > 0:
            most = _latest(sampler, i, period)
            explained = max(explained, most * _largest_rate(sampler, i, k))
        if abs(sampler.jumps[k, i]) < explained:
            sampler.doubtful[k, i] = 3 if gap > 0.0 else 2
            _doubt_stamps(sampler, LATE * period)
        elif _may_be_stamp(sampler, i, period):
            sampler.doubtful[k, i] = 1


@njit_in_place
def _noise_of_gaps(sampler: Sampler, i: int, period: float) -> float:
    """Variance of e of the last sample but one by the readings' noise, over that at even periods.

    Rates that are differences over short periods are extrapolated over a long one.  Where a period
    is short, e does not shrink as much: stamps are wrong there.
    """
    k, time = HISTORY - 2, sampler.time
    before, after = time[k - 1] - time[k - 2], time[k + 1] - time[k]
    before = before if sampler.counters[COUNT] > 3 else period  # else of before a gap, or none
    a, b = 0.5 * period / before, 0.5 * period / after
    whole = (1.0 + a) * (1.0 + a) + (1.0 + b) * (1.0 + b) + a * a + b * b
    return float(max(whole / readings_in_jump(sampler, i), 1.0))


@njit_in_place
def _doubt_stamps(sampler: Sampler, late: float) -> None:
    """Note that the last stamp but one is wrong; some that follow may be, too."""
    clock, now = sampler.clock, sampler.time[HISTORY - 2]
    clock[STAMPS] = 1.0
    if clock[LATE_UNTIL] < sampler.time[HISTORY - 1 - DELAY]:
        clock[LATEST], clock[LATE_FROM] = 0.0, sampler.time[HISTORY - 3]
    clock[LATEST] = max(clock[LATEST], late)
    clock[LATE_UNTIL] = now + HISTORY * (now - sampler.time[HISTORY - 3])


@njit_in_place
def _is_followed_at_rest(sampler: Sampler, i: int) -> bool:
    """Whether the last reading but one did not change at all, so that only its estimate moved."""
    return bool(sampler.followed[i] != 0.0 and max(sampler.still[i] - 1, sampler.held[i]) > 0)


@njit_in_place
def _gap(sampler: Sampler) -> float:
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
def _largest_rate(sampler: Sampler, i: int, end: int) -> float:
    """Largest rate of a joint in the last samples before one [rad/s]."""
    largest = 0.0
    for j in range(HISTORY - 6, end):
        largest = max(largest, abs(sampler.samples[j, 1, i]))
    return largest


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
    k, rate, way = HISTORY - 2, sampler.samples[:, 1, i], _way(sampler, i)
    if abs(way) <= ROUNDING:
        return 0.0
    way -= late * _motion(sampler, i)
    least = way - period * _mean_rate(sampler, i)
    if sampler.derived[i] == 0.0:
        for other in (k - 1, k + 1):
            rest = way - 0.5 * period * (rate[k] + rate[other])
            least = rest if abs(rest) < abs(least) else least
    return least


@njit_in_place
def _latest(sampler: Sampler, i: int, period: float) -> float:
    """Largest e of wrong stamps, over the rate [s]: of two of them, and of rates made of them."""
    return float(2.0 * LATE * (1.0 + sampler.derived[i]) * period)


@njit_in_place
def _way(sampler: Sampler, i: int) -> float:
    """By how much the last reading but one differs from that before [rad]."""
    return float(sampler.samples[HISTORY - 2, 0, i] - sampler.samples[HISTORY - 3, 0, i])


@njit_in_place
def _mean_rate(sampler: Sampler, i: int) -> float:
    """Mean rate of a joint before and after the last sample but one [rad/s].

    The difference of readings that are repeated is none.
    """
    before, after = sampler.samples[HISTORY - 3, 1, i], sampler.samples[HISTORY - 1, 1, i]
    if sampler.derived[i] == 1.0 and abs(_way(sampler, i)) <= ROUNDING:
        return 0.0
    if sampler.derived[i] == 1.0 and sampler.still[i] > 0:
        return float(before)
    return float(0.5 * (before + after))


@njit_in_place
def _motion(sampler: Sampler, i: int) -> float:
    """Rate of a joint at the last sample but one that its own jump does not change [rad/s]."""
    return _usual_rate(sampler, i) if sampler.derived[i] == 1.0 else _mean_rate(sampler, i)


@njit_in_place
def _usual_rate(sampler: Sampler, i: int) -> float:
    """Median rate of a joint over the last samples but the first [rad/s]: jumps do not count."""
    rates = sampler.samples[1:, 1, i]
    for one in rates:
        smaller, equal = 0, 0
        for other in rates:
            smaller += other < one
            equal += other == one
        if smaller <= len(rates) // 2 < smaller + equal:
            return float(one)
    return 0.0


@njit_in_place
def _wrong_stamp(sampler: Sampler, period: float) -> float:
    """By how much the stamp of the last sample but one is wrong, 0 if that explains nothing [s].

    It has to explain two joints at least, and more than it spoils: a joint may have jumped as well.
    """
    jumps, n, late, best = sampler.jumps[HISTORY - 2], sampler.scale.shape[0], 0.0, 1
    for c in range(n):
        rate = _motion(sampler, c)
        # Noisy readings jump by themselves, and repeated ones where they go on.
        if sampler.noisy[c] == 1 or sampler.filled[c] > 0 or abs(rate) < SLOW_RATE:
            continue
        if abs(jumps[c]) > _latest(sampler, c, period) * abs(rate):
            continue
        gained, common, weight = 0, 0.0, 0.0
        for i in range(n):
            own = _motion(sampler, i)
            way, usual = jumps[c] / rate * own, _USUAL * sampler.usual[i]
            if sampler.noisy[i] == 1 or sampler.filled[i] > 0:
                continue
            if max(abs(way), abs(jumps[i])) <= usual:
                continue
            if abs(jumps[i] - way) < max(0.5 * abs(way), usual):
                gained, common, weight = gained + 1, common + jumps[i] * own, weight + own * own
            else:
                gained -= abs(jumps[i]) <= usual
        if gained > best:
            best, late = gained, common / weight
    return late


@njit_in_place
def _may_be_stamp(sampler: Sampler, i: int, period: float) -> bool:
    """Whether a wrong stamp explains the jump of one joint, and no other joint contradicts.

    Where the reading has gone on at its rate before, it is the next one that jumps: the rate after
    this one, if it is derived, holds that jump.
    """
    jumps, rate = sampler.jumps[HISTORY - 2], _motion(sampler, i)
    ahead = _way(sampler, i) - period * sampler.samples[HISTORY - 3, 1, i]
    if sampler.derived[i] == 1.0 and abs(ahead) < LEFT * abs(jumps[i]):
        return False
    # Where stamps have been wrong, two in a row may be.  Rates that carry jumps tell no motion.
    usual = abs(_usual_rate(sampler, i))
    wrong = 2.0 if sampler.clock[STAMPS] == 1.0 else 1.0 + 0.5 * sampler.derived[i]
    largest = LATE * wrong * period * usual + _USUAL * sampler.usual[i]
    if rate == 0.0 or abs(jumps[i]) > largest:
        return False
    for j in range(sampler.scale.shape[0]):
        way = jumps[i] / rate * _motion(sampler, j)
        usual = max(0.5 * abs(way), _USUAL * sampler.usual[j])
        if j != i and abs(jumps[j] - way) > usual and sampler.filled[j] == 0:
            return False
    return True


@njit_in_place
def _find_jumps(sampler: Sampler) -> None:
    """After a large e, name clear steps at once, and what else it is 3 samples later."""
    n, k, waits = sampler.scale.shape[0], HISTORY - 2, sampler.counters[PENDING] >= 0
    for i in range(n):
        beyond = _is_beyond(sampler, i, k)
        _watch_noise(sampler, i, beyond)
        if sampler.noisy[i] == 1:
            continue
        if beyond:
            sampler.counters[PENDING] = max(sampler.counters[PENDING], 0)
        elif not waits and not (sampler.still[i] > HISTORY and sampler.lively[i] > LIVELY):
            own = sampler.scale[i] / sampler.usual[i]
            _learn_scale(sampler, i, sampler.jumps[k, i] * own, 1.0)
    if sampler.counters[PENDING] < 0:
        _learn_jitter(sampler)
    if waits:
        sampler.counters[PENDING] += 1
    elif sampler.counters[PENDING] < 0:
        return
    for i in range(n):
        if sampler.noisy[i] == 0 and _is_clear_step(sampler, i):
            _remove_step(sampler, i, k)
            sampler.jumps[k - 1, i] = 0.0
    if sampler.counters[PENDING] < 3:
        return
    sampler.counters[PENDING] = -1
    for i in range(n):
        if sampler.found[i] == NONE and sampler.noisy[i] == 0:
            _name_jump(sampler, i)


@njit_in_place
def _rate_before(sampler: Sampler, i: int) -> float:
    """Mean rate of a reading over the samples before those that the last e holds [rad/s]."""
    last, first = HISTORY - 5, max(HISTORY - sampler.counters[COUNT], 0)
    way = sampler.samples[last, 0, i] - sampler.samples[first, 0, i]
    return float(way / (sampler.time[last] - sampler.time[first])) if last > first else 0.0


@njit_in_place
def _expected_jitter(period: float) -> float:
    """Variance of stamps before any were seen [s2]."""
    return WRONG_STAMPS * (LATE * period) ** 2


@njit_in_place
def readings_in_jump(sampler: Sampler, i: int) -> float:
    """How many times the variance of a reading is in e.

    e is made of two readings; where the rates are derived from them, of four, with weights 1.5,
    1.5, 0.5 and 0.5.
    """
    return float(2.0 + 3.0 * sampler.derived[i])


@njit_in_place
def _learn_jitter(sampler: Sampler) -> None:
    """Learn the usual error of stamps from the joint that shows it best, of those that move.

    Errors of other readings may be correlated with its own.
    """
    k, clock, power, late = HISTORY - 2, sampler.clock, 0.0, 0.0
    for i in range(sampler.scale.shape[0]):
        if sampler.noisy[i] == 1 or sampler.filled[i] > 0 or sampler.doubtful[k, i] > 0:
            continue
        rate = _rate_before(sampler, i) * np.sqrt(readings_in_jump(sampler, i))
        if abs(rate) > np.sqrt(power) * sampler.scale[i]:
            power, late = (rate / sampler.scale[i]) ** 2, sampler.jumps[k, i] / rate
    expected = power * _expected_jitter(sampler.time[k] - sampler.time[k - 1])
    if expected == 0.0:
        return
    weight = (expected / (1.0 + expected)) ** 2
    seen = min(late * late, ROBUST**2 * (clock[JITTER] + 1.0 / power)) - 1.0 / power
    clock[SEEN] = min(clock[SEEN] + weight, SCALE_MEMORY)
    clock[JITTER] += weight * (seen - clock[JITTER]) / clock[SEEN]
    clock[JITTER] = max(clock[JITTER], 0.0)


@njit_in_place
def _learn_scale(sampler: Sampler, i: int, e: float, count: float) -> None:
    """Learn the usual size of e, from that of so many samples."""
    scale = sampler.scale[i]
    bounded = min(abs(e), ROBUST * scale)
    change = (bounded * bounded - scale * scale) * count / SCALE_MEMORY
    sampler.scale[i] = np.sqrt(scale * scale + change)


@njit_in_place
def _watch_noise(sampler: Sampler, i: int, beyond: bool) -> None:
    """Count jumps of a reading; many are noise, and no steps."""
    count, square, before = sampler.noise[:, i]
    jump = sampler.jumps[HISTORY - 2, i]
    if sampler.noisy[i] == 0 and count < _QUIET_COUNT:
        square, before = 0.0, sampler.correction[i]
    count += 1.0 if beyond and sampler.doubtful[HISTORY - 2, i] == 0 else 0.0
    count -= count / NOISE_MEMORY
    if sampler.noisy[i] == 1 or beyond:
        square += (jump * jump - square) / NOISE_MEMORY
    if sampler.noisy[i] == 0 and count > _NOISE_COUNT:
        sampler.noisy[i] = 1
        sampler.found[i] = NOISY
        sampler.lively[i] = 0.0  # the noise ends, too: readings that rest then are healthy
        wrong = sampler.correction[i] - before
        sampler.correction[i] = before
        for k in range(HISTORY):
            sampler.samples[k, 0, i] += wrong
    elif sampler.noisy[i] == 1 and count < _QUIET_COUNT:
        sampler.noisy[i] = 0
        sampler.found[i] = QUIET
    sampler.noise[0, i], sampler.noise[1, i], sampler.noise[2, i] = count, square, before


@njit_in_place
def smallest_jump(sampler: Sampler, i: int) -> float:
    """Size of e beyond which a reading jumps [rad]."""
    return float(max(JUMP_SCALE * sampler.usual[i], sampler.smallest[i]))


@njit_in_place
def _is_clear_step(sampler: Sampler, i: int) -> bool:
    """Whether the last sample but one jumped and the last one confirms it, whatever the rates."""
    k, samples = HISTORY - 2, sampler.samples
    jump = sampler.jumps[k, i]
    if sampler.doubtful[k, i] > 0 or sampler.doubtful[k - 1, i] > 0:
        return False
    # The e before a step is half as large where the rate is derived.
    if abs(jump) <= max(smallest_jump(sampler, i), abs(sampler.jumps[k - 1, i]) / (2.0 * LEFT)):
        return False
    way = samples[k + 1, 0, i] - samples[k - 1, 0, i] - jump
    period = sampler.time[k + 1] - sampler.time[k - 1]
    before, after = samples[k - 1, 1, i], samples[k + 1, 1, i]
    largest = max(abs(way - period * before), abs(way - 0.5 * period * (before + after)))
    return largest < LEFT * abs(jump)


@njit_in_place
def _name_jump(sampler: Sampler, i: int) -> None:
    """Tell steps, spikes and wrong rates apart by the pattern of e, and remove them."""
    first, last = HISTORY - 5, HISTORY - 2
    largest = 0.0
    for k in range(first, last):
        largest = max(largest, abs(sampler.jumps[k, i]))
    peak = first
    while abs(sampler.jumps[peak, i]) < MOST * largest:
        peak += 1
    size, after = sampler.jumps[peak, i], sampler.jumps[peak + 1, i]
    if abs(size) <= smallest_jump(sampler, i):
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
            sampler.clock[STAMPS] = 1.0
        middle = 0.5 * (sampler.samples[peak - 1, 0, i] + sampler.samples[peak + 1, 0, i])
        sampler.samples[peak, 0, i] = middle
        _smooth_rates(sampler, i, peak, 2)
        return
    if peak + 2 <= last and abs(after) < LEFT * abs(size):
        again = sampler.jumps[peak + 2, i]
        if abs(again - size) < LEFT * abs(size):
            _smooth_rates(sampler, i, peak + 1, 1)
            return
    if doubt == 0 or (doubt == 1 and sampler.clock[STAMPS] == 0.0 and _lasts(sampler, i, peak)):
        _remove_step(sampler, i, peak)
    elif doubt == 3:
        sampler.found[i], sampler.size[i] = HIDDEN, size


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
    before, after = peak - 2, min(peak + 2, HISTORY - 1)
    rate = 0.5 * (
        sampler.samples[before, 1, i] + sampler.samples[min(after + 1, HISTORY - 1), 1, i]
    )
    way = sampler.samples[after, 0, i] - sampler.samples[before, 0, i]
    rest, size = way - rate * (sampler.time[after] - sampler.time[before]), sampler.jumps[peak, i]
    return bool(rest * np.sign(size) > MOST * abs(size))


@njit_in_place
def _remove_step(sampler: Sampler, i: int, peak: int) -> None:
    """Take a step out of all readings since its first one."""
    size = sampler.jumps[peak, i]
    sampler.found[i] = STEP
    sampler.size[i] = size
    sampler.since[i] = HISTORY - peak
    sampler.correction[i] += size
    for k in range(peak, HISTORY):
        sampler.samples[k, 0, i] -= size
    sampler.jumps[peak, i] = 0.0
    if sampler.still[i] > 0:  # it did not move by the step
        _measure_stop(sampler, i)
    _smooth_rates(sampler, i, peak, 1)


@njit_in_place
def _smooth_rates(sampler: Sampler, i: int, start: int, count: int) -> None:
    """Replace rates that carry a jump by those around them."""
    before, after = sampler.samples[start - 1, 1, i], sampler.samples[start + count, 1, i]
    for k in range(start, start + count):
        sampler.samples[k, 1, i] = 0.5 * (before + after)


@njit_in_place
def move_to_balance(sampler: Sampler, balance: Balance, per_block: int, blocks: int) -> bool:
    """Let the sample that is ``DELAY`` old enter the balance; true if a balance is complete.

    A block has ``per_block`` samples, an interval has ``blocks``.
    """
    k = HISTORY - 1 - DELAY
    if sampler.counters[COUNT] <= DELAY + 1:
        if sampler.counters[COUNT] == DELAY + 1:
            _start_interval(sampler, sampler.time[k])
        return False
    n, now = sampler.scale.shape[0], sampler.time[k]
    for part in range(3):
        for i in range(n):
            sampler.sums[part, i] += sampler.samples[k, part, i]
    lag = balance_lag(sampler)  # a difference is the rate between two samples
    for i in range(n):
        late = lag * (sampler.samples[k + 1, 1, i] - sampler.samples[k, 1, i])
        sampler.sums[1, i] += sampler.derived[i] * late
    sampler.clock[TIMES] += now
    if sampler.clock[LATE_FROM] < now < sampler.clock[LATE_UNTIL]:
        sampler.clock[IN_DOUBT] = sampler.clock[LATEST]
    sampler.counters[IN_BLOCK] += 1
    if sampler.counters[IN_BLOCK] < per_block:
        return False
    _close_block(sampler, balance, now, blocks)
    if sampler.counters[IN_INTERVAL] < blocks:
        return False
    complete = close_interval(balance, now - sampler.clock[INTERVAL_START])
    sampler.clock[INTERVAL_START] = now
    sampler.counters[IN_INTERVAL] = 0
    return complete


@njit_in_place
def _start_interval(sampler: Sampler, now: float) -> None:
    """Begin block and interval."""
    sampler.sums[:] = 0.0
    sampler.clock[TIMES] = 0.0
    sampler.counters[IN_BLOCK] = 0
    sampler.counters[IN_INTERVAL] = 0
    sampler.clock[INTERVAL_START] = now
    sampler.clock[BLOCK_START] = now


@njit_in_place
def _close_block(sampler: Sampler, balance: Balance, now: float, blocks: int) -> None:
    """Give the means of the block to the balance, and keep them."""
    n, count = sampler.scale.shape[0], sampler.counters[IN_BLOCK]
    capacity = sampler.blocks.shape[0]
    row = sampler.blocks[sampler.counters[BLOCKS] % capacity]
    for part in range(3):
        for i in range(n):
            row[part * n + i] = sampler.sums[part, i] / count
            sampler.sums[part, i] = 0.0
    length = now - sampler.clock[BLOCK_START]
    place = (sampler.counters[IN_INTERVAL] + 0.5) / blocks
    # Where samples are missing, the mean of the readings is not that of the middle.
    row[3 * n] = sampler.clock[TIMES] / count
    if sampler.counters[COUNT] > HISTORY + 2 * blocks * count:
        _calm_rates(sampler, row, sampler.blocks[(sampler.counters[BLOCKS] - blocks) % capacity])
    sampler.clock[TIMES] = 0.0
    row[3 * n + 1] = length
    row[3 * n + 2] = place
    row[3 * n + 3] = sampler.clock[IN_DOUBT]
    for i in range(n):  # what is louder than usual shows at once, that it has become usual later
        more = sampler.scale[i] * sampler.scale[i] - sampler.calm[i]
        sampler.calm[i] += more if more < 0.0 else more / capacity
    sampler.clock[IN_DOUBT] = 0.0
    add_block(balance, row[:n], row[n : 2 * n], row[2 * n : 3 * n], row[3 * n], length, place)
    sampler.counters[BLOCKS] += 1
    sampler.counters[IN_BLOCK] = 0
    sampler.counters[IN_INTERVAL] += 1
    sampler.clock[BLOCK_START] = now


@njit_in_place
def _calm_rates(sampler: Sampler, block: FloatArray, before: FloatArray) -> None:
    """Let rates that are derived from noisy readings be those since the block an interval before.

    Torques grow with their squares, of which noise changes the mean.
    """
    n = sampler.scale.shape[0]
    for i in range(n):
        if sampler.noisy[i] == 1 and sampler.derived[i] == 1.0:
            block[n + i] = (block[i] - before[i]) / (block[3 * n] - before[3 * n])


def block_end(block: FloatArray) -> float:
    """When a block of `Sampler.blocks` ended [s]."""
    n = len(block) // 3 - 1
    return float(block[3 * n] + 0.5 * block[3 * n + 1])


def restart(sampler: Sampler, balance: Balance) -> None:
    """Begin again after a gap in the samples; corrections and what was learned stay."""
    sampler.counters[:] = 0
    sampler.counters[PENDING] = -1
    sampler.still[:] = 0
    sampler.doubtful[:] = 0
    sampler.filled[:] = 0
    sampler.sums[:] = 0.0
    sampler.clock[LATE_FROM:] = 0.0
    drop_interval(balance)


@njit_in_place
def take_samples(
    sampler: Sampler,
    balance: Balance,
    times: FloatArray,
    samples: FloatArray,
    begin: int,
    plan: tuple[int, int],
) -> tuple[int, bool]:
    """Take samples until something has to be decided: a balance is complete, or a reading jumped.

    ``times``, shape (N,), are stamps [s], ``samples``, shape (N, 3, n), readings, rates and
    torques; ``plan`` holds how many samples a block and how many blocks an interval has.  Returns
    the next sample to take, and whether a balance is complete.
    """
    n = sampler.scale.shape[0]
    for k in range(begin, times.shape[0]):
        push_sample(sampler, times[k], samples[k, 0], samples[k, 1], samples[k, 2])
        complete = move_to_balance(sampler, balance, plan[0], plan[1])
        jumped = False
        for i in range(n):
            jumped = jumped or sampler.found[i] != NONE
        if complete or jumped:
            return k + 1, complete
    return times.shape[0], False
