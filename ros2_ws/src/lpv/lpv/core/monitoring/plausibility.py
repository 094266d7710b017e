"""Which measurements of a driver are those of an arm: stamps, values, repetitions.

All functions are compiled; what they remember is in arrays and records.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.monitoring.stamp_gate import JUMP
from lpv.core.serial_arm.chain import BoolArray, FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.sampler import BEFORE_STOP, DELAY
from lpv.core.serial_arm.turns import FARTHEST
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import memory, new_record, record_type
from lpv.core.support.timestamps import NANOSECONDS

_LARGEST = (FARTHEST, 1e4)
"""Readings and rates beyond are no values of an arm [rad], [rad/s]; readings of joints that turn
without end count from the last one."""


class Driver(NamedTuple):
    """What a driver has read."""

    position: FloatArray  # (n,) the last one of each joint, NaN before any [rad]
    stamp: IntArray  # (1,) of the last measurement [ns]


@njit_in_place
def find_unread(
    stamps: IntArray, samples: FloatArray, small: FloatArray, read: Driver, unread: BoolArray
) -> None:
    """Find measurements of a driver that has not read its hardware; their readings become NaN.

    Until it has, and when it connects again, positions of all joints are NaN or exactly 0.  At
    its start such zeros are the arm's if anything else is other than 0, and later if at most one
    joint was farther than ``small`` from there: a single sensor that fails may read 0, too.
    """
    joints = samples.shape[2]
    for k in range(len(stamps)):
        if abs(stamps[k] - read.stamp[0]) > JUMP:
            read.position[:] = np.nan  # the driver has started
        read.stamp[0] = stamps[k]
        known = others = False
        away = zero = missing = 0
        for i in range(joints):
            known = known or not np.isnan(read.position[i])
            away += abs(read.position[i]) > small[i]
            zero += samples[k, 0, i] == 0.0
            missing += np.isnan(samples[k, 0, i])
            others = others or abs(samples[k, 1, i]) > 0.0 or abs(samples[k, 2, i]) > 0.0
        if known:
            unread[k] = zero == joints and away > 1
        else:
            unread[k] = missing == joints or (zero + missing == joints and not others)
        for i in range(joints):
            if unread[k]:
                samples[k, 0, i] = np.nan
            elif not np.isnan(samples[k, 0, i]):
                read.position[i] = samples[k, 0, i]


REPEATS = record_type(
    ('since', 'i8'),  # stamp from which on readings and rates have been these [ns]
    ('times', 'i8'),  # that its readings and rates came again
    ('idle', 'i8'),  # that efforts did
    ('stamp', 'i8'),  # of the last time [ns]
    ('stalled', '?'),  # so often that it is none
)


class Repeats(NamedTuple):
    """What tells a driver that repeats itself."""

    own: np.ndarray  # memory of a record of `REPEATS`
    measured: FloatArray  # (3, n) the last measurement, as it came
    grain: FloatArray  # (2, n) smallest changes of readings, efforts; infinite before any
    recent: FloatArray  # (2 BEFORE_STOP + 1, 2, n) the last readings and efforts


def new_repeats(joints: int) -> Repeats:
    """No measurement has come."""
    recent = np.full((2 * BEFORE_STOP + 1, 2, joints), np.nan)
    grain = np.full((2, joints), np.inf)
    return Repeats(memory(new_record(REPEATS)), np.zeros((3, joints)), grain, recent)


class Stream(NamedTuple):
    """What tells samples that simply follow the one before."""

    stamp: int  # of the last usable sample [ns]
    newest: int  # of all samples [ns]
    gap: int  # longest interval [ns]
    independent: BoolArray  # rates of a sensor of their own
    endless: BoolArray  # readings of joints that turn without end
    reading: FloatArray  # of the last usable sample [rad]
    repeats: Repeats


@njit_in_place
def is_plausible(
    sample: FloatArray, independent: BoolArray, endless: BoolArray, last: FloatArray
) -> bool:
    """Whether readings, and rates of sensors of their own, are finite and of an arm."""
    for i in range(sample.shape[1]):
        reading, rate = abs(sample[0, i]), abs(sample[1, i])
        if endless[i]:
            reading = abs(sample[0, i] - last[i])
        if not reading <= _LARGEST[0] or rate > _LARGEST[1]:
            return False
        if independent[i] and not rate <= _LARGEST[1]:
            return False
    return True


@njit_in_place
def _keep(recent: FloatArray, sample: FloatArray) -> None:
    """Put readings and efforts of a measurement behind the last ones, shape (count, 2, n)."""
    last = recent.shape[0] - 1
    for i in range(recent.shape[2]):
        for k in range(last):
            recent[k, 0, i], recent[k, 1, i] = recent[k + 1, 0, i], recent[k + 1, 1, i]
        recent[last, 0, i], recent[last, 1, i] = sample[0, i], sample[2, i]


@njit_in_place
def _stopped_dead(recent: FloatArray, grain: FloatArray) -> bool:
    """Whether readings and efforts changed no more from one sample to the next, motion or noise.

    A joint that is braked goes at most a third of its way in as many samples before the last ones,
    and its efforts come to rest earlier or later.  A reading at rest goes back and forth by its
    rounding, noise by more.
    """
    last, stops = recent.shape[0] - 1, False
    for part in range(2):
        works = False
        for i in range(recent.shape[2]):
            beyond, before, turns = -last * grain[part, i], 0.0, 0
            for k in range(last):
                way = recent[k + 1, part, i] - recent[k, part, i]
                beyond += 2.0 * abs(way) if k >= last // 2 else -abs(way)
                turns += way * before < 0.0 and min(abs(way), abs(before)) > ROBUST * grain[part, i]
                before = way
            works = works or abs(before) > 0.0
            stops = stops or turns > 1 or (part == 0 and beyond > 0.0)
        if not works:
            return False
    return stops


@njit_in_place
def _is_repeated(stream: Stream, stamp: int, sample: FloatArray) -> bool:
    """Whether a measurement is the one before once more, from a driver that had no new one.

    One that equals it in all readings and rates is none of an arm that moves: by now, a joint would
    have gone farther at its rate than its reading is rounded, or efforts have stopped with it in
    one sample.  A few are `sampling`'s.
    """
    last, one, same, idle, fresh = stream.repeats, stream.repeats.own[0], True, True, False
    if one.stamp == stamp:
        return bool(one.stalled)
    one.stamp = stamp
    for part in range(3):
        for i in range(sample.shape[1]):
            change = abs(sample[part, i] - last.measured[part, i])
            equal = change == 0.0 or (part != 0 and np.isnan(change))  # no rate is none
            same, idle = same and (equal or part == 2), idle and (equal or part != 2)
            if part != 1 and change > 0.0:
                last.grain[part // 2, i] = min(last.grain[part // 2, i], change)
                fresh = True
            last.measured[part, i] = sample[part, i]
    if fresh:
        _keep(last.recent, sample)
    one.idle = one.idle + 1 if idle else 0
    one.stalled = one.stalled and same and idle
    if not same:
        one.since, one.times = stamp, 0
        return False
    one.times += 1
    if min(one.times, one.idle) == DELAY + 1:
        one.stalled = _stopped_dead(last.recent, last.grain)
    for i in range(sample.shape[1]):
        way = abs(sample[1, i]) * (stamp - one.since) / NANOSECONDS
        one.stalled = one.stalled or (one.times > DELAY and way > ROBUST * last.grain[0, i])
    return bool(one.stalled)


@njit_in_place
def count_regular(stream: Stream, stamps: IntArray, samples: FloatArray, begin: int) -> int:
    """Number of samples from ``begin`` on that can be used as they are."""
    last, newest = stream.stamp, stream.newest
    for k in range(begin, len(stamps)):
        if _is_repeated(stream, stamps[k], samples[k]):
            return k - begin
        if not newest < stamps[k] <= newest + JUMP or stamps[k] > last + stream.gap:
            return k - begin
        before = samples[k - 1, 0] if k > begin else stream.reading
        if not is_plausible(samples[k], stream.independent, stream.endless, before):
            return k - begin
        last = newest = stamps[k]
    return len(stamps) - begin
