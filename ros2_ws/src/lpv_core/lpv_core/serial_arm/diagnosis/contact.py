"""Torques from outside: what they explain of the last balances, whatever their course.

On each joint acts a torque of unknown amplitude, a Gaussian process in time; its courses are rough
(as of impacts), smooth, or constant, and joints that need none have none.  Amplitudes and kind of
course are those that explain most, less the logarithm of their number.  The kernel's leading
eigenfunctions are columns like those of a fault, so that what the arm's unknowns could explain
as well is taken off.
"""

from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.serial_arm.diagnosis.estimator import Posterior, set_residuals
from lpv_core.serial_arm.diagnosis.information import Window, factorise, slot, whiten
from lpv_core.support.jit import njit

ROUGH_TIME = 0.3
"""Over which rough torques are correlated [s]."""
AMPLITUDES = (1.0, 0.3, 0.1, 0.03)
"""Amplitudes of torques from outside that are tried, in the largest plausible one."""
ROUGH_PENALTY = 1.4
"""Logarithm of the number of amplitudes."""
SMOOTH_PENALTY = 2.5
"""Logarithm of the number of amplitudes and courses."""
SMOOTH_TIMES = (1e3, 1.0, 0.5)
"""Correlation times of the smooth courses [s]; the first one is constant."""
HORIZON_TIME = 2.0
"""The same for a torque over the whole horizon [s]."""
_MODES = 8
_HORIZON_MODES = 12
_NEGLIGIBLE = 1e-4
"""Share of the largest eigenvalue below which an eigenfunction is left out."""


class Contact(NamedTuple):
    """Models of torques from outside, for W windows.

    Attributes
    ----------
    lengths : ndarray of int64, shape (W,)
        Of the windows [balances].
    torque : ndarray, shape (n,)
        Largest plausible torques [N m].
    variance : ndarray, shape (n,)
        Of balances [N2 m2 s2], for which ``shares`` and ``costs`` hold.
    known : ndarray of int64, shape (W,)
        Whether they do.
    values, vectors : ndarray, shapes (W, L) and (W, L, L)
        Of the correlation of rough torques.
    shares, costs : ndarray, shapes (W, K, n, L) and (W, K, n)
        Factors of squared residuals along eigenvectors, and what the freedom of K amplitudes costs.
    smooth, horizon : ndarray, shapes (3, L, M) and (capacity, M')
        Impulses of smooth torques of variance 1 along eigenfunctions, newest first [s].
    along : ndarray, shape (L,)
        Scratch.
    """

    lengths: IntArray
    torque: FloatArray
    variance: FloatArray
    known: IntArray
    values: FloatArray
    vectors: FloatArray
    shares: FloatArray
    costs: FloatArray
    smooth: FloatArray
    horizon: FloatArray
    along: FloatArray


def new_contact(lengths: list[int], torque: FloatArray, interval: float, capacity: int) -> Contact:
    """Models of torques from outside.

    Parameters
    ----------
    lengths : list of int
        Of the windows [balances].
    torque : ndarray, shape (n,)
        Largest plausible torques [N m].
    interval : float
        Between balances [s].
    capacity : int
        Balances of the horizon.

    Returns
    -------
    Contact
        For any noise.
    """
    count, longest, n = len(lengths), max(lengths), len(torque)
    values, vectors = np.zeros((count, longest)), np.zeros((count, longest, longest))
    for w, length in enumerate(lengths):
        distance = _distances(length, interval) / ROUGH_TIME
        values[w, :length], vectors[w, :length, :length] = np.linalg.eigh(np.exp(-distance))
    smooth = np.array([_courses(longest, interval, one, _MODES) for one in SMOOTH_TIMES])
    shares = len(AMPLITUDES)
    return Contact(
        np.array(lengths), torque, np.zeros(n), np.zeros(count, np.int64),
        values * interval**2, vectors, np.zeros((count, shares, n, longest)),
        np.zeros((count, shares, n)), smooth,
        _courses(capacity, interval, HORIZON_TIME, _HORIZON_MODES), np.zeros(longest))  # fmt: skip


def _distances(count: int, interval: float) -> FloatArray:
    place = interval * np.arange(count)
    return np.abs(place - place[:, None])


def _courses(count: int, interval: float, time: float, modes: int) -> FloatArray:
    """Leading eigenfunctions of a Gaussian kernel; those that are negligible are zero."""
    kernel = np.exp(-0.5 * (_distances(count, interval) / time) ** 2)
    values, vectors = (part[..., ::-1][..., :modes] for part in np.linalg.eigh(kernel))
    kept = np.where(values > _NEGLIGIBLE * values[0], values, 0.0)
    courses = np.zeros((count, modes))
    courses[:, : len(kept)] = interval * vectors * np.sqrt(kept)
    return courses


@njit
def watch_noise(contact: Contact, null: Posterior) -> None:
    """Forget what depends on the noise, where that has changed."""
    for i in range(null.noise.shape[0]):
        variance = null.noise[i] * null.noise[i] * null.inflation[i]
        if contact.variance[i] != variance:
            contact.variance[i] = variance
            contact.known[:] = 0


@njit
def weigh_outliers(null: Posterior, last: int) -> None:
    """Shrink large residuals as the weights of least squares do (soft L1).

    A torque from outside must not gain from outliers what the faults' columns do not.
    """
    for back in range(last):
        for i in range(null.noise.shape[0]):
            ratio = null.residual[back, i] / (3.0 * null.noise[i])
            null.residual[back, i] /= (1.0 + ratio * ratio) ** 0.25


