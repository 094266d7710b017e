"""Rigid-body regressors of a serial arm, in the frames of its joints."""

import numpy as np
from scipy.linalg import block_diag

from lpv.core.serial_arm.chain import Chain, axis_frame, compile_chain, moved_body, workspace
from lpv.core.serial_arm.description import N_INERTIAL, SerialArm
from lpv.core.serial_arm.dynamics.regressor import regressor
from lpv.core.support.jit import njit

STANDARD = N_INERTIAL + 1
"""Structural parameters of a joint: those of its link, and its rotor."""


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
    model = RigidBody(arm)
    matrix = model.regressor(position, velocity, acceleration)
    rigid = matrix[:, :, : N_INERTIAL * len(arm.joints)] @ arm.inertial_parameters()
    friction = [j.friction.torque(velocity[:, k], rigid[:, k]) for k, j in enumerate(arm.joints)]
    return rigid + acceleration @ model.chain.motor + np.stack(friction, axis=1)
