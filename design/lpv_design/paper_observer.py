"""Method ``paper``: the observer LMIs (54) and (55) on the box of phi1, phi2, phi3."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from lpv_core.certificate.lmi import bounded_real, bounded_real_disc, disc, largest_eigenvalue
from lpv_core.model.arm import ArmParameters
from lpv_core.model.polytope import sinc_box
from lpv_core.model.state_space import Descriptor, vertex_matrices
from lpv_core.observer.paper_observer import decoupling
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
    a, b = vertex_matrices(box, arm.constants(coriolis=False))
    descriptor = Descriptor(a, b, arm)
    t1, t2 = decoupling(descriptor.e, descriptor.c)
    return PaperProblem(descriptor, t1, t2, q, r, box)


def _inequalities(
    problem: PaperProblem,
    p: Any,
    y: Any,
    gamma_squared: Any,
    lmi: str,
    block: Callable[..., Any] = np.block,
) -> list[Any]:
    d = problem.descriptor
    pbd, pbf = p @ (problem.t1 @ d.bd), p @ (problem.t1 @ d.bf)
    matrices = []
    for a_i, y_i in zip(d.a, y):
        pn = p @ (problem.t1 @ a_i) + y_i @ d.c
        if lmi == '55':
            matrices.append(
                bounded_real_disc(p, pn, pbd, pbf, gamma_squared, problem.q, problem.r, block)
            )
        else:
            matrices.append(bounded_real(p, pn, pbd, pbf, gamma_squared, block))
            matrices.append(disc(p, pn, problem.q, problem.r, block))
    return matrices


def solve_paper(
    problem: PaperProblem, lmi: str = '55', gamma: float | None = None
) -> tuple[Any, ...]:
    """Solve LMI (55), or (54) with the disc apart, for P and K_i.

    Parameters
    ----------
    problem : PaperProblem
        From `paper_problem`.
    lmi : {'55', '54+disc'}
        Literal (55), or (54) and the disc as separate inequalities with the same P.
    gamma : float, optional
        Attenuation level to be met; minimised if not given.

    Returns
    -------
    tuple
        ``(k, p, gamma, status)``: K_i (8, 6, 4) or None if no point was found, P (6, 6),
        gamma, and the solver's status.
    """
    p = cp.Variable((6, 6), symmetric=True)
    y = [cp.Variable((6, 4)) for _ in problem.descriptor.a]
    gamma_squared = cp.Variable(nonneg=True) if gamma is None else cp.Constant(gamma**2)
    constraints = [p >> 1e-6 * np.eye(6)]
    constraints += [
        symmetric_below(m, 1e-8) for m in _inequalities(problem, p, y, gamma_squared, lmi, cp.bmat)
    ]
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
    matrices = _inequalities(problem, p, [p @ k_i for k_i in k], gamma**2, lmi)
    return max(largest_eigenvalue(-p), *(largest_eigenvalue(m) for m in matrices))
