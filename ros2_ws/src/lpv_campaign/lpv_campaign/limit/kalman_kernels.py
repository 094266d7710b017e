"""Compiled recursions along a run: sampled dynamics with Jacobians, filters, smoother.

All of this package's compiled functions that call each other are in this file: machine code that is
kept between runs notices changes of its own file (and of lpv_core) only.
"""

import numpy as np

from lpv_core.model.arm import N_CONSTANTS, set_constants
from lpv_core.model.dynamics import rk4_step
from lpv_core.support.jit import njit

_STEP = 1e-5
"""Of central differences: [rad], [rad/s], [rad/s2] and parameters."""


@njit
def flow(
    x: np.ndarray,
    torque: np.ndarray,
    push_1: float,
    push_2: float,
    dt: float,
    substeps: int,
    params: np.record,
) -> tuple[float, ...]:
    """Mechanical state after ``substeps`` Runge-Kutta steps, as the plant takes them.

    Parameters
    ----------
    x : ndarray, shape (4,)
        Absolute angles and rates [rad], [rad/s].
    torque : ndarray, shape (2,)
        Generalised torques Q [N m].
    push_1, push_2 : float
        Accelerations by the disturbance [rad/s2].
    dt : float
        Length of one such step [s].
    substeps : int
        How many.
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of float
        The state.
    """
    a, b, u, v = x[0], x[1], x[2], x[3]
    for _ in range(substeps):
        a, b, u, v = rk4_step(a, b, u, v, torque[0], torque[1], push_1, push_2, dt, params)
    return a, b, u, v


@njit
def move_and_derive(
    states: np.ndarray,
    torques: np.ndarray,
    braked: np.ndarray,
    arm: np.record,
    constants: np.ndarray,
    sensitivity: np.ndarray,
    direction: np.ndarray,
    mean: float,
    sample_time: float,
    substeps: int,
    moved: np.ndarray,
    f: np.ndarray,
    g: np.ndarray,
) -> None:
    """Sampled dynamics along a trajectory, with Jacobians by central differences.

    Parameters
    ----------
    states : ndarray, shape (n, N)
        Trajectory.
    torques : ndarray, shape (n, 2)
        Generalised torques over the step after each sample [N m].
    braked : ndarray of bool, shape (n,)
        Whether brakes hold the arm over that step.
    arm : numpy.record
        Work space of type `lpv_core.model.arm.ARM_CONSTANTS`.
    constants, sensitivity : ndarray, shapes (12,) and (p, 12)
        `lpv_campaign.limit.arm_prior.ArmKnowledge`.
    direction : ndarray, shape (2,)
        Accelerations by a unit of disturbance.
    mean : float
        Mean disturbance.
    sample_time : float
        [s].
    substeps : int
        Runge-Kutta steps a sample.
    moved, f, g : ndarray, shapes (n, 4), (n, 4, N), (n, 4)
        Receive the state a sample later and its derivatives by state and disturbance.
    """
    count, dt = sensitivity.shape[0], sample_time / substeps
    x, c, half = np.empty(4), np.empty(N_CONSTANTS), 0.5 / _STEP
    f[:] = 0.0
    g[:] = 0.0
    for k in range(len(states)):
        if braked[k]:
            for i in range(2):
                moved[k, i], moved[k, 2 + i] = states[k, i], 0.0
                f[k, i, i] = 1.0
            continue
        c[:] = constants
        for j in range(count):
            for i in range(N_CONSTANTS):
                c[i] += states[k, 4 + j] * sensitivity[j, i]
        set_constants(arm, c)
        for i in range(4):
            x[i] = states[k, i]
        push_1, push_2 = direction[0] * mean, direction[1] * mean
        a = flow(x, torques[k], push_1, push_2, dt, substeps, arm)
        moved[k, 0], moved[k, 1], moved[k, 2], moved[k, 3] = a[0], a[1], a[2], a[3]
        for j in range(4 + count):
            if j < 4:
                centre = x[j]
                x[j] = centre + _STEP
                a = flow(x, torques[k], push_1, push_2, dt, substeps, arm)
                x[j] = centre - _STEP
                b = flow(x, torques[k], push_1, push_2, dt, substeps, arm)
                x[j] = centre
            else:
                for i in range(N_CONSTANTS):
                    c[i] += _STEP * sensitivity[j - 4, i]
                set_constants(arm, c)
                a = flow(x, torques[k], push_1, push_2, dt, substeps, arm)
                for i in range(N_CONSTANTS):
                    c[i] -= 2.0 * _STEP * sensitivity[j - 4, i]
                set_constants(arm, c)
                b = flow(x, torques[k], push_1, push_2, dt, substeps, arm)
                for i in range(N_CONSTANTS):
                    c[i] += _STEP * sensitivity[j - 4, i]
                set_constants(arm, c)
            f[k, 0, j], f[k, 1, j] = half * (a[0] - b[0]), half * (a[1] - b[1])
            f[k, 2, j], f[k, 3, j] = half * (a[2] - b[2]), half * (a[3] - b[3])
        a = flow(
            x,
            torques[k],
            push_1 + _STEP * direction[0],
            push_2 + _STEP * direction[1],
            dt,
            substeps,
            arm,
        )
        b = flow(
            x,
            torques[k],
            push_1 - _STEP * direction[0],
            push_2 - _STEP * direction[1],
            dt,
            substeps,
            arm,
        )
        g[k, 0], g[k, 1] = half * (a[0] - b[0]), half * (a[1] - b[1])
        g[k, 2], g[k, 3] = half * (a[2] - b[2]), half * (a[3] - b[3])


