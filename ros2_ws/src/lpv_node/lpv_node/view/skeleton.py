"""Where the joints and the tip of an arm are, for drawings."""

import numpy as np

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm, rotation_from_rpy
from lpv.core.serial_arm.dynamics.kinematics import joint_frames
from lpv.core.uio.planar import is_planar, plane_of


class Skeleton:
    """Corners of an arm: base, joints, tip; ``reach`` is the length of the stretched arm [m]."""

    def __init__(self, arm: SerialArm) -> None:
        self._chain, self._up = compile_chain(arm), rotation_from_rpy(arm.base_orientation)
        steps = [*self._chain.translation, self._chain.tip_translation]
        slides = [np.abs(joint.range).max() for joint in arm.joints if joint.is_prismatic]
        self.reach = max(0.1, float(np.linalg.norm(steps, axis=1).sum() + sum(slides)))
        self._plane = plane_of(arm) if is_planar(arm) else None

    def corners(self, q: list[float]) -> np.ndarray:
        """Positions of base, joints and tip at joint positions [rad], shape (k, 3), z up [m]."""
        count = len(q) + 1
        rotations, origins = np.empty((count, 3, 3)), np.empty((count, 3))
        joint_frames(self._chain, np.array(q), rotations, origins)
        return np.vstack([np.zeros((1, 3)), origins])

    def drawn(self, points: np.ndarray) -> np.ndarray:
        """Base-frame points as drawn: forward and up of a planar arm, else x, y, z up [m]."""
        if self._plane is None:
            return np.asarray(points @ self._up.T)
        origin, rows = self._plane
        return np.asarray((points - origin) @ rows.T)
