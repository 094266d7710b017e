"""Drifts of encoders that begin suddenly: the moment itself is evidence.

Where a rate is derived from its reading, a drift d of encoder i that begins at b seems to add
d M(q) e_i to the momentum at once.  The two balances whose hats hold b show it, with weights 1 - s
and s, where s is the place of b in the interval that they share.  A torque from outside would have
to be an impact along a column of the mass matrix, and to act as a drift does from then on.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import COULOMB as DRY
from lpv.core.serial_arm.chain import VISCOUS as WET
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.balance import (
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
from lpv.core.serial_arm.diagnosis.contact import Contact, rough_contact, weigh_residuals
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator, Posterior, set_residuals
from lpv.core.serial_arm.diagnosis.information import Window, recent

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


NO_ONSET = Onset(-np.inf, 0.0, 0.0, 0.0, 0)


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
    estimator: OffsetEstimator,
    joint: int,
    prior: float,
    free: FloatArray,
    blocks: FloatArray,
    mass: FloatArray,
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
    mass : ndarray, shape (capacity, n, n)
        M S^-1 of each balance, in the ring of the horizon.

    Returns
    -------
    Onset
        Its gain is -inf while there are too few balances.
    """
    newest, n, plan = blocks[-1], estimator.joints, estimator.plan
    end = float(newest[3 * n] + 0.5 * newest[3 * n + 1])
    best = sudden_drift(estimator, joint, end, prior, free, mass[:, :, joint])
    needed = (best.back + 2) * plan.blocks
    if best.gain == -np.inf or needed > len(blocks):
        return best
    effect = joint, prior, float(free[best.back])
    return with_true_effect(best, estimator, effect, blocks[-needed:])


