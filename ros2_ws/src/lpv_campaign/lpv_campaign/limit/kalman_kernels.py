"""Compiled recursions along a run: sampled dynamics with Jacobians, Kalman filters, smoother.

For a state z with transition A, noise Q and scalar readings y = h' z + noise of variance r:

    (K1)  z-  = A z + b                 prediction
    (K2)  P-  = A P A' + Q
    (K3)  S   = h' P h + r              update by one reading
    (K4)  k   = P h / S
    (K5)  z+  = z + k (y - h' z)
    (K6)  P+  = P - S k k'
    (S1)  l-  = A' l,  L- = A' L A      modified Bryson-Frazier smoother, backwards:
    (S2)  l-  = (I - h k') l - h (y - h' z) / S           over each reading,
    (S3)  L-  = (I - h k') L (I - k h') + h h' / S
    (S4)  zs  = z - P l,  Ps = P - P L P                  for each sample

(G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter X.)

All compiled functions of this package that call each other are in this file: machine code that is
kept between runs notices changes of its own file (and of lpv_core) only.
"""

from typing import NamedTuple

import numpy as np

from lpv_core.model.arm import set_constants
from lpv_core.model.dynamics import rk4_step
from lpv_core.support.jit import njit

_STEP = 1e-5
"""Of central differences: [rad], [rad/s], [rad/s2] and parameters."""


class SampledArm(NamedTuple):
    """An arm with p unknown constant parameters, sampled."""

    constants: np.ndarray  # (12,) where all parameters are zero
    sensitivity: np.ndarray  # (p, 12) change of the constants with each parameter
    direction: np.ndarray  # (2,) accelerations by a unit of disturbance
    mean: float  # mean disturbance
    sample_time: float  # [s]
    substeps: int  # Runge-Kutta steps per sample
    work: np.record  # of type `lpv_core.model.arm.ARM_CONSTANTS`, receives those of a parameter


class Noise(NamedTuple):
    """Statistics of a linear system of N states, of which the first four are mechanical."""

    push: np.ndarray  # (n,) variance of the disturbance
    memory: np.ndarray  # (N,) factor of each other state from sample to sample
    growth: np.ndarray  # (N,) variance that each sample adds to each other state
    h: np.ndarray  # (n, 6, N) Jacobian of the readings
    r: np.ndarray  # (n, 6) variance of the readings; infinite for what is not there


class Filtered(NamedTuple):
    """What the filter leaves for the smoother."""

    means: np.ndarray  # (n, N) given the readings up to each sample
    covariances: np.ndarray  # (n, N, N) likewise
    gains: np.ndarray  # (n, 6, N) gain of each reading, k
    innovations: np.ndarray  # (n, 6) y - h' z
    spreads: np.ndarray  # (n, 6) their variance, S; infinite for what was not there


@njit
def _flow(z: np.ndarray, torque: np.ndarray, disturbance: float, arm: SampledArm) -> np.ndarray:
    """Mechanical state one sample after angles, rates and parameters ``z``, as the plant moves."""
    constants = arm.constants.copy()
    for j in range(len(arm.sensitivity)):
        constants += z[4 + j] * arm.sensitivity[j]
    set_constants(arm.work, constants)
    push, dt = arm.direction * disturbance, arm.sample_time / arm.substeps
    x = z[0], z[1], z[2], z[3]
    for _ in range(arm.substeps):
        x = rk4_step(x, (torque[0], torque[1]), (push[0], push[1]), dt, arm.work)
    return np.array(x)


@njit
def _central_difference(z: np.ndarray, j: int, torque: np.ndarray, arm: SampledArm) -> np.ndarray:
    """Derivative of `_flow` by element j of ``z``; by the disturbance where there is none such."""
    step, push = np.zeros(len(z)), 0.0
    if j < len(z):
        step[j] = _STEP
    else:
        push = _STEP
    above = _flow(z + step, torque, arm.mean + push, arm)
    below = _flow(z - step, torque, arm.mean - push, arm)
    return (above - below) * (0.5 / _STEP)


