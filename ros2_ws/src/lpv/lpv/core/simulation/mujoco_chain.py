"""A serial arm in MuJoCo: a plant with independent dynamics and integration."""

from types import ModuleType
from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.description import LinkInertia
from lpv.core.serial_arm.dynamics.friction import drive_friction
from lpv.core.support.errors import ConfigError, LpvError

REQUIREMENT = 'mujoco>=3.3.1,<4'
"""What pip installs; armatures of tendons are younger than version 3.3."""
_THINNEST = 1e-9
"""Least moment of inertia of a link, over the sum of all three: MuJoCo takes no ideal rods."""


class MujocoChain:
    """Integrates a serial arm with MuJoCo.

    Gravity, inertia, Coriolis terms, rotors and the Runge-Kutta steps are MuJoCo's.  The friction
    of the arm file, which MuJoCo cannot express, enters at every stage of a step through MuJoCo's
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
            self._model = chain_model(self._mujoco, chain)
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
        """As `lpv.core.simulation.paper_plant.PaperPlant.advance`."""
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
        drive_friction(self._chain, rates, self._torque, self._friction)
        data.qfrc_passive -= self._friction
        if self._push.any():
            self._mujoco.mj_mulM(model, data, self._forces, self._push)
            data.qfrc_passive += self._forces


def chain_model(mujoco: ModuleType, chain: Chain) -> Any:
    """A serial arm as MuJoCo's model, without friction, drives, contacts and shapes.

    World frame: the base frame of the arm.  Joint positions are those of the arm.  ConfigError if
    a link has no mass, or a rotor that couples joints no inertia.
    """
    armature, rotors = _rotors(chain)
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = chain.gravity
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    kinds = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    body = spec.worldbody
    for i, place in enumerate(chain.translation):
        link = LinkInertia.from_vector(chain.inertial[i])
        if not link.mass > 0.0:
            raise ConfigError(f'inertial[{i}]', 'must have a mass for MuJoCo')
        about = link.about_center()
        about += max(_THINNEST * np.trace(about) - np.linalg.eigvalsh(about)[0], 0.0) * np.eye(3)
        turn = np.empty(4)
        mujoco.mju_mat2Quat(turn, chain.rotation[i].ravel())
        body = body.add_body(
            name=f'link{i + 1}',
            pos=place,
            quat=turn,
            explicitinertial=True,
            ipos=link.center(),
            mass=link.mass,
            fullinertia=about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
        )
        kind = kinds[int(chain.prismatic[i])]
        body.add_joint(name=f'joint{i}', type=kind, axis=(0, 0, 1), armature=armature[i])
    for i, inertia, ratio in rotors:
        tendon = spec.add_tendon(armature=inertia)
        tendon.wrap_joint(f'joint{i - 1}', 1.0)
        tendon.wrap_joint(f'joint{i}', -ratio)
    return spec.compile()


def _rotors(chain: Chain) -> tuple[FloatArray, list[tuple[int, float, float]]]:
    """Armatures of the joints; joint, inertia and gear ratio of each rotor that spins with a link.

    Such a rotor turns at q_(i-1)' - r q_i', which is the armature of a tendon.
    """
    armature, rotors = np.diag(chain.motor).copy(), []
    for i in range(1, len(armature)):
        coupling, reflected = chain.motor[i - 1, i], chain.motor[i, i]
        if coupling != 0.0:
            if reflected == 0.0:
                raise ConfigError(f'motor[{i}]', 'must have the inertia of its rotor for MuJoCo')
            rotors.append((i, float(coupling**2 / reflected), float(-reflected / coupling)))
            armature[i - 1] -= coupling**2 / reflected
            armature[i] -= reflected
    return armature, rotors


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
