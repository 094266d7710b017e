"""Physically consistent parameters by a semidefinite programme."""

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from lpv_core.serial_arm.description import N_INERTIAL, LinkInertia
from lpv_identify.errors import IdentificationError

_MARGIN = 1e-7  # smallest eigenvalue of a pseudo-inertia, relative to the link's scale
_SOLVED = (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)


@dataclass(frozen=True)
class Quadratic:
    """Cost (A x - b)^T W (A x - b) of parameters x."""

    map: np.ndarray  # A
    weight: np.ndarray  # W, symmetric, positive semidefinite
    right: np.ndarray  # W b

    def root(self) -> tuple[np.ndarray, np.ndarray]:
        """R A and R b with R^T R = W; directions of no weight are left out."""
        size = np.sqrt(np.maximum(np.diag(self.weight), 1e-300))
        values, vectors = np.linalg.eigh(self.weight / np.outer(size, size))
        kept = values > 1e-11 * values[-1]
        root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
        target = (vectors[:, kept].T @ (self.right / size)) / np.sqrt(values[kept])
        return (root * size) @ self.map, target


def nearest_consistent(
    data: Quadratic,
    mean: np.ndarray,
    sigma: np.ndarray,
    joints: int,
    bounds: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Parameters of least cost that belong to bodies of positive mass.

    Each link's pseudo-inertia is positive semidefinite (Wensing, Kim, Slotine 2018, eq. (12));
    what the data leave open stays close to the prior.

    Parameters
    ----------
    data : Quadratic
        Cost of the data.
    mean, sigma : ndarray, shape (parameters,)
        Normal prior of each parameter.
    joints : int
        Number of links; their inertial parameters come first in x.
    bounds : tuple of ndarray, each of shape (parameters,)
        Least and largest values.

    Returns
    -------
    ndarray, shape (parameters,)
        x; every pseudo-inertia is checked from the numbers that are returned.

    Raises
    ------
    IdentificationError
        If the solver finds no such parameters.
    """
    root, target = data.root()
    scaled = cp.Variable(len(mean))
    residual = (root * sigma) @ scaled - (target - root @ mean)
    # Clarabel likes costs of moderate size.
    size = max(1.0, float(np.linalg.norm(root * sigma)))
    cost = cp.sum_squares(residual / size) + cp.sum_squares(scaled) / size**2
    lower, upper = ((b - mean) / sigma for b in bounds)
    above, below = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    constraints = [scaled[above] >= lower[above]] if len(above) else []
    constraints += [scaled[below] <= upper[below]] if len(below) else []
    for i in range(joints):
        part = slice(N_INERTIAL * i, N_INERTIAL * (i + 1))
        constraints.append(
            _pseudo_inertia(scaled[part], mean[part], sigma[part]) >> _MARGIN * np.eye(4)
        )
    problem = cp.Problem(cp.Minimize(cost), constraints)
    try:
        problem.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise IdentificationError(
            f'no physically consistent inertias were found ({error})'
        ) from error
    if problem.status not in _SOLVED or scaled.value is None:
        raise IdentificationError(
            f'no physically consistent inertias were found ({problem.status})'
        )
    return np.clip(mean + sigma * scaled.value, *bounds)


def _pseudo_inertia(scaled: cp.Expression, mean: np.ndarray, sigma: np.ndarray) -> cp.Expression:
    """Pseudo-inertia in units of mass and length that bring its entries near 1."""
    mass_unit = sigma[0]
    length_unit = sigma[1] / sigma[0]
    unit = mass_unit * np.array([1.0] + [length_unit] * 3 + [length_unit**2] * 6)
    matrix = _PSEUDO @ np.diag(sigma / unit)
    return cp.reshape(matrix @ scaled + _PSEUDO @ (mean / unit), (4, 4), order='C')


def _pseudo_map() -> np.ndarray:
    """Matrix from the inertial parameters of a link to the entries of its pseudo-inertia."""
    return np.stack(
        [LinkInertia.from_vector(row).pseudo_inertia().ravel() for row in np.eye(N_INERTIAL)],
        axis=1,
    )


_PSEUDO = _pseudo_map()
