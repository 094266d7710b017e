"""Integral tracking: LMI (67) on the paper's box, and on the exact polytope with a cost bound; one
Lyapunov matrix for the sampled loop in motion."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, positive
from lpv.core.support.limits import LARGEST
from lpv.core.uio.certificate.conditions import (
    METHODS,
    ControllerGains,
    controller_loop,
    decay_margin,
)
from lpv.core.uio.certificate.lmi import disc
from lpv.core.uio.certificate.sampled_motion import (
    SIZE,
    MotionCertificate,
    SampledLoop,
    sampled_loop,
)
from lpv_design.corner_lyapunov import corner_lyapunov
from lpv_design.solve import RESERVE, InfeasibleError, run, solve, symmetric_below

_RATES = (0.5, 0.25, 0.0)
"""Largest link rates that are tried, in units of the slower natural frequency under gravity: halved
once, then none."""
_CLAIMED = 0.9
"""Part of the decay found that is claimed."""


@dataclass(frozen=True)
class ControllerRequirement:
    """What the tracking loop must fulfil, with LMI (67)."""

    method: str = entry('text', choices=METHODS)
    alpha: float = positive(LARGEST)  # decay rate of LMI (67) [1/s]
    # fastest allowed closed-loop pole [1/s]: one sample of delay must not matter
    fastest: float = positive(LARGEST)
    # guaranteed-cost weights of theta, theta', eps (same for both axes)
    state_weight: tuple = entry('vector', 3, above=0.0, high=LARGEST)
    torque_weight: float = positive(LARGEST)  # weight of torque, relative to gravity torque
    # lower end of the box of phi2 and phi3, method paper
    sinc_min: float = entry('number', default=-0.2, low=-0.3, high=0.99)

    def check(self, section: Section) -> None:
        """ConfigError if no pole is allowed."""
        if not self.fastest > self.alpha:
            raise section.error('fastest', 'must be greater than alpha')


@lru_cache(maxsize=4)
def design_controller(
    arm: ArmParameters, wanted: ControllerRequirement
) -> tuple[ControllerGains, str]:
    """Controller that fulfils a requirement, and the solver's word; InfeasibleError without one.

    Kept: a search for observers asks for the same controller again and again.
    """
    method, sinc_min = wanted.method, wanted.sinc_min
    loop = controller_loop(arm, method, sinc_min)
    m, p, status = solve_loop(arm, loop, wanted)
    margin = np.inf if m is None else decay_margin(loop, m, p, wanted.alpha)
    if not margin < 0.0:
        away = max(float(np.linalg.eigvals(a).real.max()) for a in loop[0])
        raise InfeasibleError(
            f'controller: LMI (67) with alpha = {wanted.alpha:g}/s and poles up to '
            f'{wanted.fastest:g}/s has no solution (solver: {status}, largest eigenvalue '
            f'{margin:.3g}); without torques the arm leaves a pose by up to {away:.2g}/s: ask for '
            'a smaller alpha, a larger fastest pole or a smaller region'
        )
    motion = None
    if method == 'exact':
        p = corner_lyapunov(arm, loop, m, p, wanted.alpha)
        motion = certify_motion(arm, loop, m, wanted.alpha)
    return ControllerGains(method, m[:, :4], m[:, 4:], p, wanted.alpha, sinc_min, motion), status


@lru_cache(maxsize=8)
def _loop_problem(
    vertices: int, state_weight: tuple[float, ...], torque_weight: float, rate: float
) -> tuple[Any, ...]:
    """Guaranteed-cost state feedback with integral action, compiled once for any poles.

    The disc of radius r = (fastest - alpha)/2 around -(fastest + alpha)/2 implies LMI (67): with
    N = A_c Q + B_c X, (N + alpha Q) Q^-1 (N + alpha Q)^T >= 0 and the disc give
    N + N^T + 2 alpha Q < 0.  The solver is therefore not given (67); its check is.  It works in
    units of time, 1/``rate``.  Returns the problem, parameters of vertices and disc, Q and X.
    """
    parameters = [(cp.Parameter((2, 2)), cp.Parameter((2, 2))) for _ in range(vertices)]
    q, x = cp.Variable((6, 6), symmetric=True), cp.Variable((2, 6))
    w = cp.Variable((6, 6), symmetric=True)
    root = np.diag(np.sqrt(np.repeat(state_weight, 2) / rate) / _scale(rate))
    effort = np.sqrt(torque_weight / rate)
    center, radius = cp.Parameter(), cp.Parameter()
    constraints = []
    for gravity, inverse in parameters:
        # A_c Q + B_c X, with the rows of eq. (64) that do not depend on the vertex.
        closed = cp.vstack([q[2:4], gravity @ q[:2] + inverse @ x, -q[:2]])
        cost = cp.bmat(
            [
                [closed + closed.T, q @ root, effort * x.T],
                [root @ q, -np.eye(6), np.zeros((6, 2))],
                [effort * x, np.zeros((2, 6)), -np.eye(2)],
            ]
        )
        poles = disc(q, closed, center, radius, cp.bmat)
        constraints += [symmetric_below(cost, 1e-7), symmetric_below(poles, 1e-7)]
    scale = np.diag(_scale(rate))
    constraints.append(cp.bmat([[w, scale], [scale, q]]) >> 0)
    return cp.Problem(cp.Minimize(cp.trace(w)), constraints), parameters, (center, radius), q, x


def _scale(rate: float) -> np.ndarray:
    """Units of the state: rates count in units of ``rate``, integrals in its inverse."""
    return np.repeat([1.0, 1.0 / rate, rate], 2)


def solve_loop(
    arm: ArmParameters, loop: tuple[np.ndarray, ...], wanted: ControllerRequirement
) -> tuple[Any, ...]:
    """M, P = Q^-1 and the solver's word: state feedback with integral action for LMI (67)."""
    unit = np.array(arm.numbers().gravity)  # of torques
    # What gravity makes of an angle in time, to a power of two: compiled problems are kept.
    rate = max(float(np.abs(b[2:4] * unit).max()) for b in loop[1])
    rate = 2.0 ** round(0.5 * math.log2(rate) - 2.0)
    kept = _loop_problem(len(loop[0]), wanted.state_weight, wanted.torque_weight, rate)
    problem, parameters, (center, radius), q, x = kept
    slowest = (1.0 + RESERVE) * wanted.alpha / rate
    fastest = (1.0 - RESERVE) * wanted.fastest / rate
    center.value, radius.value = 0.5 * (fastest + slowest), 0.5 * (fastest - slowest)
    for a, b, (gravity, inverse) in zip(*loop, parameters):
        gravity.value, inverse.value = a[2:4, :2] / rate**2, b[2:4] * unit / rate**2
    status, scale = run(problem), _scale(rate)
    if q.value is None:
        return None, None, status
    m = unit[:, None] * x.value @ np.linalg.inv(q.value) * scale
    p = np.linalg.inv(q.value / np.outer(scale, scale))
    return m, 0.5 * (p + p.T), status


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
        p = _contracting(sampled, math.exp(-alpha * arm.sample_time))
        if p is None:
            continue
        decay = -math.log(sampled.contraction(p)) / arm.sample_time
        if decay > 0.0:
            return MotionCertificate(p, rate, _round_down(_CLAIMED * decay))
    return None


def _contracting(sampled: SampledLoop, factor: float) -> np.ndarray | None:
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
