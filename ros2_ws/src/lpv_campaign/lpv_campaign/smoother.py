"""Kalman filter and fixed-interval smoother of a linearised run, and the smoother by iteration.

The forward pass takes the readings one by one; the backward pass is the modified Bryson-Frazier
recursion, which inverts no covariance: the disturbance drives one direction only, faults and
parameters may be constants, and covariances may be singular.
"""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.linearisation import linearise, measurements
from lpv_core.errors import LpvError
from lpv_core.jit import njit
from lpv_core.joints import JointMap

_ITERATIONS = 25
_ARM_HELD = 2
_HELD = 1e-3
"""In the first iterations the arm is nearly the nominal one: while angles are far off, its
parameters would explain them and run away."""
_CONVERGED = 1e-6
_ARM_CONVERGED = 1e-3
"""Largest steps at which iteration ends: of angles and faults [rad], of the arm's parameters over
their standard deviation before any data."""
_SHRINKING = 0.5
"""A step that is not shorter than the last one by so much is halved: Coulomb friction turns over
within a small fraction of a rad/s, about which full steps may swing."""


@njit
def filter_forward(f, g, push, memory, growth, h, r, residual, defect, start, deviation, means,
                   covariances, gains, innovations, spreads):
    """Kalman filter of deviations from a trajectory.

    Parameters
    ----------
    f, g, push, memory, growth, h, r
        As `lpv_campaign.linearisation.LinearSystem`.
    residual : ndarray, shape (n, 6)
        Readings less those of the trajectory; anything where ``r`` is infinite.
    defect : ndarray, shape (n, N)
        State that follows from each sample of the trajectory, less the trajectory's next one.
    start, deviation : ndarray, shape (N,)
        First state's deviation and its standard deviation before any data.
    means, covariances : ndarray, shapes (n, N) and (n, N, N)
        Receive the deviations given the readings up to each sample.
    gains, innovations, spreads : ndarray, shapes (n, 6, N), (n, 6), (n, 6)
        Receive gain, innovation and its variance of each reading, for the backward pass.
    """
    n, size, known = len(f), f.shape[2], len(start)
    m, p, half = np.empty(known), np.zeros((known, known)), np.zeros((4, known))
    for i in range(known):
        m[i], p[i, i] = start[i], deviation[i] ** 2
    for k in range(n):
        for q in range(h.shape[1]):
            _update(h[k, q], r[k, q], residual[k, q], m, p, gains[k, q], innovations, spreads, k, q)
        means[k] = m
        covariances[k] = p
        if k + 1 == n:
            break
        _predict(f[k], g[k], push[k], memory, growth, defect[k], size, m, p, half)


@njit
def _update(h, r, residual, m, p, gain, innovations, spreads, k, q):
    """One scalar reading."""
    size = len(m)
    spreads[k, q] = np.inf
    innovations[k, q] = 0.0
    gain[:] = 0.0
    if not r < np.inf:
        return
    spread, innovation = r, residual
    for i in range(size):
        total = 0.0
        for j in range(size):
            if h[j] != 0.0:
                total += p[i, j] * h[j]
        gain[i] = total
        spread += h[i] * total
        innovation -= h[i] * m[i]
    for i in range(size):
        gain[i] /= spread
    for i in range(size):
        m[i] += gain[i] * innovation
        for j in range(i + 1):
            p[i, j] -= gain[i] * gain[j] * spread
            p[j, i] = p[i, j]
    innovations[k, q], spreads[k, q] = innovation, spread


@njit
def _predict(f, g, push, memory, growth, defect, size, m, p, half):
    """One sample later: only the first four states move, the others remember or forget."""
    known = len(m)
    for i in range(4):
        for j in range(known):
            total = 0.0
            for q in range(size):
                total += f[i, q] * p[q, j]
            half[i, j] = total
    moved = np.empty(4)
    for i in range(4):
        total = defect[i]
        for q in range(size):
            total += f[i, q] * m[q]
        moved[i] = total
    for i in range(4):
        for j in range(i + 1):
            total = push * g[i] * g[j]
            for q in range(size):
                total += half[i, q] * f[j, q]
            p[i, j] = p[j, i] = total
        for j in range(4, known):
            p[i, j] = p[j, i] = half[i, j] * memory[j]
        m[i] = moved[i]
    for i in range(4, known):
        m[i] = memory[i] * m[i] + defect[i]
        for j in range(4, i + 1):
            p[i, j] *= memory[i] * memory[j]
            p[j, i] = p[i, j]
        p[i, i] += growth[i]


