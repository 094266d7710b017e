"""One Lyapunov matrix for the sampled tracking loop in motion."""

import math

import cvxpy as cp
import numpy as np

from lpv.core.uio.certificate.sampled_motion import (
    SIZE,
    MotionCertificate,
    SampledLoop,
    sampled_loop,
)
from lpv.core.uio.model.arm import ArmParameters
from lpv_design.solve import solve, symmetric_below

_RATES = (0.5, 0.25, 0.0)
"""Largest link rates that are tried, in units of the slower natural frequency under gravity: halved
once, then none."""
_RESERVE = 0.9
"""Part of the decay found that is claimed."""


def certify_motion(
    arm: ArmParameters, loop: tuple[np.ndarray, ...], feedback: np.ndarray, alpha: float
) -> MotionCertificate | None:
    """Search for a common Lyapunov matrix of the sampled loop with delay and Coriolis torques.

    Vertices A_c, B_c of eq. (64), (M1, M2) and the decay rate of the continuous loop [1/s] are
    given.  The certificate is for the largest rate at which one was found; None where the sample
    time leaves no room.
    """
    constants = arm.constants()
    frequency = math.sqrt(min(constants.gravity / constants.inertia))
    for share in _RATES:
        rate = _round_down(share * frequency)
        sampled = sampled_loop(arm, loop, feedback, rate)
        p = _lyapunov(sampled, math.exp(-alpha * arm.sample_time))
        if p is None:
            continue
        decay = -math.log(sampled.contraction(p)) / arm.sample_time
        if decay > 0.0:
            return MotionCertificate(p, rate, _round_down(_RESERVE * decay))
    return None


def _lyapunov(sampled: SampledLoop, factor: float) -> np.ndarray | None:
    """P by which every vertex contracts by a factor, as well conditioned as can be."""
    # Modal coordinates of the middle balance fast and slow poles.
    _, modes = np.linalg.eig(sampled.vertices.mean(axis=0))
    basis = np.linalg.cholesky(np.real(modes @ modes.conj().T))
    inverse = np.linalg.inv(basis)
    p, condition = cp.Variable((SIZE, SIZE), symmetric=True), cp.Variable()
    constraints = [p >> np.eye(SIZE), p << condition * np.eye(SIZE)]
    for vertex in sampled.vertices:
        scaled = inverse @ vertex @ basis
        change = (scaled.T @ p @ scaled - factor**2 * p) / (1.0 - factor)
        constraints.append(symmetric_below(change))
    solve(condition, constraints)
    return None if p.value is None else inverse.T @ p.value @ inverse


def _round_down(value: float) -> float:
    """To two significant digits."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f'{math.floor(value / unit) * unit:.6g}')
