"""Samples on their way into the balance: their record, and what its parts say."""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.information import ROBUST, median
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import memory, new_record, new_records, record_type

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
WRONG_RATE = 4
"""Value of `Sampler.doubtful` where a rate of its own, that is wrong, explains e."""
ROUNDING = 1e-12
"""Change of a reading that rounding explains, where it was found from joint positions [rad]."""
_SINGLE_PRECISION = 1e-6
"""What a change of a reading of a few radians may be off by in single precision [rad]."""
JUMP_SCALE = 10.0
"""A jump is larger than so many times the usual size of e."""
LATE = 1.5
"""Largest error of a stamp, over the time since the sample before; halfway between one period and
two, samples after so many have others lost before them."""
USUAL_JUMP = 0.5 * JUMP_SCALE
"""Sizes of e, over the usual one, that are nothing special."""
BEFORE_STOP = 3
"""Periods before a reading comes to rest over which its speed is measured."""
SCALE_MEMORY = 256.0
"""Samples over which the usual size of e, and that a reading has noise, are learned."""
LIVELY = 0.02
"""Share of changes that go back and forth from which on a reading has noise, and never rests."""
NOISE_MEMORY = 32.0
"""Samples over which jumps of a reading are counted."""
QUIET_COUNT = 0.5
"""Jumps among those from which on no noise is left."""


STATE = record_type(
    ('count', 'i8'),  # samples
    ('in_block', 'i8'),  # samples in the block
    ('in_interval', 'i8'),  # blocks in the interval
    ('pending', 'i8'),  # sensor-independent age of a jump that waits for its kind, -1 if none
    ('blocks', 'i8'),  # blocks written
    ('probed', 'i8'),  # samples in the probe, or those until one begins, times -1
    ('late_from', 'f8'),  # from when they were [s]
    ('late_until', 'f8'),  # until when [s]
    ('in_doubt', 'f8'),  # by how much stamps of the block may be wrong [s]
    ('block_length', 'f8'),  # of the block so far [s]
    ('times', 'f8'),  # integral of time over it [s2]
    ('stamps', 'f8'),  # 1 once a stamp has been wrong, until they are right for long
    ('times_off', 'f8'),  # how often one was
    ('until_off', 'f8'),  # in how many samples
    ('right_for', 'f8'),  # samples since then
    ('jitter', 'f8'),  # usual variance of stamps [s2]
    ('seen', 'f8'),  # of how many stamps it was learned
    ('latest', 'f8'),  # by how much stamps were wrong lately [s]
)
LEARNED = 'stamps', 'times_off', 'until_off', 'right_for', 'jitter', 'seen', 'latest'
"""What of these is kept after a gap in the samples."""
LINES = record_type(
    ('jump', 'f8'),  # the last one between lines [rad]
    ('scale', 'f8'),  # its usual size [rad]
    ('limit', 'f8'),  # over how many times that it is a step
    ('wait', 'f8'),  # samples until none of those kept is next to one that was filled in
    ('found', 'f8'),  # 1 where the last step was found between lines
)
CONTRAST = record_type(
    ('largest', 'f8'),  # difference of the reading lately [rad/s]
    ('smallest', 'f8'),  # the same [rad/s]
    ('usual', 'f8'),  # what the published rate differs from them by [rad/s]
    ('apart', 'f8'),  # what it does now [rad/s]
    ('wrong', 'f8'),  # 1 where it contradicts them
    ('times_wrong', 'f8'),  # how often it did lately
    ('contrary_at', 'f8'),  # when last [s]
    ('replaced', 'f8'),  # 1 while differences replace it
)