@njit
def smooth_backward(f, memory, h, rows, means, covariances, gains, innovations, spreads,
                    smoothed, variances):
    """Modified Bryson-Frazier recursion after `filter_forward`.

    Parameters
    ----------
    f, memory, h
        As there.
    rows : ndarray, shape (n, q, N)
        Combinations of states whose variance is wanted.
    means, covariances, gains, innovations, spreads
        Results of `filter_forward`.
    smoothed : ndarray, shape (n, N)
        Receives the deviations given all readings.
    variances : ndarray, shape (n, q)
        Receives the variances of ``rows @ state`` given all readings.
    """
    n, known = means.shape
    slope, curve = np.zeros(known), np.zeros((known, known))
    back, work = np.empty(known), np.empty((known, known))
    for k in range(n - 1, -1, -1):
        if k + 1 < n:
            _adjoint(f[k], memory, slope, curve, back, work)
        p = covariances[k]
        for i in range(known):
            total = means[k, i]
            for j in range(known):
                total -= p[i, j] * slope[j]
            smoothed[k, i] = total
        for q in range(rows.shape[1]):
            variances[k, q] = _variance(rows[k, q], p, curve, back)
        for q in range(h.shape[1] - 1, -1, -1):
            if spreads[k, q] < np.inf:
                _undo(h[k, q], gains[k, q], innovations[k, q], spreads[k, q], slope, curve, back)


@njit
def _variance(row, p, curve, back):
    """row P row' - row P Lambda P row'."""
    known, total = len(row), 0.0
    for i in range(known):
        back[i] = 0.0
    for j in range(known):
        if row[j] != 0.0:
            for i in range(known):
                back[i] += p[i, j] * row[j]
    for i in range(known):
        total += row[i] * back[i]
        part = 0.0
        for j in range(known):
            part += curve[i, j] * back[j]
        total -= back[i] * part
    return max(total, 0.0)


@njit
def _undo(h, gain, innovation, spread, slope, curve, back):
    """Adjoint of one reading: slope and curve before it from those after it."""
    known, along, bend = len(slope), 0.0, 0.0
    for i in range(known):
        along += gain[i] * slope[i]
        total = 0.0
        for j in range(known):
            total += curve[i, j] * gain[j]
        back[i] = total
    for i in range(known):
        bend += gain[i] * back[i]
    for i in range(known):
        slope[i] -= h[i] * (along + innovation / spread)
        for j in range(i + 1):
            curve[i, j] += (h[i] * h[j] * (bend + 1.0 / spread) - h[i] * back[j]
                            - back[i] * h[j])
            curve[j, i] = curve[i, j]


@njit
def _adjoint(f, memory, slope, curve, back, work):
    """Adjoint of one step: F' slope and F' curve F."""
    known, size = len(slope), f.shape[1]
    for j in range(known):
        total = memory[j] * slope[j] if j >= 4 else 0.0
        if j < size:
            for i in range(4):
                total += f[i, j] * slope[i]
        back[j] = total
    for i in range(known):
        slope[i] = back[i]
        for j in range(known):
            total = memory[j] * curve[i, j] if j >= 4 else 0.0
            if j < size:
                for q in range(4):
                    total += curve[i, q] * f[q, j]
            work[i, j] = total
    for j in range(known):
        for i in range(j + 1):
            total = memory[i] * work[i, j] if i >= 4 else 0.0
            if i < size:
                for q in range(4):
                    total += f[q, i] * work[q, j]
            curve[i, j] = curve[j, i] = total


@dataclass(frozen=True)
class Passes:
    """Results of both passes over n samples.

    Attributes
    ----------
    means, smoothed : ndarray, shape (n, N)
        Deviations given the readings up to each sample, and given all.
    covariances : ndarray, shape (n, N, N)
        Given the readings up to each sample.
    filtered_variances, smoothed_variances : ndarray, shape (n, 4)
        Of the faults of both position sensors and of both absolute angles [rad2].
    """

    means: np.ndarray
    smoothed: np.ndarray
    covariances: np.ndarray
    filtered_variances: np.ndarray
    smoothed_variances: np.ndarray


