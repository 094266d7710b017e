"""Where the joints and the tip of an arm are, for drawings."""

from pathlib import Path

import numpy as np

from lpv_core.export.urdf import points
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.description import SerialArm, rotation_from_rpy
from lpv_core.serial_arm.dynamics.kinematics import joint_frames
from lpv_core.support.errors import ConfigError

_LARGEST_URDF = 4 << 20
"""Descriptions with more bytes are not read."""


class Skeleton:
    """Corners of an arm: base, joints, tip; ``reach`` is the length of the stretched arm [m]."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        if isinstance(arm, SerialArm):
            self._chain, self._up = compile_chain(arm), rotation_from_rpy(arm.base_orientation)
            steps = [*self._chain.translation, self._chain.tip_translation]
            slides = [np.abs(joint.range).max() for joint in arm.joints if joint.is_prismatic]
            self.reach = max(0.1, float(np.linalg.norm(steps, axis=1).sum() + sum(slides)))
        else:
            self.reach = float(sum(arm.lengths))

    def corners(self, q: list[float]) -> np.ndarray:
        """Positions of base, joints and tip at joint positions [rad].

        Shape (k, 2) of a two-link arm, in its plane, x and up; (k, 3) of others, z up [m].
        """
        if isinstance(self._arm, ArmParameters):
            return np.vstack([np.zeros((1, 2)), points(self._arm, np.array(q))])
        count = len(q) + 1
        rotations, origins = np.empty((count, 3, 3)), np.empty((count, 3))
        joint_frames(self._chain, np.array(q), rotations, origins)
        return np.vstack([np.zeros((1, 3)), origins]) @ self._up.T


def urdf_text(arm: SerialArm, arm_file: str) -> str:
    """The URDF that an arm file names; ConfigError where there is none that can be read."""
    if not arm.urdf:
        raise ConfigError('urdf', 'is not named in the arm file', arm_file)
    path = Path(arm_file).parent / arm.urdf
    try:
        if path.stat().st_size > _LARGEST_URDF:
            raise ConfigError('urdf', f'{path} has more than {_LARGEST_URDF} bytes', arm_file)
        return path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError('urdf', f'cannot be read: {error}', arm_file) from error