class Sampler(NamedTuple):
    """Samples on their way into the balance."""

    time: FloatArray  # stamps of the last samples, newest last, shape (HISTORY,) [s]
    samples: FloatArray  # readings, rates, torques, shape (HISTORY, 3, n)
    jumps: FloatArray  # e of each, shape (HISTORY, n)
    scale: FloatArray  # usual size of e by the readings, shape (n,) [rad]
    usual: FloatArray  # (n,) that of the last e, by the errors of stamps, too [rad]
    lines: np.ndarray  # (n,) of `LINES`: jumps between lines through four samples
    calm: FloatArray  # (n,) square of scale where it was small, over the blocks kept [rad2]
    smallest: FloatArray  # smallest jump that is looked for, shape (n,) [rad]
    unit: FloatArray  # (n,) what counts as much as 1 rad, see `SerialJoint.scale` [rad]
    correction: FloatArray  # (n,) jumps that are removed from the reading [rad]
    followed: FloatArray  # (n,) fault that changes, and is removed, too [rad]
    drift: FloatArray  # (n,) its rate [rad/s]
    curve: FloatArray  # (n,) its acceleration [rad/s2]
    share: FloatArray  # (n,) of the reading that is removed as a scale error [-]
    rate_error: FloatArray  # (n,) bias of the rate sensor that is removed [rad/s]
    derived: FloatArray  # 1 where the rate is derived from the reading, shape (n,)
    sums: FloatArray  # integrals over the current block, shape (3, n)
    hidden: FloatArray  # (n,) what samples lost in it may hide of torques, at most [N m s]
    # (capacity, 3 n + 4) ring: y, v, tau of blocks; mean time, length, place, error of stamps
    blocks: FloatArray
    lost: FloatArray  # (capacity, n) ring: ``hidden`` of these blocks
    found: IntArray  # `NONE` or what else of the last sample, shape (n,)
    size: FloatArray  # height of a jump that was found, or may be hidden, shape (n,) [rad]
    since: IntArray  # samples since that step, itself included, shape (n,)
    raw: FloatArray  # last reading as it came, shape (n,) [rad]
    change: FloatArray  # (n,) what it changed by, 0 after a gap [rad]
    measured: FloatArray  # (n,) samples since the effort was missing, infinite if it never was
    still: IntArray  # samples for which the reading has not changed at all, shape (n,)
    held: IntArray  # the same before the last change, if that was the last sample, shape (n,)
    lively: FloatArray  # (n,) share of changes that go back and forth by more than rounding
    stop: FloatArray  # rate of the reading before it came to rest, shape (n,) [rad/s]
    grain: FloatArray  # (n,) smallest change of the reading, at least its rounding step [rad]
    step: FloatArray  # (n,) the same, or smallest change of such a change, if that is less [rad]
    # (4, n) jumps lately, usual e^2 while noisy [rad2], correction before [rad], how many e^2 it is
    # the mean of
    noise: FloatArray
    noisy: IntArray  # (n,) 1 while a reading is noisy
    # (HISTORY, n) 1: a wrong stamp explains e; 2: of several joints; 3: a gap; `WRONG_RATE`
    doubtful: IntArray
    filled: IntArray  # (n,) samples that e will still hold a reading that was filled in
    # (4, n) published rates of the last sample [rad/s]; products of what the readings' differences
    # are more than the rates around them with the changes of these, and squares of both [rad2/s2]
    published: FloatArray
    contrast: np.ndarray  # (n,) of `CONTRAST`: what published rates are compared with
    probe: FloatArray  # (P, 2 n + 1) samples in a row as they came: time, readings, rates
    state: np.ndarray  # memory of a record of `STATE`
    period: float  # sample time of the file [s]
    per_block: int  # samples of a block
    per_interval: int  # blocks of an interval


def new_sampler(
    derived: FloatArray,
    scale: FloatArray,
    smallest: FloatArray,
    sizes: tuple[int, int, int],
    probe: int,
    unit: FloatArray,
    period: float,
) -> Sampler:
    """A sampler without samples, with a probe of so many samples.

    ``sizes`` are how many blocks are kept, samples a block and blocks an interval has.
    ``derived``, shape (n,), is 1 where a rate is derived from its reading.  ``scale`` is the usual
    size of e to begin with, ``smallest`` the smallest jump, ``unit`` what counts as much as 1 rad,
    shape (n,) [rad]; ``period`` is the sample time [s].
    """
    n, (capacity, *plan) = len(derived), sizes
    lines, contrast = new_records(LINES, n), new_records(CONTRAST, n)
    lines['scale'], lines['limit'] = scale, np.inf
    return Sampler(
        np.zeros(HISTORY), np.zeros((HISTORY, 3, n)), np.zeros((HISTORY, n)), scale.copy(),
        scale.copy(), lines, scale * scale, smallest.copy(), unit.copy(),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n),
        derived.copy(), np.zeros((3, n)), np.zeros(n), np.zeros((capacity, 3 * n + 4)),
        np.zeros((capacity, n)), np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.int64),
        np.zeros(n), np.zeros(n), np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n, np.int64),
        np.zeros(n), np.zeros(n), np.full(n, np.inf), np.full(n, np.inf), np.zeros((4, n)),
        np.zeros(n, np.int64), np.zeros((HISTORY, n), np.int64), np.zeros(n, np.int64),
        np.zeros((4, n)), contrast, np.zeros((probe, 2 * n + 1)),
        memory(new_record(STATE, pending=-1)), period, *plan)  # fmt: skip


@njit_in_place
def measure_stop(sampler: Sampler, i: int) -> None:
    """Rate that a reading had before it came to rest; noise tells none."""
    last = HISTORY - 1 - sampler.still[i]
    first = last - BEFORE_STOP
    if sampler.noisy[i] == 1 or sampler.state[0].count <= BEFORE_STOP:
        sampler.stop[i] = 0.0
    elif first >= 0:
        way = sampler.samples[last, 0, i] - sampler.samples[first, 0, i]
        sampler.stop[i] = way / (sampler.time[last] - sampler.time[first])


