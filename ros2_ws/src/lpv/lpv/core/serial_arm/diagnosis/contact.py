"""Torques from outside: what they explain of the last balances, whatever their course.

A torque of unknown amplitude acts on each joint, or a force on the tip; it is a Gaussian process in
time, rough (as of impacts), smooth, or constant.  What is not needed is zero.  Amplitudes and kind
of course are those that explain most, less the logarithm of their number.  Leading eigenfunctions
of the kernel are columns like those of a fault, so that what the arm's unknowns could explain as
well is taken off.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.information import (
    ROBUST,
    Posterior,
    Window,
    factorise,
    recent,
    slot,
    whiten,
)
from lpv.core.serial_arm.diagnosis.onset import whitened
from lpv.core.serial_arm.diagnosis.parameter_error import NEGLIGIBLE
from lpv.core.serial_arm.diagnosis.row_noise import usual_size
from lpv.core.serial_arm.dynamics.kinematics import fill_jacobian, joint_frames
from lpv.core.support.jit import njit, njit_in_place

ROUGH_PENALTY = math.log(len(priors.AMPLITUDES))
"""What it costs to choose the amplitude that explains most."""
SMOOTH_PENALTY = math.log(len(priors.AMPLITUDES) * len(priors.SMOOTH_TIMES))
"""The same for amplitude and course."""


class Contact(NamedTuple):
    """Models of torques from outside, for windows of up to L balances."""

    torque: FloatArray  # largest plausible torques, shape (n,) [N m]
    variance: FloatArray  # (n,) of balances for which `filters` and `costs` hold [N2 m2 s2]
    decay: float  # correlation of rough torques in neighbouring balances
    # (K, n, L, 2) of the filter of K amplitudes: factor of an innovation in the next prediction, of
    # its square in the logarithm of the likelihood [1/(N2 m2 s2)]
    filters: FloatArray
    costs: FloatArray  # (K, n, L) what the freedom of K amplitudes costs in so many balances
    # (L, M) time profiles of unit variance along eigenfunctions, as impulses, newest first [s]
    smooth: tuple[FloatArray, ...]
    # (capacity, M') the same, for all of the horizon: torques that change, and constant ones [s]
    horizon: tuple[FloatArray, FloatArray]
    interval: float  # [s]
    rough: FloatArray  # (L,) what `rough_contact` found
    best: FloatArray  # scratch, shape (L,)


def new_contact(longest: int, torque: FloatArray, interval: float, capacity: int) -> Contact:
    """Models of torques from outside, for any noise.

    ``longest`` is the length of the longest window [balances]; ``torque``, shape (n,), has the
    largest plausible torques [N m].  Balances are ``interval`` apart [s]; the horizon holds
    ``capacity`` of them.
    """
    smooth = tuple(_courses(longest, interval, one) for one in priors.SMOOTH_TIMES)
    changing = _courses(capacity, interval, priors.HORIZON_TIME)
    constant = _courses(capacity, interval, priors.SMOOTH_TIMES[0])
    shape = len(priors.AMPLITUDES), len(torque), longest
    return Contact(
        torque, np.zeros(len(torque)), math.exp(-interval / priors.STEADY_FOR),
        np.zeros((*shape, 2)), np.zeros(shape), smooth, (changing, constant), interval,
        *np.zeros((2, longest)),
    )  # fmt: skip


@lru_cache(maxsize=16)
def _courses(count: int, interval: float, time: float) -> FloatArray:
    """Leading eigenfunctions of a Gaussian kernel whose variance is not negligible."""
    place = interval * np.arange(count)
    kernel = np.exp(-0.5 * ((place - place[:, None]) / time) ** 2)
    values, vectors = (part[..., ::-1] for part in np.linalg.eigh(kernel))
    kept = values > NEGLIGIBLE * values[0]
    return np.ascontiguousarray(interval * vectors[:, kept] * np.sqrt(values[kept]))


@njit_in_place
def watch_noise(contact: Contact, null: Posterior) -> None:
    """Write what depends on the noise, where that has changed."""
    for i in range(null.noise.shape[0]):
        variance = null.noise[i] * null.noise[i] * null.inflation[i]
        if contact.variance[i] != variance:
            contact.variance[i] = variance
            _set_filters(contact, i)


@njit_in_place
def weigh_residuals(window: Window, null: Posterior, last: int) -> None:
    """Scale residuals as the weights of least squares do: joints at rest, outliers (soft L1).

    A torque from outside must not gain from them what the faults' columns do not, but for stamps
    that were wrong: these are inferred from readings, and a torque may be what they seem to be.
    """
    for back in range(last):
        for i in range(null.noise.shape[0]):
            size = usual_size(window, null, back, i)
            ratio = null.residual[back, i] / (ROBUST * size)
            size = np.sqrt(size * size + window.extra[slot(window, back), i])
            null.residual[back, i] *= null.noise[i] / (size * np.sqrt(np.sqrt(1.0 + ratio * ratio)))


@njit_in_place
def rough_contact(contact: Contact, null: Posterior, newest: int, count: int) -> float:
    """Log ratio of marginal likelihoods of rough torques in so many balances.

    ``newest`` balances came after them.  Rough torques are a Markov process, in either direction of
    time: with the residuals z_k, less what those of the balances after it predict, of variance S_k,
    sum_k [r_k^2 / s^2 - z_k^2 / S_k - log(S_k / s^2)] / 2.  The arm's unknowns are held.

    Those of fewer balances are written into ``rough``, by the oldest one.  ``null`` must hold the
    residuals.
    """
    rough, best = contact.rough, contact.best
    rough[:count] = 0.0
    for i in range(contact.torque.shape[0]):
        best[:count] = 0.0
        alone = 0.5 / contact.variance[i]
        for c in range(contact.costs.shape[0]):
            ratio, predicted, filters = 0.0, 0.0, contact.filters[c, i]
            for k in range(count):
                residual = null.residual[newest + k, i]
                left = residual - predicted
                ratio += alone * residual * residual - filters[k, 1] * left * left
                predicted = contact.decay * predicted + filters[k, 0] * left
                best[k] = max(best[k], ratio - contact.costs[c, i, k])
        for k in range(count):
            rough[k] += best[k]
    return float(rough[count - 1])


@njit_in_place
def rough_contacts(contact: Contact, null: Posterior, count: int, gains: FloatArray) -> None:
    """Write those of ``count`` balances that begin so many before the last one, shape (L,).

    The first ones, of windows that would end later, are not written.
    """
    for oldest in range(count - 1, gains.shape[0]):
        gains[oldest] = rough_contact(contact, null, oldest - count + 1, count)


@njit_in_place
def _set_filters(contact: Contact, i: int) -> None:
    """Write what `rough_contact` needs for a joint at the present noise."""
    variance, kept, longest = contact.variance[i], contact.decay**2, contact.best.shape[0]
    for c in range(contact.costs.shape[0]):
        torque = priors.AMPLITUDES[c] * contact.torque[i] * contact.interval
        usual = power = torque * torque
        before = gain = share = step = 0.0
        cost = ROUGH_PENALTY
        for k in range(longest):
            if power != before:  # it soon stays the same
                before, total = power, power + variance
                gain, share = contact.decay * power / total, 0.5 / total
                step = 0.5 * np.log1p(power / variance)
                power = usual + kept * (power * variance / total - usual)
            cost += step
            contact.filters[c, i, k, 0], contact.filters[c, i, k, 1] = gain, share
            contact.costs[c, i, k] = cost


def joint_levers(torque: FloatArray, last: int) -> FloatArray:
    """Largest plausible torque of each joint alone, shape (last, n, n) [N m]."""
    return np.repeat(np.diag(torque)[None], last, axis=0)


@njit
def tip_jacobians(chain: Chain, window: Window, last: int) -> FloatArray:
    """Torques by a unit force on the tip along x, y and z of the base, newest balance first.

    Shape (last, 3, n) [N m/N].
    """
    n = window.poses.shape[1]
    tips, jacobian = np.zeros((last, 3, n)), np.zeros((6, n))
    rotations, origins = np.zeros((n + 1, 3, 3)), np.zeros((n + 1, 3))
    for back in range(last):
        joint_frames(chain, window.poses[slot(window, back)], rotations, origins)
        fill_jacobian(chain, rotations, origins, jacobian)
        for row in range(3):  # a slice as a whole takes Numba seconds to compile
            for i in range(n):
                tips[back, row, i] = jacobian[row, i]
    return tips


def force_levers(tips: FloatArray, torque: FloatArray) -> FloatArray:
    """Torques by the largest plausible force on the tip along each of three axes.

    ``tips`` are those of `tip_jacobians`; ``torque``, shape (n,), has the largest plausible torques
    of the joints [N m].  The axes are those of the forces' effects: a choice of the base's frame
    must not matter.  Levers have the shape of ``tips`` [N m].
    """
    effects = tips / torque
    axes = np.linalg.eigh((effects @ effects.swapaxes(1, 2)).sum(0))[1]
    # A force on a tip that no joint moves does not matter.
    largest = max(float((effects**2).sum(1).max()) ** 0.5, 1e-9)
    return np.asarray(axes.T @ tips / largest)


def smooth_contacts(
    courses: Sequence[FloatArray], levers: FloatArray, window: Window, null: Posterior
) -> Iterator[float]:
    """Log ratios of marginal likelihoods of smooth torques in the last balances.

    Each of ``courses``, shape (L, M), has unit variance, as impulses, newest first [s].
    ``levers``, shape (last, G, n), are torques of what acts independently: one joint each, or a
    force along one axis each [N m].  The unknowns of ``null`` are free.  A ratio is 0 where no
    torque is needed.
    """
    last = len(levers)
    at = recent(window, last)
    pulled, rows = levers * null.weights[at][:, None], window.rows[at][:, :, -len(null.mean) :]
    left = window.rows[at, :, 0] + rows @ null.mean
    score = -(pulled @ left[:, :, None])[:, :, 0].T  # (G, last)
    cross = (pulled @ rows).reshape(last, -1).T  # (G m, last)
    information = (pulled @ levers.swapaxes(1, 2)).reshape(last, -1).T  # (G G, last)
    for one in courses:
        yield _smooth_contact(*_contact_columns(one[:last], score, cross, information, null))


def _smooth_contact(score: FloatArray, information: FloatArray) -> float:
    """Log ratio of one course, by score (G, M) and information (G, M, G, M) of its columns."""
    (groups, modes), shares = score.shape, np.array(priors.AMPLITUDES)

    def gain_of(amplitude: FloatArray) -> float:
        """Of what acts at all, amplitude by amplitude."""
        active = np.flatnonzero(amplitude)
        own = information[active][:, :, active].reshape(2 * (len(active) * modes,))
        scale = np.repeat(amplitude[active], modes)
        gain = _free_torques(score[active].ravel(), own, scale)
        return float(gain) - SMOOTH_PENALTY * len(active)

    alone = np.einsum('gkgl->gkl', information)[:, None]
    gains = _free_torques(score[:, None], alone, shares[:, None]) - SMOOTH_PENALTY
    amplitude = np.where(gains.max(1) > 0.0, shares[gains.argmax(1)], 0.0)
    best = gain_of(amplitude)
    whole = information.reshape(2 * (groups * modes,))
    same = _free_torques(score.ravel(), whole, shares[:, None]) - SMOOTH_PENALTY * groups
    if same.max() > best:
        best, amplitude = float(same.max()), np.full(groups, shares[same.argmax()])
    for g in np.flatnonzero(amplitude):
        without = np.where(np.arange(groups) == g, 0.0, amplitude)
        gain = gain_of(without)
        if gain > best:
            best, amplitude = gain, without
    return best


def onset_gains(
    window: Window, null: Posterior, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Log ratios of marginal likelihoods of changes that stay, by the balance that they begin with.

    ``columns``, shape (last, n, K), newest balance first, are of unit standard deviations.  The
    unknowns of ``null``, which must hold the residuals, are free.  Returns shapes (last,) and
    (last, K), the second are the changes.
    """
    at = recent(window, len(columns))
    rows = window.rows[at][:, :, -len(null.mean) :]
    pulled = columns * null.weights[at][:, :, None]
    score = -np.einsum('kil,ki->kl', pulled, null.residual[: len(columns)]).cumsum(0)
    own = np.einsum('kil,kij->klj', pulled, columns).cumsum(0)
    known = whitened(null, (pulled.swapaxes(1, 2) @ rows).cumsum(0))
    matrix = np.eye(columns.shape[2]) + own - known @ known.swapaxes(1, 2)
    change = np.linalg.solve(matrix, score[:, :, None])[:, :, 0]
    return 0.5 * ((score * change).sum(1) - np.linalg.slogdet(matrix)[1]), change


