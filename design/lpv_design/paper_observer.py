"""Method ``paper``: the observer LMIs (54) and (55) on the box of phi1, phi2, phi3."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.support.inequalities import largest_eigenvalue
from lpv.core.uio.certificate.lmi import paper_inequalities
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.polytope import paper_weights, sinc_box
from lpv.core.uio.model.state_space import Descriptor, paper_descriptor
from lpv.core.uio.observer.paper_observer import decoupling
from lpv_design.solve import solve, symmetric_below


@dataclass(frozen=True)
class PaperProblem:
    """The data of LMIs (54), (55) for one box: eqs. (36), (37) and (49)."""

    descriptor: Descriptor  # augmented vertices, eqs. (36), (37)
    t1: np.ndarray  # T1 from the pseudo-inverse
    t2: np.ndarray  # T2 from the same
    q: float  # disc [1/s]
    r: float  # disc [1/s]
    box: np.ndarray  # ranges of phi1, phi2, phi3, shape (3, 2)


def paper_problem(
    arm: ArmParameters, s_min: float, q: float = 20.0, r: float = 15.0
) -> PaperProblem:
    """Set up the LMIs for phi2, phi3 in [s_min, 1]."""
    box = sinc_box(s_min)
    descriptor = paper_descriptor(arm, box)
    t1, t2 = decoupling(descriptor.e, descriptor.c)
    return PaperProblem(descriptor, t1, t2, q, r, box)


def lost_mode(a: np.ndarray, c: np.ndarray, tolerance: float = 1e-9) -> tuple[Any, ...] | None:
    """Popov-Belevitch-Hautus test on one augmented model: eigenvalue and vector of a lost mode."""
    for eigenvalue in np.linalg.eigvals(a):
        if eigenvalue.real < -tolerance:
            continue
        pencil = np.vstack([a - eigenvalue * np.eye(len(a)), c])
        _, singular, vectors = np.linalg.svd(pencil)
        if singular[-1] < tolerance * max(1.0, singular[0]):
            return eigenvalue, vectors[-1].conj()
    return None


def undetectable_point(problem: PaperProblem) -> tuple[Any, ...] | None:
    """Search a box of phi1, phi2, phi3 for a point where faults cannot be told from states.

    Gravity enters through phi2 and phi3 alone; a point is lost exactly where one of them is zero,
    so that zero, where the box contains it, is tried besides the corners.
    """
    (low_1, high_1), *others = problem.box
    slopes = [sorted({low, high, min(max(0.0, low), high)}) for low, high in others]
    for s_2, s_3, phi_1 in product(*slopes, (low_1, 0.0, high_1)):
        rho = np.zeros(8)
        paper_weights(phi_1, s_2, s_3, problem.box, rho)
        a = np.tensordot(rho, problem.descriptor.a, 1)
        mode = lost_mode(problem.t1 @ a, problem.descriptor.c)
        if mode is not None:
            return (np.array([phi_1, s_2, s_3]), *mode)
    return None


def solve_paper(
    problem: PaperProblem, lmi: str = '55', gamma: float | None = None
) -> tuple[Any, ...]:
    """Solve LMI (55), or LMI (54) with the disc apart, for P and K_i; ``gamma`` is minimised
    unless given.

    Returns
    -------
    tuple
        ``(k, p, gamma, status)``: K_i (8, 6, 4) or None if no point was found, P (6, 6),
        gamma, and the solver's status.
    """
    p = cp.Variable((6, 6), symmetric=True)
    y = [cp.Variable((6, 4)) for _ in problem.descriptor.a]
    gamma_squared = cp.Variable(nonneg=True) if gamma is None else cp.Constant(gamma**2)
    d, pt = problem.descriptor, p @ problem.t1
    matrices = paper_inequalities(d, p, pt, y, gamma_squared, problem.q, problem.r, lmi, cp.bmat)
    constraints = [p >> 1e-6 * np.eye(6), *(symmetric_below(m, 1e-8) for m in matrices)]
    status = solve(gamma_squared if gamma is None else 0, constraints)
    if p.value is None or gamma_squared.value is None:
        return None, None, np.inf, status
    try:
        k = np.array([np.linalg.solve(p.value, np.asarray(y_i.value)) for y_i in y])
    except np.linalg.LinAlgError:
        return None, None, np.inf, status
    return k, p.value, math.sqrt(max(float(gamma_squared.value), 0.0)), status


def check_paper(
    problem: PaperProblem, k: np.ndarray, p: np.ndarray, gamma: float, lmi: str = '55'
) -> float:
    """Largest eigenvalue over all inequalities, rebuilt in NumPy from gains and P."""
    d, pt = problem.descriptor, p @ problem.t1
    matrices = paper_inequalities(d, p, pt, p @ k, gamma**2, problem.q, problem.r, lmi)
    return max(map(largest_eigenvalue, [-p, *matrices]))