def sudden_drift(
    estimator: OffsetEstimator,
    joint: int,
    end: float,
    prior: float,
    free: FloatArray,
    mass: FloatArray,
) -> Onset:
    """The best onset of a drift of one encoder in the last balances, to first order.

    All onsets count as equally likely; what that costs belongs to the margin of a decision.

    Parameters
    ----------
    estimator, joint, prior, free
        As of `sudden_drift_of`.
    end : float
        Of the last balance [s].
    mass : ndarray, shape (capacity, n)
        Momentum by a unit rate of the encoder's reading, in the ring of the horizon.
    """
    window, null = estimator.window, estimator.posterior
    n, last, interval = estimator.joints, len(free), estimator.plan.interval
    back = np.arange(SHORTEST, last - 1)
    if len(back) == 0:
        return NO_ONSET
    set_residuals(window, null, last)
    at, left = recent(window, last), null.residual[:last]
    rows, weights = window.rows[at], window.weights[at]
    columns = rows[:, :, [1 + DRIFT * n + joint, 1 + OFFSET * n + joint]]
    unknowns, weighted = rows[:, :, -len(null.mean) :], weights[:, :, None] * columns
    # Sums over the balances behind each onset, for the columns of drift and of offset.
    score = np.cumsum((weighted * left[:, :, None]).sum(1), 0)[back - 1]
    squares = np.cumsum(np.einsum('kip,kiq->kpq', weighted, columns), 0)[back - 1]
    cross = np.cumsum(np.einsum('kip,kim->kpm', weighted, unknowns), 0)[back - 1]
    mass = mass[at[back]]

    def straddle(held: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """M^T W r, M^T W M and M^T W J of balances whose hats hold the onset."""
        pulled = weights[held] * mass
        by_unknowns = np.einsum('ki,kim->km', pulled, unknowns[held])
        return (pulled * left[held]).sum(1), (pulled * mass).sum(1), by_unknowns

    older, newer = straddle(back), straddle(back - 1)
    overlap = np.einsum('ki,kip->kp', mass, weighted[back - 1])
    late = window.times[at[0]] - end  # samples wait for a test of jumps
    # Axes: onset's balance, place in its interval.
    s, begin = np.array(PLACES), window.times[at[back], None] - late - interval
    begin = begin + s * interval
    shift = begin - estimator.balance.clock[EPOCH]
    total = score[:, :1] - shift * score[:, 1:]
    total = total - (1.0 - s) * older[0][:, None] - s * newer[0][:, None]
    square = squares[:, 0, :1] - shift * (2.0 * squares[:, 0, 1:] - shift * squares[:, 1, 1:])
    square += (1.0 - s) ** 2 * older[1][:, None] + s**2 * newer[1][:, None]
    square -= 2.0 * s * (overlap[:, :1] - shift * overlap[:, 1:])
    own = cross[:, None, 0] - shift[:, :, None] * cross[:, None, 1]
    own -= (1.0 - s)[:, None] * older[2][:, None] + s[:, None] * newer[2][:, None]
    square -= (_whitened(null, own) ** 2).sum(-1)
    power = np.maximum(square, 0.0) + prior**-2
    gain = 0.5 * (total**2 / power - np.log(power * prior**2)) - free[back, None]
    k, place = np.unravel_index(np.argmax(np.where(np.isfinite(gain), gain, -np.inf)), gain.shape)
    if not np.isfinite(gain[k, place]):
        return NO_ONSET
    size, sigma = -total[k, place] / power[k, place], power[k, place] ** -0.5
    return Onset(
        float(gain[k, place]), float(size), float(sigma), float(begin[k, place]), int(back[k])
    )


def _whitened(null: Posterior, rows: FloatArray) -> FloatArray:
    """U^-T of rows of products with the unknowns' columns, shape (..., m)."""
    columns = np.linalg.solve(np.triu(null.factor).T, rows.reshape(-1, rows.shape[-1]).T)
    return np.asarray(columns.T.reshape(rows.shape))


def with_true_effect(
    onset: Onset, estimator: OffsetEstimator, fault: tuple[int, float, float], blocks: FloatArray
) -> Onset:
    """The same onset with the drift's true effect: friction turns over where a joint is slow.

    The column is the difference that the drift makes over its size, at its size.

    Parameters
    ----------
    onset : Onset
        From `sudden_drift`.
    estimator : OffsetEstimator
        As there.
    fault : tuple
        Joint, standard deviation of drifts [rad/s], what is taken off its likelihood.
    blocks : ndarray, shape (N, 3 n + 3)
        Those of the balances that hold the onset, and of all after them, oldest first.

    Returns
    -------
    Onset
        With another gain, size and deviation.
    """
    joint, prior, free = fault
    balance, null, per_interval = estimator.balance, estimator.posterior, estimator.plan.blocks
    friction, blocks = _learned_friction(balance, null), np.ascontiguousarray(blocks)
    plain = residuals(balance, blocks, per_interval, friction)
    set_residuals(estimator.window, null, len(plain))
    size, power, gain = onset.size, 1.0, -np.inf
    for _ in range(3):
        size = np.copysign(max(abs(size), _SMALLEST), size)
        freed = _without_drift(blocks, balance, joint, onset.begin, size)
        column = (residuals(balance, freed, per_interval, friction) - plain) / size
        score, square = _project(estimator.window, null, column)
        power = square + prior**-2
        size = score / power
        gain = 0.5 * (score * score / power - np.log(power * prior * prior)) - free
    return Onset(float(gain), float(size), float(power**-0.5), onset.begin, onset.back)


def _learned_friction(balance: Balance, null: Posterior) -> FloatArray:
    """Friction of the chain with what the null hypothesis has learned of it."""
    n, friction = len(balance.reference), balance.chain.friction.copy()
    for group, column, part in ((VISCOUS, WET, VISCOUS_PART), (COULOMB, DRY, COULOMB_PART)):
        friction[:, column] += null.mean[(group - OFFSET) * n :][:n]
        friction[:, column] += null.mean[4 * n :] @ balance.drives[:, :, part]
    return friction


def _without_drift(
    blocks: FloatArray, balance: Balance, joint: int, begin: float, size: float
) -> FloatArray:
    """Blocks whose reading, and the rate that is derived from it, are freed of a drift."""
    n, freed = len(balance.reference), blocks.copy()
    middle, length = blocks[:, 3 * n], blocks[:, 3 * n + 1]
    after = np.clip(middle + 0.5 * length - begin, 0.0, length)
    share = after / length
    freed[:, joint] -= size * np.maximum(middle - begin, 0.5 * after) * share
    freed[:, n + joint] -= balance.derived[joint] * size * share
    return freed


def _project(window: Window, null: Posterior, column: FloatArray) -> tuple[float, float]:
    """Score and information of a column, oldest balance first, with the arm's unknowns free."""
    last = len(column)
    at, own = recent(window, last), column[::-1]
    weighted = window.weights[at] * own
    cross = np.einsum('ki,kim->m', weighted, window.rows[at][:, :, -len(null.mean) :])
    square = float((weighted * own).sum() - (_whitened(null, cross) ** 2).sum())
    return -float((weighted * null.residual[:last]).sum()), max(square, 0.0)