@njit_in_place
def watch_change(sampler: Sampler, i: int, change: float) -> None:
    """Learn rounding and noise of a reading from a change of it, before its sample is kept."""
    last, k = sampler.samples[:, 0, i], HISTORY - 2
    sampler.grain[i] = min(sampler.grain[i], abs(change))
    sampler.step[i], further = min(sampler.step[i], abs(change)), abs(change - sampler.change[i])
    if further > _SINGLE_PRECISION:  # a joint that is fast makes no small changes
        sampler.step[i] = min(sampler.step[i], further)
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
def last_way(sampler: Sampler, i: int) -> float:
    """By how much the last reading but one differs from that before [rad]."""
    return float(sampler.samples[HISTORY - 2, 0, i] - sampler.samples[HISTORY - 3, 0, i])


@njit_in_place
def mean_rate(sampler: Sampler, i: int) -> float:
    """Mean rate of a joint before and after the last sample but one [rad/s].

    The difference of readings that are repeated is none.
    """
    before, after = sampler.samples[HISTORY - 3, 1, i], sampler.samples[HISTORY - 1, 1, i]
    if sampler.derived[i] == 1.0 and abs(last_way(sampler, i)) <= ROUNDING:
        return 0.0
    if sampler.derived[i] == 1.0 and sampler.still[i] > 0:
        return float(before)
    return float(0.5 * (before + after))


@njit_in_place
def steady_rate(sampler: Sampler, i: int) -> float:
    """Rate of a joint at the last sample but one that its own jump does not change [rad/s].

    A reading that rested and has gone on for two samples moves, whatever it did before.
    """
    if sampler.derived[i] == 0.0:
        return mean_rate(sampler, i)
    own, after = sampler.samples[HISTORY - 2, 1, i], sampler.samples[HISTORY - 1, 1, i]
    usual, period = usual_rate(sampler, i), sampler.time[HISTORY - 1] - sampler.time[HISTORY - 2]
    rested = abs(usual) * period <= ROUNDING
    return float(after) if rested and own * after > 0.0 else usual


@njit_in_place
def usual_rate(sampler: Sampler, i: int) -> float:
    """Median rate of a joint over the last samples but the first [rad/s]: jumps do not count."""
    return median(sampler.samples[1:, 1, i])


@njit_in_place
def rate_before(sampler: Sampler, i: int) -> float:
    """Mean rate of a reading over the samples before those that the last e holds [rad/s].

    Of a reading that jumped lately it is the part that e does not explain: noise is no motion.
    """
    last, first, largest = HISTORY - 5, max(HISTORY - sampler.state[0].count, 0), 0.0
    if last <= first:
        return 0.0
    if sampler.noise[0, i] > QUIET_COUNT:
        for k in range(first + 1, last + 1):
            if sampler.doubtful[k, i] == 0:
                largest = max(largest, abs(sampler.jumps[k, i]))
    way = sampler.samples[last, 0, i] - sampler.samples[first, 0, i]
    rate = max(abs(way) - largest, 0.0) / (sampler.time[last] - sampler.time[first])
    return float(np.copysign(rate, way))


@njit_in_place
def readings_in_jump(sampler: Sampler, i: int) -> float:
    """How many times the variance of a reading is in e.

    e is made of two readings; where the rates are derived from them, of four, with weights 1.5,
    1.5, 0.5 and 0.5.
    """
    return float(2.0 + 3.0 * sampler.derived[i])


@njit_in_place
def learn_scale(sampler: Sampler, i: int, e: float, count: float) -> None:
    """Learn the usual size of e, from that of so many samples."""
    sampler.scale[i] = learned_scale(sampler.scale[i], e, count)


@njit_in_place
def learned_scale(scale: float, e: float, count: float) -> float:
    """Usual size of what was as large as ``e`` in so many samples; outliers count as `ROBUST`."""
    bounded = min(abs(e), ROBUST * scale)
    change = (bounded * bounded - scale * scale) * count / SCALE_MEMORY
    return float(np.sqrt(scale * scale + change))


@njit_in_place
def smallest_jump(sampler: Sampler, i: int) -> float:
    """Size of e beyond which a reading jumps [rad]."""
    return float(max(JUMP_SCALE * sampler.usual[i], least_jump(sampler, i)))


@njit_in_place
def rounding_step(sampler: Sampler, i: int) -> float:
    """What a reading may be rounded to, 0 if it moved by more than that alone [rad]."""
    step = sampler.step[i]
    return float(step) if step <= priors.COARSEST_ROUNDING * sampler.unit[i] else 0.0


@njit_in_place
def least_jump(sampler: Sampler, i: int) -> float:
    """Size of a jump that is looked for, however quiet the reading is [rad].

    It exceeds what rounding makes of e: twice as much where rates are made of the reading.
    """
    rounding = (1.0 + sampler.derived[i]) * rounding_step(sampler, i)
    return float(sampler.smallest[i] + rounding)


def block_end(block: FloatArray) -> float:
    """When a block of `Sampler.blocks` ended [s]."""
    n = len(block) // 3 - 1
    return float(block[3 * n] + 0.5 * block[3 * n + 1])
