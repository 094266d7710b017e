"""Drifts of encoders that begin suddenly: the moment itself is evidence.

Where a rate is derived from its reading, a drift d of encoder i that begins at b seems to add
d M(q) e_i to the momentum at once.  The two balances whose hats hold b show it, with weights 1 - s
and s, where s is the place of b in the interval that they share.  A torque from outside would have
to be an impact along a column of the mass matrix, and to act as a drift does from then on.
"""

from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import FloatArray
from lpv_core.serial_arm.diagnosis.balance import DRIFT, OFFSET, Balance
from lpv_core.serial_arm.diagnosis.estimator import Posterior, set_residuals
from lpv_core.serial_arm.diagnosis.information import Window, slot, whiten
from lpv_core.serial_arm.dynamics.momentum import momentum_balance
from lpv_core.support.jit import njit

PLACES = (0.17, 0.5, 0.83)
"""Places of the onset in its interval that are tried."""
SHORTEST = 4
"""Balances after an onset before it is looked at."""


class Onset(NamedTuple):
    """The onset that explains most, of a drift."""

    gain: float  # logarithm of the ratio of marginal likelihoods, -inf if there is none
    size: float  # of the drift [rad/s]
    sigma: float  # standard deviation of the size [rad/s]
    begin: float  # [s]


class _Sums(NamedTuple):
    """Sums over the balances behind an onset, for the columns of drift and of offset."""

    score: FloatArray  # A^T W r, shape (2,)
    squares: FloatArray  # A^T W A, shape (2, 2)
    cross: FloatArray  # A^T W J, shape (2, m)


@njit
def sudden_drift(
    window: Window,
    null: Posterior,
    balance: Balance,
    joint: int,
    times: tuple[float, float, float],
    free: FloatArray,
) -> Onset:
    """The best onset of a drift of one encoder in the last balances.

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
        Epoch of drifts and length of an interval [s], standard deviation of drifts [rad/s].
    free : ndarray, shape (last,)
        What torques from outside, at the onset only, would explain of the balances that hold it,
        by the older one; it is taken off.

    Returns
    -------
    Onset
        All onsets count as equally likely; what that costs belongs to the margin of a decision.
    """
    epoch, interval, prior = times
    n, m = null.noise.shape[0], null.mean.shape[0]
    set_residuals(window, null, free.shape[0])
    sums = _Sums(np.zeros(2), np.zeros((2, 2)), np.zeros((2, m)))
    mass, near, far = np.zeros(n), np.zeros(m), np.zeros(m)
    columns, cross = np.zeros((2, n)), np.zeros((m, 1))
    best = Onset(-np.inf, 0.0, 0.0, 0.0)
    for back in range(1, free.shape[0] - 1):
        _add(sums, columns, window, null, joint, back - 1)
        if back < SHORTEST:
            continue
        at, after = slot(window, back), slot(window, back - 1)
        _mass_column(balance, window.poses[at], joint, mass)
        older = _straddle(window, null, mass, back, far)
        newer = _straddle(window, null, mass, back - 1, near)
        overlap = np.zeros(2)
        for i in range(n):
            for part in range(2):
                overlap[part] += window.weights[after, i] * mass[i] * columns[part, i]
        for s in PLACES:
            begin = window.times[at] - interval + s * interval
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
                best = Onset(gain, -score / power, power**-0.5, begin)
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
def _mass_column(balance: Balance, pose: FloatArray, joint: int, mass: FloatArray) -> None:
    """Write M(q) e_i, the momentum by a unit rate of one joint."""
    rate, force = balance.vectors[7], balance.vectors[8]
    rate[:] = 0.0
    rate[joint] = 1.0
    momentum_balance(balance.chain, pose, rate, balance.work, mass, force)