def both_passes(system, residual=None, defect=None, start=None):
    """Filter and smooth deviations from the trajectory along which a run was linearised.

    Parameters
    ----------
    system : LinearSystem
        The run.
    residual, defect, start : ndarray, optional
        As `filter_forward`; zero, which leaves covariances alone.

    Returns
    -------
    Passes
        Deviations and variances.
    """
    n, _, size = system.h.shape
    residual = np.zeros((n, system.h.shape[1])) if residual is None else residual
    defect = np.zeros((n, size)) if defect is None else defect
    start = np.zeros(size) if start is None else start
    means, covariances = np.empty((n, size)), np.empty((n, size, size))
    gains, innovations = np.empty(system.h.shape), np.empty(residual.shape)
    spreads = np.empty(residual.shape)
    filter_forward(system.f, system.g, system.push, system.memory, system.growth, system.h,
                   system.r, residual, defect, start, system.deviation, means, covariances, gains,
                   innovations, spreads)
    rows = np.concatenate([system.fault, np.broadcast_to(np.eye(2, size), (n, 2, size))], axis=1)
    smoothed, variances = np.empty((n, size)), np.empty((n, 4))
    smooth_backward(system.f, system.memory, system.h, rows, means, covariances, gains,
                    innovations, spreads, smoothed, variances)
    filtered = np.einsum('kqi,kij,kqj->kq', rows, covariances, rows, optimize=True)
    return Passes(means, smoothed, covariances, np.maximum(filtered, 0.0), variances)


@dataclass(frozen=True)
class Smoothed:
    """Full-information estimate of one run.

    Attributes
    ----------
    angle, fault : ndarray, shape (n, 2)
        Absolute angles and faults of the position sensors [rad].
    states : ndarray, shape (n, N)
        All states, see `lpv_campaign.linearisation`.
    iterations : int
        Gauss-Newton steps.
    converged : bool
        Whether the last one was small.
    """

    angle: np.ndarray
    fault: np.ndarray
    states: np.ndarray
    iterations: int
    converged: bool


def smooth(arm, scenario, run, knowledge, faults, substeps=2, iterations=_ITERATIONS):
    """Most probable course of a run given all its data (iterated extended Kalman smoother).

    Each iteration linearises along the last result and solves for all samples at once: Gauss-Newton
    on the posterior, started from the observer's estimate.

    Parameters
    ----------
    arm, scenario, run, knowledge, faults, substeps
        As `lpv_campaign.linearisation.linearise`.
    iterations : int, optional
        At most so many.

    Returns
    -------
    Smoothed
        The estimate.

    Raises
    ------
    LpvError
        If iteration diverged.
    """
    states, readings = _first_guess(arm, run, knowledge, faults), measurements(arm, run)
    before = np.inf
    for count in range(1, iterations + 1):
        system = linearise(arm, scenario, run, knowledge, faults, states, substeps)
        if count <= _ARM_HELD:
            system.deviation[4:4 + len(knowledge.deviation)] *= _HELD
        defect = np.zeros_like(states)
        defect[:-1] = system.memory * states[:-1] - states[1:]
        defect[:-1, :4] = system.moved[:-1] - states[1:, :4]
        step = both_passes(system, readings - system.readings, defect,
                           system.start - states[0]).smoothed
        if not np.isfinite(step).all():
            raise LpvError(f'the smoother diverged in iteration {count}')
        length = _length(step, knowledge)
        if count > _ARM_HELD + 1 and length > _SHRINKING * before:
            step *= 0.5
        states, before = states + step, length
        if count > _ARM_HELD and length < 1.0:
            break
    fault = np.einsum('kqj,kj->kq', system.fault[:, :, 4:], states[:, 4:])
    return Smoothed(states[:, :2], fault, states, count, bool(length < 1.0))


def _length(step, knowledge):
    """Largest element of a step over what is small."""
    p = 4 + len(knowledge.deviation)
    moved = np.abs(step).max(axis=0)
    small = np.full(len(moved), _CONVERGED)
    small[4:p] = _ARM_CONVERGED * knowledge.deviation
    return float(np.delete(moved / small, (2, 3)).max())


def _first_guess(arm, run, knowledge, faults):
    joints = JointMap(arm)
    states = np.zeros((len(run.time), 4 + len(knowledge.deviation) + len(faults)))
    states[:, :2] = joints.absolute_position(run.estimate)
    states[:, 2:4] = joints.absolute_velocity(run.estimated_velocity)
    return states
