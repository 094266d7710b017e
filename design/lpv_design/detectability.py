"""Which faults can be told from states, before any LMI is solved."""

from typing import Any

import numpy as np

from lpv_core.model.polytope import paper_weights
from lpv_design.paper_observer import PaperProblem


def lost_mode(a: np.ndarray, c: np.ndarray, tolerance: float = 1e-9) -> tuple[Any, ...] | None:
    """Popov-Belevitch-Hautus test on one augmented model."""
    for eigenvalue in np.linalg.eigvals(a):
        if eigenvalue.real < -tolerance:
            continue
        pencil = np.vstack([a - eigenvalue * np.eye(len(a)), c])
        _, singular, vectors = np.linalg.svd(pencil)
        if singular[-1] < tolerance * max(1.0, singular[0]):
            return eigenvalue, vectors[-1].conj()
    return None


def undetectable_point(problem: PaperProblem) -> tuple[Any, ...] | None:
    """Search a box of phi1, phi2, phi3 for a point without detectability.

    Gravity enters through phi2 and phi3 alone; a point is lost exactly where one of them is zero,
    so that zero, where the box contains it, is tried besides the corners.
    """
    d = problem.descriptor
    low, high = problem.box[:, 0], problem.box[:, 1]
    for s_2 in _candidates(low[1], high[1]):
        for s_3 in _candidates(low[2], high[2]):
            for phi_1 in (low[0], 0.0, high[0]):
                phi = np.array([phi_1, s_2, s_3])
                mode = lost_mode(problem.t1 @ _interpolate(d.a, problem.box, phi), d.c)
                if mode is not None:
                    return (phi, *mode)
    return None


def _candidates(low: float, high: float) -> list[float]:
    return sorted({low, high, min(max(0.0, low), high)})


def _interpolate(vertices: np.ndarray, box: np.ndarray, phi: np.ndarray) -> np.ndarray:
    rho = np.zeros(8)
    paper_weights(phi[0], phi[1], phi[2], np.ascontiguousarray(box), rho)
    return np.tensordot(rho, vertices, 1)
