"""Plants of the paper: the LPV arm of eq. (25), and the arm of eq. (4), without Coriolis terms."""

from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.uio.model.dynamics import acceleration, runge_kutta_step
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import sinc_box, vertex_matrices
from lpv.core.uio.model.state_space import lpv_acceleration
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
        self._vertices: tuple[FloatArray, ...] | None = None
        if scenario.plant == 'lpv':
            box = sinc_box(scenario.sinc_min)
            self._vertices = (*vertex_matrices(box, self._constants), box)

    def advance(
        self, motion: FloatArray, torque: FloatArray, push: FloatArray, interval: float, steps: int
    ) -> None:
        """As `lpv.core.simulation.arm_simulator.Engine.advance`."""
        joints = self._joints
        now = np.append(joints.absolute_position(motion[0]), joints.absolute_velocity(motion[1]))
        forces, pushes = joints.absolute_torque(torque), joints.absolute_velocity(push)

        def slope(x: FloatArray) -> FloatArray:
            rates = np.append(x[2:], pushes)
            rates[2:] += self._acceleration(x, forces)
            return rates

        for _ in range(steps):
            now = runge_kutta_step(slope, now, interval / steps)
        motion[0], motion[1] = joints.joint_position(now[:2]), joints.joint_velocity(now[2:])

    def _acceleration(self, x: FloatArray, torque: FloatArray) -> FloatArray:
        """theta'' without disturbance [rad/s2]."""
        if self._vertices is None:
            return np.array(acceleration(x, x[2:], torque, self._constants))
        result = np.empty(2)
        lpv_acceleration(x, torque, self._vertices, result)
        return result