def _contact_columns(
    courses: FloatArray, score: FloatArray, cross: FloatArray, information: FloatArray,
    null: Posterior,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Score (G, M) and information (G, M, G, M) of courses of unit size, arm's unknowns free.

    The other arguments are those of single balances, as in `smooth_contacts`.
    """
    groups, (last, modes) = len(score), courses.shape
    cross = (cross @ courses).reshape(groups, -1, modes).swapaxes(0, 1)
    cross = cross.reshape(-1, groups * modes)
    whiten(null.factor, cross)
    both = (courses[:, :, None] * courses[:, None, :]).reshape(last, -1)
    information, shape = information @ both, (groups, groups, modes, modes)
    return score @ courses, information.reshape(shape).swapaxes(1, 2) - (cross.T @ cross).reshape(
        groups, modes, groups, modes
    )


def _free_torques(score: FloatArray, information: FloatArray, scale: FloatArray) -> FloatArray:
    """Logarithms of ratios of marginal likelihoods of columns with these standard deviations.

    Shapes are (..., K), (..., K, K) and (..., K), where those of the last one are broadcast.
    """
    matrix = information * (scale[..., None] * scale[..., None, :]) + np.eye(score.shape[-1])
    right = np.broadcast_to(scale * score, matrix.shape[:-1]).copy()
    gains, size = np.empty(right.shape[:-1]), right.shape[-1]
    every = matrix.reshape(gains.size, size, size), right.reshape(gains.size, size, 1)
    _fill_gains(*every, np.ones(size), gains.reshape(-1))
    return gains


@njit_in_place
def _fill_gains(
    matrices: FloatArray, right: FloatArray, least: FloatArray, gains: FloatArray
) -> None:
    """Write (b^T A^-1 b - log det A) / 2 of each A and b, which are overwritten."""
    for k in range(gains.shape[0]):
        factorise(matrices[k], least)
        whiten(matrices[k], right[k])
        gains[k] = 0.0
        for i in range(least.shape[0]):
            gains[k] += 0.5 * right[k, i, 0] * right[k, i, 0] - np.log(matrices[k, i, i])
