"""Base parameters: the combinations of parameters that motion of an arm can determine."""

from dataclasses import dataclass

import numpy as np
import pinocchio
from scipy.linalg import qr, solve_triangular

from lpv_identify.model.rigid_body import torque_regressor

_SAMPLES = 300
_TOLERANCE = 1e-8


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters beta = combination @ x of structural parameters x.

    x holds the 10 n standard inertial parameters and the n rotor inertias.  A regressor of beta
    is made of the ``columns`` of the regressor of x.
    """

    columns: np.ndarray  # indices into x, shape (base,)
    combination: np.ndarray  # shape (base, 11 n)

    @property
    def size(self) -> int:
        """Number of base parameters."""
        return len(self.columns)


def find_base_parameters(model: pinocchio.Model) -> BaseParameters:
    """Base parameters of an arm with rotors, by QR of a random regressor.

    Gautier 1991, "Numerical calculation of the base inertial parameters of robots".  A column is
    taken where it does not depend on those before it, from the tip to the base: parameters of the
    last links stay by themselves, as far as they can.
    """
    rng = np.random.default_rng(20211)
    n = model.nv
    motion = [
        rng.uniform(-np.pi, np.pi, (_SAMPLES, n)),
        rng.normal(size=(_SAMPLES, n)),
        rng.normal(size=(_SAMPLES, n)),
    ]
    rotors = motion[2][:, :, None] * np.eye(n)
    regressor = np.concatenate([torque_regressor(model, *motion), rotors], axis=2)
    regressor = regressor.reshape(-1, 11 * n)
    # Rotors last, so that they stand for themselves only where links do not explain them.
    order = np.concatenate([np.arange(10 * n)[::-1], np.arange(10 * n, 11 * n)])
    upper = qr(regressor[:, order], mode='r')[0][: 11 * n]
    chosen = _independent(upper)
    basis = regressor[:, np.sort(order[chosen])]
    columns = np.sort(order[chosen])
    triangle, projected = _reduced(basis, regressor)
    combination = solve_triangular(triangle, projected)
    combination[np.abs(combination) < 1e-9] = 0.0
    return BaseParameters(columns, combination)


def _independent(upper: np.ndarray) -> np.ndarray:
    """Columns of an upper triangular matrix that do not depend on those before them."""
    kept: list[int] = []
    scale = np.linalg.norm(upper, axis=0)
    basis = np.zeros((len(upper), 0))
    for k in range(upper.shape[1]):
        rest = upper[:, k] - basis @ (basis.T @ upper[:, k])
        rest -= basis @ (basis.T @ rest)
        size = np.linalg.norm(rest)
        if size > _TOLERANCE * max(scale[k], 1e-3 * scale.max()):
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return np.array(kept)


def _reduced(basis: np.ndarray, regressor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    orthogonal, triangle = np.linalg.qr(basis)
    return triangle, orthogonal.T @ regressor
