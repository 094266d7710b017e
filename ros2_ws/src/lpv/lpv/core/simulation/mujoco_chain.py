"""A serial arm in MuJoCo: a plant with independent dynamics and integration."""

from types import ModuleType
from typing import Any

import numpy as np

from lpv.core.export.mjcf import chain_mjcf
from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.support.errors import LpvError

REQUIREMENT = 'mujoco>=3.3.1,<4'
"""What pip installs; armatures of tendons are younger than version 3.3."""


class MujocoChain:
    """Integrates a serial arm with MuJoCo.

    Gravity, inertia, Coriolis terms, rotors and the Runge-Kutta steps are MuJoCo's.  The friction
    of the arm file, which MJCF cannot express, enters at every stage of a step through MuJoCo's
    call for user-defined passive forces.

    Parameters
    ----------
    chain : Chain
        The true arm.

    Raises
    ------
    LpvError
        If MuJoCo is not installed, or refuses the arm.
    """

    def __init__(self, chain: Chain) -> None:
        self._mujoco = load_mujoco()
        try:
            self._model = self._mujoco.MjModel.from_xml_string(chain_mjcf(chain))
        except ValueError as error:
            raise LpvError(
                'MuJoCo does not take the arm: ' + ' '.join(str(error).split())
            ) from error
        self._data = self._mujoco.MjData(self._model)
        self._chain = chain
        self._friction = np.zeros(len(chain.translation))
        self._torque, self._push, self._forces = np.zeros((3, len(chain.translation)))

    def advance(
        self, motion: FloatArray, torque: FloatArray, push: FloatArray, interval: float, steps: int
    ) -> None:
        """As `lpv.core.simulation.arm_simulator.Engine.advance`."""
        data = self._data
        data.qpos[:], data.qvel[:] = motion
        data.qfrc_applied[:] = self._torque[:] = torque
        self._push[:] = push
        self._model.opt.timestep = interval / steps
        # The call is one for the whole process: it is put back for other users of MuJoCo.
        before = self._mujoco.get_mjcb_passive()
        self._mujoco.set_mjcb_passive(self._add_friction)
        try:
            self._mujoco.mj_step(self._model, data, steps)
        finally:
            self._mujoco.set_mjcb_passive(before)
        motion[0], motion[1] = data.qpos, data.qvel

    def _add_friction(self, model: Any, data: Any) -> None:
        rates = np.array(data.qvel)
        friction_torque(self._chain, rates, self._torque, self._friction)
        data.qfrc_passive -= self._friction
        if self._push.any():
            self._mujoco.mj_mulM(model, data, self._forces, self._push)
            data.qfrc_passive += self._forces


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
