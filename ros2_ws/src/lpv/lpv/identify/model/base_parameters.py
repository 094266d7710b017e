"""Base parameters: the combinations of parameters that motion of an arm can determine."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from lpv.core.serial_arm.description import N_INERTIAL
from lpv.identify.model.rigid_body import STANDARD, RigidBody

_SAMPLES = 300  # random states; each has n rows, so that ten parameters a link are overdetermined
_TOLERANCE = 1e-8  # relative size of a column that depends on others: rounding is 1e-16


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters beta = combination @ x of 10 n inertial parameters and n rotor inertias x."""

    columns: np.ndarray  # indices into x, shape (base,)
    combination: np.ndarray  # shape (base, 11 n)

    @property
    def size(self) -> int:
        """Number of base parameters."""
        return len(self.columns)


def find_base_parameters(model: RigidBody) -> BaseParameters:
    """Base parameters of an arm with rotors, by QR of a random regressor."""
    # Gautier 1991, "Numerical calculation of the base inertial parameters of robots".  A column is
    # taken where it does not depend on those before it, from the tip to the base.
    rng, n = np.random.default_rng(20211), model.n
    position = rng.uniform(-np.pi, np.pi, (_SAMPLES, n))
    regressor = model.regressor(position, *rng.normal(size=(2, _SAMPLES, n)))
    regressor = regressor.reshape(-1, STANDARD * n)
    # Rotors last, so that they stand for themselves only where links do not explain them.
    links = N_INERTIAL * n
    order = np.concatenate([np.arange(links)[::-1], np.arange(links, STANDARD * n)])
    columns = np.sort(order[_independent(qr(regressor[:, order], mode='r')[0])])
    orthogonal, triangle = np.linalg.qr(regressor[:, columns])
    combination = solve_triangular(triangle, orthogonal.T @ regressor)
    combination[np.abs(combination) < 1e-9] = 0.0
    return BaseParameters(columns, combination)


def _independent(upper: np.ndarray) -> list[int]:
    """Columns of an upper triangular matrix that do not depend on those before them."""
    kept: list[int] = []
    upper = upper[: upper.shape[1]]
    scale = np.linalg.norm(upper, axis=0)
    basis = np.zeros((len(upper), 0))
    for k in range(upper.shape[1]):
        rest = upper[:, k] - basis @ (basis.T @ upper[:, k])
        rest -= basis @ (basis.T @ rest)
        size = np.linalg.norm(rest)
        if size > _TOLERANCE * max(scale[k], 1e-3 * scale.max()):
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return kept
