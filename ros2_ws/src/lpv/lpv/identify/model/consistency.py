"""Physically consistent parameters by a semidefinite programme."""

import clarabel
import numpy as np
from scipy import sparse

from lpv.core.serial_arm.description import N_INERTIAL, LinkInertia
from lpv.identify.errors import IdentificationError

_MARGIN = 1e-7  # smallest eigenvalue of a pseudo-inertia: ten times the tolerance of the solver


def nearest_consistent(
    root: np.ndarray,
    target: np.ndarray,
    mean: np.ndarray,
    sigma: np.ndarray,
    joints: int,
    bounds: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Parameters x of bodies of positive mass whose root @ x is nearest to a target, with a prior;
    IdentificationError without."""
    # Each link's pseudo-inertia is positive semidefinite (Wensing, Kim, Slotine 2018, equation 12).
    size = max(1.0, float(np.linalg.norm(root * sigma)))  # solvers like costs of moderate size
    rows, count = root.shape[0], len(mean)
    # Variables are x in units of the prior, and the residuals of the data.
    cost = sparse.diags(np.append(np.full(count, 2.0 / size**2), np.full(rows, 2.0)))
    lower, upper = ((b - mean) / sigma for b in bounds)
    above, below, eye = np.isfinite(lower), np.isfinite(upper), np.eye(count)
    matrices, rights = [-eye[above], eye[below]], [-lower[above], upper[below]]
    for part in np.split(np.arange(N_INERTIAL * joints), joints):
        matrix, right = _pseudo_inertia(mean[part], sigma[part])
        matrices.append(-matrix @ eye[part])
        rights.append(right)
    bounded = np.vstack(matrices)
    fit = np.hstack([root * sigma / size, -np.eye(rows)])
    left = np.vstack([fit, np.hstack([bounded, np.zeros((len(bounded), rows))])])
    right = np.concatenate([(target - root @ mean) / size, *rights])
    cones = [
        clarabel.ZeroConeT(rows),
        clarabel.NonnegativeConeT(int(above.sum() + below.sum())),
        *(clarabel.PSDTriangleConeT(4) for _ in range(joints)),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    programme = sparse.csc_matrix(cost), np.zeros(count + rows), sparse.csc_matrix(left), right
    solution = clarabel.DefaultSolver(*programme, cones, settings).solve()
    if str(solution.status) not in ('Solved', 'AlmostSolved'):
        raise IdentificationError(
            f'no physically consistent inertias were found ({solution.status})'
        )
    return np.clip(mean + sigma * np.array(solution.x[:count]), *bounds)


def _pseudo_inertia(mean: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pseudo-inertia M x + b of a link less a margin, in the solver's form, scaled to 1."""
    length_unit = sigma[1] / sigma[0]
    unit = sigma[0] * np.array([1.0] + [length_unit] * 3 + [length_unit**2] * 6)
    return _PSEUDO @ np.diag(sigma / unit), _PSEUDO @ (mean / unit) - _MARGIN * _UNIT


def _triangle(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle by columns, entries off the diagonal times sqrt(2): norms stay."""
    return np.array(
        [matrix[i, j] * (1.0 if i == j else np.sqrt(2.0)) for j in range(4) for i in range(j + 1)]
    )


_PSEUDO = np.stack(
    [_triangle(LinkInertia.from_vector(row).pseudo_inertia()) for row in np.eye(N_INERTIAL)], axis=1
)
_UNIT = _triangle(np.eye(4))
