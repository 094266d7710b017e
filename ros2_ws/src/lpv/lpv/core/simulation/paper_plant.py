"""Plants of the paper: the LPV arm of eq. (25), and the arm of eq. (4), without Coriolis terms."""

from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.uio.model.dynamics import acceleration, set_pose
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_scheduling, paper_weights, sinc_box, vertex_matrices
from lpv.core.uio.planar import planar_links


class PaperPlant:
    """Integrates a planar arm as the paper simplifies it.

    Parameters
    ----------
    arm : SerialArm
        The true arm.
    scenario : lpv.core.simulation.scenario.Scenario
        Its plant, payload and polytope.

    Raises
    ------
    ConfigError
        If the arm is not planar.
    """

    def __init__(self, arm: SerialArm, scenario: Any) -> None:
        planar = planar_links(arm)
        planar = planar.with_payload(scenario.payload) if scenario.payload else planar
        self._joints, self._constants = JointMap(planar), planar.constants(False)
        self._box, self._weights = sinc_box(scenario.sinc_min), np.zeros(8)
        self._pose = np.zeros((3, 3))
        self._lower: FloatArray | None = None  # rows of A_i and B_i that give theta''
        if scenario.plant == 'lpv':
            lower = np.dstack(vertex_matrices(self._box, self._constants))[:, 2:]
            self._lower = lower.reshape(8, -1)

    def advance(
        self, motion: FloatArray, torque: FloatArray, push: FloatArray, interval: float, steps: int
    ) -> None:
        """Advance positions and rates, shape (2, n), over an interval [s] in so many steps.

        ``torque`` of the drives and the accelerations ``push`` of a disturbance are held, shape
        (n,) [N m], [rad/s2].
        """
        joints = self._joints
        now = np.append(joints.absolute_position(motion[0]), joints.absolute_velocity(motion[1]))
        forces, pushes = joints.absolute_torque(torque), joints.absolute_velocity(push)

        def slope(x: FloatArray) -> FloatArray:
            rates = np.append(x[2:], pushes)
            rates[2:] += self._acceleration(x, forces)
            return rates

        dt = interval / steps
        for _ in range(steps):
            k_1 = slope(now)
            k_2 = slope(now + 0.5 * dt * k_1)
            k_3 = slope(now + 0.5 * dt * k_2)
            k_4 = slope(now + dt * k_3)
            now = now + dt / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        motion[0], motion[1] = joints.joint_position(now[:2]), joints.joint_velocity(now[2:])

    def _acceleration(self, x: FloatArray, torque: FloatArray) -> FloatArray:
        """theta'' without disturbance, of the LPV plant by eq. (25) [rad/s2]."""
        if self._lower is None:
            set_pose(self._pose, x)
            return np.array(acceleration(self._pose, x[2:], torque, self._constants))
        paper_weights(paper_scheduling(x[0], x[1]), self._box, self._weights)
        return (self._weights @ self._lower).reshape(2, 6) @ np.append(x, torque)
