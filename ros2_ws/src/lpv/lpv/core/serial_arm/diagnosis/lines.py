"""Steps of readings between a straight line through four samples and one through the next four.

Where a rate is the difference of its reading, e is the jump between lines through two samples each.
Lines through four have 0.65 times its noise, if that is white, but are known two samples later, and
a motion's third derivative bends them eight times as much: what they usually jump by is learned.
"""

import numpy as np

from lpv.core.serial_arm.diagnosis.sampler import (
    HISTORY,
    LATE,
    LEFT,
    MOST,
    USUAL_JUMP,
    Sampler,
    learned_scale,
    least_jump,
    smallest_jump,
)
from lpv.core.support.jit import njit_in_place

AFTER = HISTORY // 2
"""First sample of the second line."""
_WEIGHTS = (0.85, 0.45, 0.05, -0.35)
"""Of samples 0.5, 1.5, 2.5 and 3.5 periods from the middle, in the value of their line there."""

BEND = 2.75
"""How far such lines jump at most, over the largest e, of a healthy reading: an acceleration that
turns over in the middle, from -a to a, bends them by 2.75 a T^2, noise and rounding do less."""


@njit_in_place
def set_line_jumps(sampler: Sampler) -> bool:
    """Write by how much readings jump in the middle of the samples that are kept.

    False, and none is written, where periods are so uneven that accelerations would look like them.
    """
    time, last, n = sampler.time, HISTORY - 1, sampler.scale.shape[0]
    for i in range(n):
        wait = HISTORY if sampler.filled[i] > 0 else sampler.lines[i].wait - 1.0
        sampler.lines[i].wait = max(wait, 0.0)
    longest, shortest, uneven = 0.0, np.inf, 0.0
    for k in range(1, HISTORY):
        longest = max(longest, time[k] - time[k - 1])
        shortest = min(shortest, time[k] - time[k - 1])
    if sampler.state[0].count < HISTORY or longest > LATE * shortest:
        return False
    for j in range(AFTER):  # time by which the stamps differ from even ones, as weighed
        uneven += _WEIGHTS[j] * (time[AFTER + j] - time[AFTER - 1 - j])
    for i in range(n):
        reading = sampler.samples[:, 0, i]
        jump = -uneven * (reading[last] - reading[0]) / (time[last] - time[0])
        for j in range(AFTER):
            jump += _WEIGHTS[j] * (reading[AFTER + j] - reading[AFTER - 1 - j])
        sampler.lines[i].jump = jump
    return True


@njit_in_place
def learn_line_scale(sampler: Sampler, i: int) -> None:
    """Learn what is usual from the last jump between lines; one of filled readings tells little."""
    if sampler.lines[i].wait == 0.0:
        scale, jump = sampler.lines[i].scale, sampler.lines[i].jump
        sampler.lines[i].scale = learned_scale(scale, jump, 1.0)


@njit_in_place
def is_step_between_lines(sampler: Sampler, i: int) -> bool:
    """Whether a reading from which its rate is derived stepped in the middle of the samples.

    It is looked for where the noise of e hides jumps, while stamps are right.  What a rate
    that changes at once, within one period, does not explain is beyond chance; most of it shows in
    e, lines leave little of it, and no other reading jumps.
    """
    jump, least = abs(sampler.lines[i].jump), least_jump(sampler, i)
    chance = sampler.lines[i].limit * _usual(sampler, i)
    if sampler.derived[i] == 0.0 or sampler.lines[i].wait > 0.0:
        return False
    if sampler.state[0].stamps == 1.0 or smallest_jump(sampler, i) <= least:
        return False
    if not (jump > least and jump > chance):
        return False
    for k in range(HISTORY - 1):
        if sampler.doubtful[k, i] > 0:
            return False
    e = sampler.jumps[AFTER, i] * np.sign(sampler.lines[i].jump)
    if e <= MOST * max(jump, USUAL_JUMP * sampler.usual[i]):
        return False
    (before, rest), (after, left) = _line(sampler, i, 0), _line(sampler, i, AFTER)
    stop = MOST * (sampler.time[AFTER] - sampler.time[AFTER - 1]) * abs(after - before)
    return jump > max(stop + chance, max(rest, left) / LEFT) and not _is_shared(sampler, i)


@njit_in_place
def _usual(sampler: Sampler, i: int) -> float:
    """How far a reading jumps between lines usually, more in fast motion, by stamps [rad].

    Errors of stamps are in the scale, too: what is learned of them may be noise of readings.
    """
    return float(sampler.lines[i].scale * sampler.usual[i] / sampler.scale[i])


@njit_in_place
def _line(sampler: Sampler, i: int, first: int) -> tuple[float, float]:
    """Slope of the line through four readings [rad/s], and how far from it one is at most [rad]."""
    time, reading, samples = sampler.time, sampler.samples[:, 0, i], range(first, first + AFTER)
    middle, mean, way, square, rest = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in samples:
        middle, mean = middle + time[k] / AFTER, mean + reading[k] / AFTER
    for k in samples:
        way += (time[k] - middle) * (reading[k] - mean)
        square += (time[k] - middle) ** 2
    slope = way / square
    for k in samples:
        rest = max(rest, abs(reading[k] - mean - slope * (time[k] - middle)))
    return slope, rest


@njit_in_place
def _is_shared(sampler: Sampler, i: int) -> bool:
    """Whether another reading jumps as well, as they do by wrong stamps."""
    for j in range(sampler.scale.shape[0]):
        if j != i and abs(sampler.lines[j].jump) > USUAL_JUMP * _usual(sampler, j):
            return True
    return False
