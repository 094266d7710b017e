"""Integral tracking: LMI (67) on the paper's box, and on the exact polytope with a cost bound."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.support.entries import entry, positive
from lpv.core.support.inequalities import largest_eigenvalue
from lpv.core.support.limits import LARGEST
from lpv.core.uio.certificate.gains import METHODS
from lpv.core.uio.certificate.lmi import integral_feedback
from lpv.core.uio.model.arm import ArmParameters
from lpv_design.solve import RESERVE, run, symmetric_below


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


def check_loop(loop: tuple[np.ndarray, ...], m: np.ndarray, q: np.ndarray, alpha: float) -> float:
    """Largest eigenvalue of LMI (67) rebuilt in NumPy for gains M and a common Q."""
    margins = [largest_eigenvalue(-q)]
    # Q spans many decades; a congruence with its own factor makes the margins comparable.
    factor = np.linalg.inv(np.linalg.cholesky(q)) if margins[0] < 0 else np.eye(6)
    for a, b in zip(*loop):
        matrix = integral_feedback(q, m @ q, a, b, alpha)
        margins.append(largest_eigenvalue(factor @ matrix @ factor.T))
    return max(margins)


class LoopProblem:
    """Guaranteed-cost state feedback with integral action, compiled once for any vertices.

    The disc of radius r = (fastest - alpha)/2 around -(fastest + alpha)/2 implies LMI (67): with
    N = A_c Q + B_c X, (N + alpha Q) Q^-1 (N + alpha Q)^T >= 0 and the disc give
    N + N^T + 2 alpha Q < 0.  The solver is therefore not given (67); its check is.
    """

    def __init__(
        self,
        vertices: int,  # how many
        requirement: ControllerRequirement,
        rate: float,  # inverse of the unit of time in which the solver works [1/s]
    ) -> None:
        self._rate = rate
        # Rates count in units of it, integrals in its inverse; time runs in its inverse.
        scale = self._scale = np.repeat([1.0, 1.0 / rate, rate], 2)
        self._gravity = [cp.Parameter((2, 2)) for _ in range(vertices)]
        self._inverse = [cp.Parameter((2, 2)) for _ in range(vertices)]
        q = self._q = cp.Variable((6, 6), symmetric=True)
        x = self._x = cp.Variable((2, 6))
        w = cp.Variable((6, 6), symmetric=True)
        root = np.diag(np.sqrt(np.repeat(requirement.state_weight, 2) / rate) / scale)
        effort = np.sqrt(requirement.torque_weight / rate)
        slowest = (1.0 + RESERVE) * requirement.alpha / rate
        fastest = (1.0 - RESERVE) * requirement.fastest / rate
        center, radius = 0.5 * (fastest + slowest), 0.5 * (fastest - slowest)
        constraints = []
        for gravity, inverse in zip(self._gravity, self._inverse):
            # A_c Q + B_c X, with the rows of eq. (64) that do not depend on the vertex.
            closed = cp.vstack([q[2:4], gravity @ q[:2] + inverse @ x, -q[:2]])
            cost = cp.bmat(
                [
                    [closed + closed.T, q @ root, effort * x.T],
                    [root @ q, -np.eye(6), np.zeros((6, 2))],
                    [effort * x, np.zeros((2, 6)), -np.eye(2)],
                ]
            )
            shifted = center * q + closed
            disc = cp.bmat([[-radius * q, shifted], [shifted.T, -radius * q]])
            constraints += [symmetric_below(cost, 1e-7), symmetric_below(disc, 1e-7)]
        constraints.append(cp.bmat([[w, np.diag(scale)], [np.diag(scale), q]]) >> 0)
        self._problem = cp.Problem(cp.Minimize(cp.trace(w)), constraints)

    def solve(self, loop: tuple[np.ndarray, ...], unit: np.ndarray) -> tuple[Any, ...]:
        """Gains for given vertices."""
        for a, b, gravity, inverse in zip(*loop, self._gravity, self._inverse):
            gravity.value = a[2:4, :2] / self._rate**2
            inverse.value = b[2:4] * unit / self._rate**2
        status = run(self._problem)
        if self._q.value is None:
            return None, None, status
        m = unit[:, None] * self._x.value @ np.linalg.inv(self._q.value) * self._scale
        return m, self._q.value / np.outer(self._scale, self._scale), status


_compiled = lru_cache(maxsize=8)(LoopProblem)


def solve_loop(
    arm: ArmParameters, loop: tuple[np.ndarray, ...], requirement: ControllerRequirement
) -> tuple[Any, ...]:
    """M, Q and the solver's word: state feedback with integral action that satisfies LMI (67)."""
    unit = np.array(arm.numbers().gravity)  # of torques
    # What gravity makes of an angle in time, to a power of two: compiled problems are kept.
    rate = max(float(np.abs(b[2:4] * unit).max()) for b in loop[1])
    rate = 2.0 ** round(0.5 * math.log2(rate) - 2.0)
    return _compiled(len(loop[0]), requirement, rate).solve(loop, unit)
