"""A reading that rests while its joint moves: rates that walk at random explain the balances."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.balance import OFFSET, RATE
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator, Posterior, set_residuals
from lpv.core.serial_arm.diagnosis.information import ROBUST, last_rows, slot, whiten

ACCELERATION = 10.0
"""Usual acceleration of a joint whose reading rests [rad/s2]."""


def stuck_bayes_factor(
    estimator: OffsetEstimator, joint: int, balances: int, speed: float
) -> tuple[float, float, float, float]:
    """Logarithm of the Bayes factor of a joint that moves at a rate that walks at random.

    log det(S I + 1) / 2 is taken off for the freedom of the rates.

    Parameters
    ----------
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    joint : int
        Sensor whose reading rests.
    balances : int
        For how many of the last balances it may have moved.
    speed : float
        Usual rate to begin with [rad/s].

    Returns
    -------
    tuple of float
        The logarithm; the way that the joint has gone since, and its standard deviation [rad];
        when it began to move [s].
    """
    n, null, step = estimator.joints, estimator.posterior, estimator.plan.interval
    count = min(balances, len(estimator))
    rows = last_rows(estimator.window, count)
    set_residuals(estimator.window, null, count)
    residual = null.residual[:count][::-1]
    size = _usual_sizes(estimator, count)
    moved = np.nonzero(estimator.balance.to_joints[:, joint])[0]
    at_rest = size[:, moved].copy()
    size[:, moved] = null.noise[moved]  # if the reading lies, joints move
    weights = _weights(residual, size, null)
    columns = _rate_steps(rows, 1 + OFFSET * n + joint, 1 + RATE * n + joint, step)
    score = -np.einsum('kij,ki,ki->j', columns, weights, residual)
    unknowns = rows[..., rows.shape[2] - len(null.mean) :]
    cross = np.einsum('kix,ki,kij->xj', unknowns, weights, columns)
    whiten(null.factor, cross)
    information = np.einsum('kia,ki,kib->ab', columns, weights, columns) - cross.T @ cross
    place = np.arange(1.0, count + 1.0)
    walk = (ACCELERATION * step) ** 2 * np.minimum(place, place[:, None]) + speed**2
    scaled = walk @ information + np.eye(count)
    rates = np.linalg.solve(scaled, walk @ score)
    gain = 0.5 * (score @ rates - np.linalg.slogdet(scaled)[1])
    gain += _rest_instead(residual[:, moved], at_rest, weights[:, moved], null, moved)
    begin = estimator.times(count)[0] - step
    sigma = step * np.sqrt(max(float(np.linalg.solve(scaled, walk).sum()), 0.0))
    return float(gain), float(step * rates.sum()), float(sigma), float(begin)


def _weights(residual: FloatArray, size: FloatArray, null: Posterior) -> FloatArray:
    """Inverse variances of balances, outliers with less weight; shape (last, n)."""
    variance = size**2 * null.inflation
    return np.asarray(1.0 / (variance * np.sqrt(1.0 + (residual / (ROBUST * size)) ** 2)))


def _rest_instead(
    residual: FloatArray, size: FloatArray, weights: FloatArray, null: Posterior, joints: IntArray
) -> float:
    """Change of the log-likelihood ratio where joints rest as the reading says.

    Its friction explains more then than in motion; at most what was counted against it.
    """
    resting = 1.0 / (size**2 * null.inflation[joints])
    resting /= np.sqrt(1.0 + (residual / (ROBUST * size)) ** 2)
    change = (
        0.5 * (residual**2 * (resting - weights)).sum() + np.log(size / null.noise[joints]).sum()
    )
    return min(float(change), 0.0)


def _usual_sizes(estimator: OffsetEstimator, last: int) -> FloatArray:
    """Usual sizes of what is left of the last balances, oldest first, shape (last, n) [N m s]."""
    window, null = estimator.window, estimator.posterior
    rest = window.rest[[slot(window, back) for back in range(last - 1, -1, -1)]]
    return np.asarray(null.noise * (1.0 + (null.rest - 1.0) * rest))


def _rate_steps(rows: FloatArray, offset: int, rate: int, step: float) -> FloatArray:
    """Columns of errors of the rate, one for each balance, with the angles that follow from them.

    An error u during balance j is u in its rate and u T in all angles after it, half of that in
    its own.  Shape (count, n, count).
    """
    count = len(rows)
    later = np.tri(count, k=-1) + 0.5 * np.eye(count)
    columns = step * later[:, None, :] * rows[:, :, offset, None]
    for j in range(count):
        columns[j, :, j] += rows[j, :, rate]
    return columns