@njit
def move_and_derive(
    states: np.ndarray, torques: np.ndarray, braked: np.ndarray, arm: SampledArm
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sampled dynamics along a trajectory, with Jacobians by central differences.

    Parameters
    ----------
    states : ndarray, shape (n, N)
        Trajectory: angles [rad], rates [rad/s], parameters of the arm, what else there is.
    torques : ndarray, shape (n, 2)
        Generalised torques over the step after each sample [N m].
    braked : ndarray of bool, shape (n,)
        Whether brakes hold the arm over that step.
    arm : SampledArm
        The arm.

    Returns
    -------
    tuple of ndarray, shapes (n, 4), (n, 4, N), (n, 4)
        Mechanical state one sample later, its derivatives by state and by disturbance.
    """
    n, size = states.shape
    moving = 4 + len(arm.sensitivity)
    moved, f, g = np.zeros((n, 4)), np.zeros((n, 4, size)), np.zeros((n, 4))
    for k in range(n):
        z = states[k, :moving]
        if braked[k]:
            moved[k, :2] = z[:2]
            f[k, 0, 0] = f[k, 1, 1] = 1.0
            continue
        moved[k] = _flow(z, torques[k], arm.mean, arm)
        for j in range(moving):
            f[k, :, j] = _central_difference(z, j, torques[k], arm)
        g[k] = _central_difference(z, moving, torques[k], arm)
    return moved, f, g


@njit
def _transition(f: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """A: the mechanical states move, all others remember or forget."""
    a = np.diag(memory)
    a[:4] = 0.0
    a[:4, : f.shape[1]] = f
    return a


@njit
def _process_noise(g: np.ndarray, push: float, growth: np.ndarray) -> np.ndarray:
    """Q: the disturbance drives one direction, other states grow."""
    q = np.diag(growth)
    q[:4, :4] = push * np.outer(g, g)
    return q


@njit
def _update(
    m: np.ndarray, p: np.ndarray, y: np.ndarray, h: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Take the readings of a sample one by one; what is missing has an infinite variance."""
    gains = np.zeros(h.shape)
    innovations, spreads = np.zeros(len(h)), np.full(len(h), np.inf)
    for i in range(len(h)):
        if r[i] < np.inf:
            ph = p @ h[i]
            spreads[i] = h[i] @ ph + r[i]  # (K3)
            gains[i] = ph / spreads[i]  # (K4)
            innovations[i] = y[i] - h[i] @ m
            m = m + gains[i] * innovations[i]  # (K5)
            p = p - spreads[i] * np.outer(gains[i], gains[i])  # (K6)
    return m, p, gains, innovations, spreads


@njit
def _predict(p: np.ndarray, a: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Covariance one sample later, kept symmetric against rounding."""
    p = a @ p @ a.T + q  # (K2)
    return 0.5 * (p + p.T)


@njit
def filter_forward(
    f: np.ndarray,
    g: np.ndarray,
    noise: Noise,
    residual: np.ndarray,
    defect: np.ndarray,
    start: np.ndarray,
    deviation: np.ndarray,
) -> Filtered:
    """Kalman filter of deviations from a trajectory.

    Parameters
    ----------
    f, g : ndarray, shapes (n, 4, at most N) and (n, 4)
        Derivatives of the next mechanical state by state and by disturbance.
    noise : Noise
        Statistics of the system.
    residual : ndarray, shape (n, 6)
        Readings less those of the trajectory; anything where their variance is infinite.
    defect : ndarray, shape (n, N)
        State that follows from each sample of the trajectory, less the trajectory's next one.
    start, deviation : ndarray, shape (N,)
        First state's deviation and its standard deviation before any data.

    Returns
    -------
    Filtered
        Deviations given the readings up to each sample, and what the smoother needs.
    """
    n, count, size = noise.h.shape
    out = Filtered(
        np.empty((n, size)),
        np.empty((n, size, size)),
        np.empty((n, count, size)),
        np.empty((n, count)),
        np.empty((n, count)),
    )
    m, p = start.copy(), np.diag(deviation**2)
    for k in range(n):
        m, p, gains, innovations, spreads = _update(m, p, residual[k], noise.h[k], noise.r[k])
        out.means[k], out.covariances[k] = m, p
        out.gains[k], out.innovations[k], out.spreads[k] = gains, innovations, spreads
        a = _transition(f[k], noise.memory)
        m = a @ m + defect[k]  # (K1)
        p = _predict(p, a, _process_noise(g[k], noise.push[k], noise.growth))
    return out


@njit
def smooth_backward(
    f: np.ndarray, noise: Noise, rows: np.ndarray, filtered: Filtered
) -> tuple[np.ndarray, np.ndarray]:
    """Modified Bryson-Frazier recursion after `filter_forward`.

    Parameters
    ----------
    f, noise, filtered
        As there.
    rows : ndarray, shape (n, q, N)
        Combinations of states whose variance is wanted.

    Returns
    -------
    tuple of ndarray, shapes (n, N) and (n, q)
        Deviations given all readings, and the variances of ``rows @ state`` given all readings.
    """
    n, size = filtered.means.shape
    smoothed, variances = np.empty((n, size)), np.empty(rows.shape[:2])
    slope, curve = np.zeros(size), np.zeros((size, size))
    for k in range(n - 1, -1, -1):
        p = filtered.covariances[k]
        if k + 1 < n:
            a = _transition(f[k], noise.memory)
            slope, curve = a.T @ slope, a.T @ curve @ a  # (S1)
        smoothed[k] = filtered.means[k] - p @ slope  # (S4)
        for i in range(rows.shape[1]):
            ph = p @ rows[k, i]
            variances[k, i] = max(rows[k, i] @ ph - ph @ curve @ ph, 0.0)  # (S4)
        for i in range(noise.h.shape[1] - 1, -1, -1):
            gain, spread, h = filtered.gains[k, i], filtered.spreads[k, i], noise.h[k, i]
            if spread < np.inf:
                slope = slope - h * (gain @ slope + filtered.innovations[k, i] / spread)  # (S2)
                bend = curve @ gain
                cross = np.outer(h, bend)
                curve = curve - cross - cross.T  # (S3)
                curve = curve + np.outer(h, h) * (gain @ bend + 1.0 / spread)
    return smoothed, variances


@njit
def filter_extended(
    torques: np.ndarray,
    braked: np.ndarray,
    arm: SampledArm,
    noise: Noise,
    readings: np.ndarray,
    start: np.ndarray,
    deviation: np.ndarray,
) -> np.ndarray:
    """Extended Kalman filter, linearised at its own estimate.

    Parameters
    ----------
    torques, braked, arm
        As `move_and_derive`.
    noise, start, deviation
        As `filter_forward`; the readings' Jacobian does not depend on the state.
    readings : ndarray, shape (n, 6)
        What was read; anything where the variance is infinite.

    Returns
    -------
    ndarray, shape (n, N)
        The estimates.
    """
    n, _, size = noise.h.shape
    states = np.empty((n, size))
    m, p = start.copy(), np.diag(deviation**2)
    for k in range(n):
        m, p, _, _, _ = _update(m, p, readings[k], noise.h[k], noise.r[k])
        states[k] = m
        moved, f, g = move_and_derive(states[k : k + 1], torques[k : k + 1], braked[k : k + 1], arm)
        m = noise.memory * m  # (K1)
        m[:4] = moved[0]
        a, q = _transition(f[0], noise.memory), _process_noise(g[0], noise.push[k], noise.growth)
        p = _predict(p, a, q)
    return states