@njit
def filter_forward(
    f,
    g,
    push,
    memory,
    growth,
    h,
    r,
    residual: np.ndarray,
    defect: np.ndarray,
    start: np.ndarray,
    deviation: np.ndarray,
    means: np.ndarray,
    covariances: np.ndarray,
    gains: np.ndarray,
    innovations: np.ndarray,
    spreads: np.ndarray,
) -> None:
    """Kalman filter of deviations from a trajectory.

    Parameters
    ----------
    f, g, push, memory, growth, h, r
        As `lpv_campaign.limit.linearisation.LinearSystem`.
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
def _update(h, r, residual, m, p, gain, innovations, spreads, k, q) -> None:
    """Take one scalar reading."""
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
def _predict(f, g, push, memory, growth, defect, size, m, p, half) -> None:
    """Go one sample on: only the first four states move, the others remember or forget."""
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
def smooth_backward(
    f,
    memory,
    h,
    rows: np.ndarray,
    means,
    covariances,
    gains,
    innovations,
    spreads,
    smoothed: np.ndarray,
    variances: np.ndarray,
) -> None:
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
def _undo(h, gain, innovation, spread, slope, curve, back) -> None:
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
            curve[i, j] += h[i] * h[j] * (bend + 1.0 / spread) - h[i] * back[j] - back[i] * h[j]
            curve[j, i] = curve[i, j]


@njit
def _adjoint(f, memory, slope, curve, back, work) -> None:
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


@njit
def filter_extended(
    torques,
    braked,
    arm,
    constants,
    sensitivity,
    direction,
    mean,
    sample_time,
    substeps,
    push,
    memory,
    growth,
    h,
    r,
    readings: np.ndarray,
    start,
    deviation,
    states: np.ndarray,
) -> None:
    """Extended Kalman filter, linearised at its own estimate.

    Parameters
    ----------
    torques, braked, arm, constants, sensitivity, direction, mean, sample_time, substeps
        As `move_and_derive`.
    push, memory, growth, h, r, start, deviation
        As `filter_forward`; ``h`` does not depend on the state.
    readings : ndarray, shape (n, 6)
        What was read; anything where ``r`` is infinite.
    states : ndarray, shape (n, N)
        Receives the estimates.
    """
    n, known = states.shape
    at, p, half = np.zeros((1, known)), np.zeros((known, known)), np.zeros((4, known))
    moved, f, g = np.empty((1, 4)), np.empty((1, 4, known)), np.empty((1, 4))
    gain, defect, m = np.empty(known), np.zeros(known), at[0]
    innovations, spreads = np.empty((1, h.shape[1])), np.empty((1, h.shape[1]))
    for i in range(known):
        m[i], p[i, i] = start[i], deviation[i] ** 2
    for k in range(n):
        for q in range(h.shape[1]):
            _update(h[k, q], r[k, q], readings[k, q], m, p, gain, innovations, spreads, 0, q)
        states[k] = m
        if k + 1 < n:
            move_and_derive(
                at,
                torques[k : k + 1],
                braked[k : k + 1],
                arm,
                constants,
                sensitivity,
                direction,
                mean,
                sample_time,
                substeps,
                moved,
                f,
                g,
            )
            for i in range(4):
                defect[i] = moved[0, i]
                for j in range(known):
                    defect[i] -= f[0, i, j] * m[j]
            _predict(f[0], g[0], push[k], memory, growth, defect, known, m, p, half)
