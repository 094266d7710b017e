"""Drifts of encoders that begin suddenly: the moment itself is evidence.

Where a rate is derived from its reading, a drift d of encoder i that begins at b seems to add
d M(q) e_i to the momentum at once.  The two balances whose hats hold b show it, with weights 1 - s
and s, where s is the place of b in the interval that they share.  A torque from outside would have
to be an impact along a column of the mass matrix, and to act as a drift does from then on.
"""

from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import COULOMB as DRY
from lpv_core.serial_arm.chain import VISCOUS as WET
from lpv_core.serial_arm.chain import FloatArray
from lpv_core.serial_arm.diagnosis.balance import (
    COULOMB,
    COULOMB_PART,
    DRIFT,
    EPOCH,
    OFFSET,
    VISCOUS,
    VISCOUS_PART,
    Balance,
    residuals,
)
from lpv_core.serial_arm.diagnosis.contact import Contact, rough_contact, weigh_residuals
from lpv_core.serial_arm.diagnosis.estimator import OffsetEstimator, Posterior, set_residuals
from lpv_core.serial_arm.diagnosis.information import Window, slot, whiten
from lpv_core.serial_arm.dynamics.momentum import momentum_balance
from lpv_core.support.jit import njit

PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Places of the onset in its interval that are tried."""
SHORTEST = 4
"""Balances after an onset before it is looked at."""
_SMALLEST = 0.01
"""Size of a drift at which its effect is evaluated, at least [rad/s]."""


class Onset(NamedTuple):
    """The onset that explains most, of a drift."""

    gain: float  # logarithm of the ratio of marginal likelihoods, -inf if there is none
    size: float  # of the drift [rad/s]
    sigma: float  # standard deviation of the size [rad/s]
    begin: float  # [s]
    back: int  # the older of the two balances that hold it, counted from the last one


class _Sums(NamedTuple):
    """Sums over the balances behind an onset, for the columns of drift and of offset."""

    score: FloatArray  # A^T W r, shape (2,)
    squares: FloatArray  # A^T W A, shape (2, 2)
    cross: FloatArray  # A^T W J, shape (2, m)


def explained_at_onsets(
    outside: Contact, estimator: OffsetEstimator, onset: int, last: int
) -> FloatArray:
    """What torques from outside at an onset alone explain, by the older balance that holds it.

    Parameters
    ----------
    outside : Contact
        Torques from outside.
    estimator : OffsetEstimator
        Its posterior is the null hypothesis; its residuals are written.
    onset : int
        Index of the onset's length in ``outside``.
    last : int
        Balances that are looked at.

    Returns
    -------
    ndarray, shape (last,)
        Logarithms of Bayes factors.
    """
    null, free = estimator.posterior, np.zeros(last)
    set_residuals(estimator.window, null, last)
    weigh_residuals(estimator.window, null, last)
    for back in range(1, last - 1):
        free[back] = rough_contact(outside, null, onset, back + 1)
    return free


def sudden_drift_of(
    estimator: OffsetEstimator, joint: int, prior: float, free: FloatArray, blocks: FloatArray
) -> Onset:
    """The best onset of a drift of one encoder whose rate is derived from it.

    Parameters
    ----------
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    joint : int
        Of the encoder.
    prior : float
        Standard deviation of drifts [rad/s].
    free : ndarray, shape (last,)
        Of `explained_at_onsets`; it is taken off.
    blocks : ndarray, shape (N, 3 n + 3)
        Those of the balances at hand and of the interval before, oldest first.

    Returns
    -------
    Onset
        Its gain is -inf while there are too few balances.
    """
    window, null, balance = estimator.window, estimator.posterior, estimator.balance
    newest, n, plan = blocks[-1], estimator.joints, estimator.plan
    end = newest[3 * n] + 0.5 * newest[3 * n + 1]
    times = balance.clock[EPOCH], end, plan.interval, prior
    best = sudden_drift(window, null, balance, joint, times, free)
    needed = (best.back + 2) * plan.blocks
    if best.gain == -np.inf or needed > len(blocks):
        return best
    effect = joint, prior, free[best.back]
    return with_true_effect(best, window, null, balance, effect, blocks[-needed:], plan.blocks)


@njit
def sudden_drift(
    window: Window,
    null: Posterior,
    balance: Balance,
    joint: int,
    times: tuple[float, float, float, float],
    free: FloatArray,
) -> Onset:
    """The best onset of a drift of one encoder in the last balances, to first order.

    Parameters
    ----------
    window : Window
        Balances.
    null : Posterior
        The null hypothesis; its residuals are written.
    balance : Balance
        Of the arm; its scratch is changed.
    joint : int
        Of the encoder.
    times : tuple
        Epoch of drifts, end of the last balance and length of an interval [s]; standard deviation
        of drifts [rad/s].
    free : ndarray, shape (last,)
        What torques from outside, at the onset only, would explain of the balances that hold it,
        by the older one; it is taken off.

    Returns
    -------
    Onset
        All onsets count as equally likely; what that costs belongs to the margin of a decision.
    """
    epoch, end, interval, prior = times
    n, m = null.noise.shape[0], null.mean.shape[0]
    set_residuals(window, null, free.shape[0])
    sums = _Sums(np.zeros(2), np.zeros((2, 2)), np.zeros((2, m)))
    mass, near, far = np.zeros(n), np.zeros(m), np.zeros(m)
    columns, cross = np.zeros((2, n)), np.zeros((m, 1))
    late = window.times[slot(window, 0)] - end  # samples wait for a test of jumps
    best = Onset(-np.inf, 0.0, 0.0, 0.0, 0)
    for back in range(1, free.shape[0] - 1):
        _add(sums, columns, window, null, joint, back - 1)
        if back < SHORTEST:
            continue
        at, after = slot(window, back), slot(window, back - 1)
        mass_column(balance, window.poses[at], joint, mass)
        older = _straddle(window, null, mass, back, far)
        newer = _straddle(window, null, mass, back - 1, near)
        overlap = np.zeros(2)
        for i in range(n):
            for part in range(2):
                overlap[part] += window.weights[after, i] * mass[i] * columns[part, i]
        for s in PLACES:
            begin = window.times[at] - late - interval + s * interval
            shift = begin - epoch
            score = sums.score[0] - shift * sums.score[1] - (1.0 - s) * older[0] - s * newer[0]
            square = sums.squares[0, 0] - shift * (
                2.0 * sums.squares[0, 1] - shift * sums.squares[1, 1]
            )
            square += (1.0 - s) ** 2 * older[1] + s**2 * newer[1]
            square -= 2.0 * s * (overlap[0] - shift * overlap[1])
            for a in range(m):
                own = sums.cross[0, a] - shift * sums.cross[1, a]
                cross[a, 0] = own - (1.0 - s) * far[a] - s * near[a]
            whiten(null.factor, cross)
            for a in range(m):
                square -= cross[a, 0] * cross[a, 0]
            power = max(square, 0.0) + prior**-2
            gain = 0.5 * (score * score / power - np.log(power * prior * prior)) - free[back]
            if gain > best.gain:
                best = Onset(gain, -score / power, power**-0.5, begin, back)
    return best


@njit
def _add(
    sums: _Sums, columns: FloatArray, window: Window, null: Posterior, joint: int, back: int
) -> None:
    """Add a balance in which the drift lasts all the time; its columns are written."""
    at, n, m = slot(window, back), columns.shape[1], sums.cross.shape[1]
    first = window.rows.shape[2] - m
    for i in range(n):
        row, weight = window.rows[at, i], window.weights[at, i]
        drift, offset = row[1 + DRIFT * n + joint], row[1 + OFFSET * n + joint]
        columns[0, i], columns[1, i] = drift, offset
        sums.score[0] += weight * drift * null.residual[back, i]
        sums.score[1] += weight * offset * null.residual[back, i]
        sums.squares[0, 0] += weight * drift * drift
        sums.squares[0, 1] += weight * drift * offset
        sums.squares[1, 1] += weight * offset * offset
        for a in range(m):
            sums.cross[0, a] += weight * drift * row[first + a]
            sums.cross[1, a] += weight * offset * row[first + a]


@njit
def _straddle(
    window: Window, null: Posterior, mass: FloatArray, back: int, cross: FloatArray
) -> tuple[float, float]:
    """M^T W r and M^T W M of a balance whose hat holds the onset; M^T W J is written."""
    at, m = slot(window, back), cross.shape[0]
    first = window.rows.shape[2] - m
    score, square = 0.0, 0.0
    cross[:] = 0.0
    for i in range(mass.shape[0]):
        weighted = window.weights[at, i] * mass[i]
        score += weighted * null.residual[back, i]
        square += weighted * mass[i]
        for a in range(m):
            cross[a] += weighted * window.rows[at, i, first + a]
    return score, square


@njit
def mass_column(balance: Balance, pose: FloatArray, joint: int, mass: FloatArray) -> None:
    """Write M(q) S^-1 e_i, the momentum by a unit rate of one reading."""
    rate, force = balance.vectors[7], balance.vectors[8]
    rate[:] = balance.to_joints[:, joint]
    momentum_balance(balance.chain, pose, rate, balance.work, mass, force)


@njit
def with_true_effect(
    onset: Onset,
    window: Window,
    null: Posterior,
    balance: Balance,
    fault: tuple[int, float, float],
    blocks: FloatArray,
    per_interval: int,
) -> Onset:
    """The same onset with the drift's true effect: friction turns over where a joint is slow.

    The column is the difference that the drift makes over its size, at its size.

    Parameters
    ----------
    onset : Onset
        From `sudden_drift`.
    window, null, balance
        As there.
    fault : tuple
        Joint, standard deviation of drifts [rad/s], what is taken off its likelihood.
    blocks : ndarray, shape (N, 3 n + 3)
        Those of the balances that hold the onset, and of all after them, oldest first.
    per_interval : int
        Blocks of an interval.

    Returns
    -------
    Onset
        With another gain, size and deviation.
    """
    joint, prior, free = fault
    friction = _learned_friction(balance, null)
    plain = residuals(balance, blocks, per_interval, friction)
    last = plain.shape[0]
    set_residuals(window, null, last)
    size, power, gain = onset.size, 1.0, -np.inf
    for _ in range(3):
        if abs(size) < _SMALLEST:
            size = _SMALLEST if size >= 0.0 else -_SMALLEST
        freed = _without_drift(blocks, balance, joint, onset.begin, size)
        column = (residuals(balance, freed, per_interval, friction) - plain) / size
        score, square = _project(window, null, column)
        power = square + prior**-2
        size = score / power
        gain = 0.5 * (score * score / power - np.log(power * prior * prior)) - free
    return Onset(gain, size, power**-0.5, onset.begin, onset.back)


@njit
def _learned_friction(balance: Balance, null: Posterior) -> FloatArray:
    """Friction of the chain with what the null hypothesis has learned of it."""
    n, friction = balance.reference.shape[0], balance.chain.friction.copy()
    for i in range(n):
        friction[i, WET] += null.mean[(VISCOUS - OFFSET) * n + i]
        friction[i, DRY] += null.mean[(COULOMB - OFFSET) * n + i]
        for k in range(balance.drives.shape[0]):
            part, share = balance.drives[k, i], null.mean[4 * n + k]
            friction[i, WET] += share * part[VISCOUS_PART]
            friction[i, DRY] += share * part[COULOMB_PART]
    return friction


@njit
def _without_drift(
    blocks: FloatArray, balance: Balance, joint: int, begin: float, size: float
) -> FloatArray:
    """Blocks whose reading, and the rate that is derived from it, are freed of a drift."""
    n, freed = balance.reference.shape[0], blocks.copy()
    for k in range(blocks.shape[0]):
        length = blocks[k, 3 * n + 1]
        after = min(blocks[k, 3 * n] + 0.5 * length - begin, length)
        if after <= 0.0:
            continue
        share = after / length
        mean = max(blocks[k, 3 * n] - begin, 0.5 * after) * share
        freed[k, joint] -= size * mean
        freed[k, n + joint] -= balance.derived[joint] * size * share
    return freed


@njit
def _project(window: Window, null: Posterior, column: FloatArray) -> tuple[float, float]:
    """Score and information of a column, oldest balance first, with the arm's unknowns free."""
    last, n = column.shape
    m = null.mean.shape[0]
    first = window.rows.shape[2] - m
    score, square, cross = 0.0, 0.0, np.zeros((m, 1))
    for back in range(last):
        at, own = slot(window, back), column[last - 1 - back]
        for i in range(n):
            weighted = window.weights[at, i] * own[i]
            score -= weighted * null.residual[back, i]
            square += weighted * own[i]
            for a in range(m):
                cross[a, 0] += weighted * window.rows[at, i, first + a]
    whiten(null.factor, cross)
    for a in range(m):
        square -= cross[a, 0] * cross[a, 0]
    return score, max(square, 0.0)
