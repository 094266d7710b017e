"""The arm in MuJoCo: a plant with independent dynamics and integration.

MuJoCo is needed by this module alone, and only when such a plant is made.
"""

import math
from types import ModuleType
from typing import Any

import numpy as np

from lpv_core.export.mjcf import mjcf
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.support.errors import LpvError

REQUIREMENT = 'mujoco>=3.3.1,<4'
"""What pip installs; armatures of tendons are younger than version 3.3."""


class MujocoPlant:
    """Integrates the arm with MuJoCo.

    Gravity, inertia, Coriolis terms, rotors, viscous and dry friction, and the Runge-Kutta steps
    are MuJoCo's.  What MJCF cannot express enters at every stage of a step through MuJoCo's call
    for user-defined passive forces: the arm file's smooth Coulomb friction and the disturbance,
    which is an acceleration of the absolute angles.

    Parameters
    ----------
    arm : ArmParameters
        The true arm.
    coulomb : {'smooth', 'dry'}, optional
        Law of Coulomb friction; see `lpv_core.export.mjcf.COULOMB`.

    Attributes
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        MuJoCo's own.

    Raises
    ------
    LpvError
        If MuJoCo is not installed, or refuses the arm.
    """

    def __init__(self, arm: ArmParameters, coulomb: str = 'smooth') -> None:
        self._mujoco = load_mujoco()
        text = mjcf(arm, coulomb)
        try:
            self.model = self._mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise LpvError(
                f'MuJoCo does not take arm {arm.name!r}: ' + ' '.join(str(error).split())
            ) from error
        self.data = self._mujoco.MjData(self.model)
        self._joints = JointMap(arm)
        smooth = coulomb == 'smooth'
        self._coulomb = np.array(arm.coulomb) * (2.0 / math.pi) if smooth else np.zeros(2)
        self._slope = arm.coulomb_slope
        self._push = np.zeros(2)
        self._forces = np.zeros(2)

    def advance(
        self, state: np.ndarray, torque: np.ndarray, push: np.ndarray, interval: float, steps: int
    ) -> np.ndarray:
        """Integrate with torque and disturbance held.

        Parameters
        ----------
        state : array_like, shape (4,)
            Absolute angles and rates [rad], [rad/s].
        torque : array_like, shape (2,)
            Generalised torques Q of the absolute angles [N m].
        push : array_like, shape (2,)
            Acceleration of the absolute angles by the disturbance [rad/s2].
        interval : float
            Time to advance [s].
        steps : int
            Runge-Kutta steps to do it in.

        Returns
        -------
        ndarray, shape (4,)
            The absolute state after ``interval``.
        """
        joints, data = self._joints, self.data
        data.qpos[:] = joints.joint_position(state[:2])
        data.qvel[:] = joints.joint_velocity(state[2:])
        data.ctrl[:] = joints.joint_torque(torque)
        self._push[:] = joints.joint_velocity(push)
        self.model.opt.timestep = interval / steps
        if self._coulomb.any() or self._push.any():
            self._step_with_passive_forces(steps)
        else:
            self._mujoco.mj_step(self.model, data, steps)
        return np.concatenate(
            [joints.absolute_position(data.qpos), joints.absolute_velocity(data.qvel)]
        )

    def _step_with_passive_forces(self, steps: int) -> None:
        # The call is one for the whole process: it is put back for other users of MuJoCo.
        before = self._mujoco.get_mjcb_passive()
        self._mujoco.set_mjcb_passive(self._add_passive_forces)
        try:
            self._mujoco.mj_step(self.model, self.data, steps)
        finally:
            self._mujoco.set_mjcb_passive(before)

    def _add_passive_forces(self, model: Any, data: Any) -> None:
        self._mujoco.mj_mulM(model, data, self._forces, self._push)
        data.qfrc_passive += self._forces - self._coulomb * np.arctan(self._slope * data.qvel)


def load_mujoco() -> ModuleType:
    """The module; LpvError with what to install where it is missing."""
    try:
        import mujoco
    except ImportError as error:
        raise LpvError(
            'the plant model mujoco needs MuJoCo, which is not part of the set-up: '
            f"pip install '{REQUIREMENT}' ({error})"
        ) from error
    return mujoco