@njit
def rough_contact(contact: Contact, null: Posterior, w: int, oldest: int) -> float:
    """Ratio of marginal likelihoods of rough torques, for all windows in any case.

    With the eigenvalues l_k of the correlation and z_k the residuals along its eigenvectors,
    sum_k [g z_k^2 / s^2 - log(1 + a^2 l_k / s^2)] / 2, g = a^2 l / (s^2 + a^2 l).  The arm's
    unknowns are held.

    Parameters
    ----------
    contact : Contact
        Its scratch is changed.
    null : Posterior
        With residuals.
    w : int
        Index of the window's length.
    oldest : int
        Balances before the last one at which the window begins.

    Returns
    -------
    float
        Its logarithm.
    """
    if contact.known[w] == 0:
        _set_shares(contact, w)
    total, length, along = 0.0, contact.lengths[w], contact.along
    for i in range(contact.torque.shape[0]):
        along[:length] = 0.0
        for j in range(length):
            residual, vector = null.residual[oldest - j, i], contact.vectors[w, j]
            for k in range(length):
                along[k] += residual * vector[k]
        for k in range(length):
            along[k] *= along[k]
        best = 0.0
        for c in range(contact.costs.shape[1]):
            ratio, shares = -contact.costs[w, c, i], contact.shares[w, c, i]
            for k in range(length):
                ratio += shares[k] * along[k]
            best = max(best, ratio)
        total += best
    return total


@njit
def _set_shares(contact: Contact, w: int) -> None:
    """Write what `rough_contact` needs for a window at the present noise."""
    for i in range(contact.torque.shape[0]):
        variance = contact.variance[i]
        for c in range(len(AMPLITUDES)):
            amplitude = AMPLITUDES[c] * contact.torque[i]
            cost = ROUGH_PENALTY
            for k in range(contact.lengths[w]):
                signal = contact.values[w, k] * amplitude * amplitude / variance
                contact.shares[w, c, i, k] = 0.5 * signal / ((1.0 + signal) * variance)
                cost += 0.5 * np.log1p(signal)
            contact.costs[w, c, i] = cost
    contact.known[w] = 1


@njit
def smooth_contact(
    courses: FloatArray, torque: FloatArray, window: Window, null: Posterior, last: int
) -> float:
    """Ratio of marginal likelihoods of torques along some courses, in the last balances.

    Parameters
    ----------
    courses : ndarray, shape (L, M)
        Impulses, newest first [s].
    torque : ndarray, shape (n,)
        Largest plausible torques [N m].
    window : Window
        Balances.
    null : Posterior
        The null hypothesis, whose unknowns are free; its residuals are written.
    last : int
        Number of balances.

    Returns
    -------
    float
        Its logarithm; 0 where no joint needs a torque.
    """
    set_residuals(window, null, last)
    n, modes = torque.shape[0], courses.shape[1]
    score, information = _contact_columns(courses, window, null, last)
    amplitude, single = np.zeros(n), np.zeros(n)
    for i in range(n):
        best = 0.0
        for share in AMPLITUDES:
            single[i] = share * torque[i]
            gain = _free_torques(score, information, single, modes)
            if gain > best:
                best, amplitude[i] = gain, single[i]
        single[i] = 0.0
    best = _free_torques(score, information, amplitude, modes)
    for i in range(n):
        kept = amplitude[i]
        amplitude[i] = 0.0
        gain = _free_torques(score, information, amplitude, modes)
        if gain > best:
            best = gain
        else:
            amplitude[i] = kept
    return best


@njit
def _contact_columns(
    courses: FloatArray, window: Window, null: Posterior, last: int
) -> tuple[FloatArray, FloatArray]:
    """Score and information of unit torques, all joints; the arm's unknowns are eliminated."""
    n, m, modes = null.sigma.shape[0], null.mean.shape[0], courses.shape[1]
    score, cross = np.zeros(n * modes), np.zeros((n * modes, m))
    information = np.zeros((n * modes, n * modes))
    for back in range(last):
        at, course = slot(window, back), courses[back]
        for i in range(n):
            unknowns, weight = window.rows[at, i, window.rows.shape[2] - m :], window.weights[at, i]
            for k in range(modes):
                factor, column = weight * course[k], i * modes + k
                score[column] -= factor * null.residual[back, i]
                for a in range(m):
                    cross[column, a] += factor * unknowns[a]
                for j in range(modes):
                    information[column, i * modes + j] += factor * course[j]
    whitened = cross.T.copy()
    whiten(null.factor, whitened)
    for a in range(m):
        for c in range(n * modes):
            share = whitened[a, c]
            for d in range(n * modes):
                information[c, d] -= share * whitened[a, d]
    return score, information


@njit
def _free_torques(
    score: FloatArray, information: FloatArray, amplitude: FloatArray, modes: int
) -> float:
    """Logarithm of the ratio of marginal likelihoods for given amplitudes; 0 without any."""
    joints = np.nonzero(amplitude)[0]
    size = len(joints) * modes
    matrix, right = np.empty((size, size)), np.empty((size, 1))
    for r in range(size):
        i, row = joints[r // modes], joints[r // modes] * modes + r % modes
        right[r, 0] = amplitude[i] * score[row]
        for c in range(size):
            j = joints[c // modes]
            entry = information[row, j * modes + c % modes]
            matrix[r, c] = amplitude[i] * amplitude[j] * entry
        matrix[r, r] += 1.0
    factorise(matrix, np.full(size, 1e-3))
    whiten(matrix, right)
    gain = -SMOOTH_PENALTY * len(joints)
    for r in range(size):
        gain += 0.5 * right[r, 0] * right[r, 0] - np.log(matrix[r, r])
    return gain
