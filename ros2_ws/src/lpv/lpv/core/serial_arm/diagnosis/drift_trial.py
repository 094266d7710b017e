"""Drifts of some sizes with their true effect: friction turns over where a joint is slow.

Balances without the drift of an encoder are compared with those of the null hypothesis.  A drift is
in the reading, and in the rate that is derived from it; in the rate alone, it is a bias of that.
What the arm's unknowns explain, friction of the joints that the encoder tells of among them, is
that of the rates without the drift: a joint that rests has no friction to be learned.

Friction that turns over is as large for a small drift as for a large one, so that trials begin with
the size to first order, and with that by which the joint would rest.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import SLOPE, FloatArray, IntArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import OFFSET, VISCOUS, Balance, add_residual, scratch_of
from lpv.core.serial_arm.diagnosis.hat import close_hat, drop_hat, new_hat, put
from lpv.core.serial_arm.diagnosis.information import Posterior, Window, factorise, recent, whiten
from lpv.core.serial_arm.dynamics.friction import smooth_sign
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place

GAIN, SIZE, SIGMA, BEGIN, BACK, NEXT, PROMISE = range(7)
"""Columns of trials: those of `onset.Onset`, the size to which a Newton step leads [rad/s], and the
gain there, to second order."""
_REFINED = 2
"""Trials that are refined, as many as start from one onset, and Newton steps for the size of a
drift from each of them."""


class Trials(NamedTuple):
    """What trials of a decision share, of N blocks in B intervals, and scratch; oldest first."""

    blocks: FloatArray  # (N, 3 n + 4) as of `Sampler.blocks`
    freed: FloatArray  # (N, 3 n + 4) the same without a drift
    forces: FloatArray  # (N, 2, n) momentum, and force that changes it, of each [N m s], [N m]
    # (2, B - 1, n, 3) changes of residuals, and columns of each joint's friction, for two sizes
    changes: FloatArray
    rows: FloatArray  # (B - 1, n, m) columns of the unknowns
    mixing: FloatArray  # (B - 1, n, n) as of `Window`
    weights: FloatArray  # (B - 1, n) inverse variances of the balances
    residual: FloatArray  # (B - 1, n) under the null hypothesis [N m s]
    information: FloatArray  # (m, m) of that
    least: FloatArray  # (m,) smallest pivots
    matrix: FloatArray  # (m, m) scratch
    sums: FloatArray  # (3, m) scratch


def new_trials(
    window: Window, null: Posterior, blocks: FloatArray, per_interval: int, joints: int
) -> Trials:
    """Trials of drifts in some blocks; ``null`` must hold the residuals."""
    m, count, upper = len(null.mean), len(blocks) // per_interval - 1, np.triu(null.factor)
    at = recent(window, count)[::-1]
    return Trials(
        blocks, np.empty(blocks.shape), np.empty((len(blocks), 2, joints)),
        np.empty((2, count, joints, 3)), window.rows[at][:, :, -m:].copy(), window.mixing[at],
        null.weights[at], null.residual[:count][::-1].copy(), upper.T @ upper, null.least,
        np.empty((m, m)), np.empty((3, m)))  # fmt: skip


def balance_of_trials(balance: Balance, friction: FloatArray) -> Balance:
    """A balance of its own, with some friction as in `Chain`.

    Its columns are the residual, and derivatives by viscous and by Coulomb friction.
    """
    return scratch_of(balance)._replace(
        chain=balance.chain._replace(friction=friction), hat=new_hat(len(friction), 3)
    )


def new_found(onsets: FloatArray) -> FloatArray:
    """Room for what `compare_drifts` finds for these onsets."""
    joints, count, _ = onsets.shape
    return np.empty((joints, 2 * count + _REFINED * _REFINED, PROMISE + 1))


@njit_in_place
def free_of_drift(
    blocks: FloatArray,
    joint: int,
    parts: tuple[float, float],
    begin: float,
    size: float,
    freed: FloatArray,
) -> None:
    """Write blocks whose reading and rate are freed of a drift.

    ``parts`` says how much of it is in the reading and in the rate.
    """
    n = blocks.shape[1] // 3 - 1
    for k in range(blocks.shape[0]):
        for c in range(blocks.shape[1]):
            freed[k, c] = blocks[k, c]
        middle, length = blocks[k, 3 * n], blocks[k, 3 * n + 1]
        after = min(max(middle + 0.5 * length - begin, 0.0), length)
        change = size * after / length
        freed[k, joint] -= parts[0] * change * max(middle - begin, 0.5 * after)
        freed[k, n + joint] -= parts[1] * change


@njit_in_place
def _set_changes(
    own: Balance,
    trials: Trials,
    joint: int,
    parts: tuple[float, float],
    onset: tuple[float, int],
    size: float,
    which: int,
) -> None:
    """Write how residuals change without a drift, and what columns of friction are then.

    ``onset`` is its begin, and the older one of the balances that hold it, from which on
    ``changes[which]`` are written; columns of friction for the first size alone.
    """
    (begin, older), (count, n) = onset, trials.residual.shape
    per_interval, share = trials.blocks.shape[0] // (count + 1), own.to_joints[:, joint]
    first = older * per_interval
    free_of_drift(trials.blocks[first:], joint, parts, begin, size, trials.freed[first:])
    rate, length, own.hat.length[0] = own.vectors[1], 0.0, 0.0
    for k in range(first, trials.blocks.shape[0]):
        block, force = trials.freed[k], trials.forces[k]
        y, v, torque = block[:n], block[n : 2 * n], block[2 * n : 3 * n]
        weight = (block[3 * n + 1], block[3 * n + 2])
        if block[3 * n] + 0.5 * weight[0] > begin:
            add_residual(own, y, v, torque, weight)
            for i in range(n):
                put(own.hat, 0, i, (-force[0, i], -force[1, i]), weight)
        else:  # before the onset nothing is changed
            map_vector(own.to_joints, v, rate)
        for i in range(n):
            if which == 0 and share[i] != 0.0:
                sign = smooth_sign(rate[i], own.chain.friction[i, SLOPE])
                put(own.hat, 1, i, (0.0, -rate[i]), weight)
                put(own.hat, 2, i, (0.0, -sign), weight)
        length += weight[0]
        if (k + 1) % per_interval == 0:
            if close_hat(own.hat, length):
                at = (k + 1) // per_interval - 2
                change, mixing = trials.changes[which, at], trials.mixing[at]
                for i in range(n):
                    change[i, 0] = 0.0
                    for j in range(i + 1):
                        change[i, 0] += mixing[i, j] * own.hat.rows[j, 0]
                    for c in range(1, 3):
                        change[i, c] = own.hat.rows[i, c]
            length = 0.0


@njit_in_place
def _compare(
    trials: Trials, factor: FloatArray, share: FloatArray, older: int,
    about: tuple[float, float, float, float], trial: FloatArray,
) -> None:  # fmt: skip
    """Compare a drift of one size with none; its gain is -inf where it is no number.

    ``share``, shape (n,), are the joints' shares in the encoder's error; ``about`` are size,
    change of size of the second changes, and mean and standard deviation of sizes beforehand.
    """
    size, step, usual, prior = about
    (count, n), m = trials.residual.shape, trials.least.shape[0]
    matrix, score, by_size, moved = trials.matrix, trials.sums[0], trials.sums[1], trials.sums[2]
    for a in range(m):
        score[a] = by_size[a] = 0.0
        for b in range(m):
            matrix[a, b] = trials.information[a, b]
    fit, slope, curvature = 0.0, 0.0, 0.0
    for k in range(older, count):
        for i in range(n):
            row, weight, change = trials.rows[k, i], trials.weights[k, i], trials.changes[0, k, i]
            plain, left = trials.residual[k, i], trials.residual[k, i] + change[0]
            turn = (trials.changes[1, k, i, 0] - change[0]) / step
            fit -= weight * change[0] * (plain + left)
            slope -= weight * turn * left
            curvature += weight * turn * turn
            for a in range(m):
                score[a] -= weight * change[0] * row[a]
                by_size[a] += weight * turn * row[a]
                moved[a] = row[a]
            # Of the unknowns' columns, a drift changes those of the friction of joints that move.
            changes = False
            for j in range(i + 1):
                if share[j] == 0.0:
                    continue
                changes, part = True, trials.mixing[k, i, j]
                for g in range(2):
                    c = (VISCOUS - OFFSET + g) * n + j
                    moved[c] += part * (trials.changes[0, k, j, 1 + g] - trials.rows[k, j, c])
                    score[c] -= weight * left * (moved[c] - row[c])
                    by_size[c] += weight * turn * (moved[c] - row[c])
            if not changes:
                continue
            for c in range((VISCOUS - OFFSET) * n, (VISCOUS - OFFSET + 2) * n):
                if share[c % n] != 0.0:
                    for a in range(m):
                        matrix[c, a] += weight * (moved[c] * moved[a] - row[c] * row[a])
    for c in range((VISCOUS - OFFSET) * n, (VISCOUS - OFFSET + 2) * n):
        if share[c % n] != 0.0:
            for a in range(c):
                matrix[a, c] = matrix[c, a]
    factorise(matrix, trials.least)
    whiten(matrix, score.reshape((m, 1)))
    whiten(matrix, by_size.reshape((m, 1)))
    for a in range(m):
        fit += score[a] * score[a] + 2.0 * np.log(factor[a, a] / matrix[a, a])
        slope -= score[a] * by_size[a]
        curvature -= by_size[a] * by_size[a]
    power = max(curvature, 0.0) + 1.0 / (prior * prior)
    gain = 0.5 * (fit - ((size - usual) / prior) ** 2 - np.log(power * prior * prior))
    way = (slope - (size - usual) / (prior * prior)) / power
    trial[GAIN] = gain if np.isfinite(gain + way) else -np.inf
    trial[SIZE], trial[SIGMA] = size, 1.0 / np.sqrt(power)
    trial[NEXT], trial[PROMISE] = size + way, gain + 0.5 * power * way * way


@njit_in_place
def _apparent_rate(blocks: FloatArray, joint: int, begin: float) -> float:
    """Mean rate since the onset, by the readings: that of the drift, if the joint rests."""
    n, total, count = blocks.shape[1] // 3 - 1, 0.0, 0
    for block in blocks:
        if block[3 * n] > begin:
            total += block[n + joint]
            count += 1
    return total / max(count, 1)


@njit_in_place
def _most_promising(trials: FloatArray) -> int:
    """Index of the trial that promises most, which promises nothing from then on; or -1."""
    best, most = -1, 0.0
    for k in range(trials.shape[0]):
        if trials[k, GAIN] > -np.inf and trials[k, PROMISE] > most:
            best, most = k, trials[k, PROMISE]
    if best >= 0:
        trials[best, PROMISE] = -np.inf
    return best


@njit_in_place
def compare_drifts(
    own: Balance, trials: Trials, factor: FloatArray, joints: IntArray, parts: tuple[float, float],
    prior: FloatArray, onsets: FloatArray, found: FloatArray,
) -> None:  # fmt: skip
    """Compare drifts of some joints.

    ``own`` is of `balance_of_trials`, ``factor`` that of the null hypothesis; ``parts`` are as of
    `free_of_drift`, and ``prior``, shape (2, J), has means and standard deviations of sizes
    [rad/s].  ``onsets``, shape (J, K, 5), are the ones that are tried for each joint, with a gain
    of -inf where there are fewer.  Trials are written to ``found``, of `new_found`, with a gain of
    -inf where there is none, or it is no number.
    """
    (count, n), first = trials.residual.shape, 2 * onsets.shape[1]
    for k in range(trials.blocks.shape[0]):
        block = trials.blocks[k]
        drop_hat(own.hat)
        add_residual(own, block[:n], block[n : 2 * n], block[2 * n : 3 * n], (1.0, 0.0))
        for i in range(n):
            trials.forces[k, 0, i] = own.hat.momentum[1, i, 0]
            trials.forces[k, 1, i] = own.hat.falling[i, 0]
    drop_hat(own.hat)
    found[:] = -np.inf
    for j in range(joints.shape[0]):
        joint, every = joints[j], found[j]
        for t in range(every.shape[0]):
            if t < first:
                start = onsets[j, t // 2]
                size = start[SIZE]
                if t % 2 == 1:
                    size = _apparent_rate(trials.blocks, joint, start[BEGIN])
                goes_on = start[GAIN] > -np.inf
            else:  # Newton steps
                at = _most_promising(every[:first]) if (t - first) % _REFINED == 0 else t - 1
                start = every[at]
                size = start[NEXT]
                goes_on = at >= 0 and math.isfinite(size)
            if goes_on:
                trial, older = every[t], count - 1 - int(start[BACK])
                slow = priors.SLOW_RATE * own.scale[joint]
                step = math.copysign(0.1 * max(abs(size), slow), size)
                trial[BEGIN], trial[BACK] = start[BEGIN], start[BACK]
                for k in range(2):
                    onset = start[BEGIN], older
                    _set_changes(own, trials, joint, parts, onset, size + k * step, k)
                about = size, step, prior[0, j], prior[1, j]
                _compare(trials, factor, own.to_joints[:, joint], older, about, trial)
