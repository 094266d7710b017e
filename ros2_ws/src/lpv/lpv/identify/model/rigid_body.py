"""Rigid-body regressors of a serial arm, and the parameters that its motion can determine."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, qr, solve_triangular

from lpv.core.serial_arm.chain import Chain, axis_frame, compile_chain, moved_body, workspace
from lpv.core.serial_arm.description import N_INERTIAL, SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.regressor import regressor
from lpv.core.support.jit import njit

STANDARD = N_INERTIAL + 1
"""Structural parameters of a joint: those of its link, and its rotor."""
_SAMPLES = 300  # random states; each has n rows, so that ten parameters a link are overdetermined
_TOLERANCE = 1e-8  # relative size of a column that depends on others: rounding is 1e-16


class RigidBody:
    """Links and rotors of an arm; structural parameters x are those of all links, then rotors."""

    def __init__(self, arm: SerialArm):
        self.chain, self.n = compile_chain(arm), len(arm.joints)
        # The chain's frames are the joints', turned so that z is the axis.
        turns = [axis_frame(np.array(joint.axis)).T for joint in arm.joints]
        self._turned = block_diag(*(
            np.stack([moved_body(unit, turn, np.zeros(3)) for unit in np.eye(N_INERTIAL)], axis=1)
            for turn in turns
        ))  # fmt: skip

    def regressor(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        acceleration: np.ndarray,
        gravity: np.ndarray | None = None,
    ) -> np.ndarray:
        """Y of tau = Y(q, v, a) x, shape (samples, n, 11 n), in SI units."""
        motion = np.broadcast_arrays(position, velocity, acceleration)
        chain = self.chain if gravity is None else self.chain._replace(gravity=gravity)
        links = np.empty((len(motion[0]), self.n, N_INERTIAL * self.n))
        _fill(chain, *(np.ascontiguousarray(one, float) for one in motion), workspace(chain), links)
        rigid = (links.reshape(-1, links.shape[2]) @ self._turned).reshape(links.shape)
        return np.concatenate([rigid, motion[2][:, :, None] * np.eye(self.n)], axis=2)


@njit
def _fill(
    chain: Chain,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    work: np.ndarray,
    links: np.ndarray,
) -> None:
    for k in range(len(position)):
        regressor(chain, position[k], velocity[k], acceleration[k], work, links[k])


def joint_torques(
    arm: SerialArm, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Torques of a motion [rad], [rad/s], [rad/s2], friction included, (samples, n) [N m]."""
    return SerialModel(compile_chain(arm)).torque(position, velocity, acceleration)


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
    columns = np.sort(order[independent(qr(regressor[:, order], mode='r')[0])])
    orthogonal, triangle = np.linalg.qr(regressor[:, columns])
    combination = solve_triangular(triangle, orthogonal.T @ regressor)
    combination[np.abs(combination) < 1e-9] = 0.0
    return BaseParameters(columns, combination)


def independent(upper: np.ndarray) -> list[int]:
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
