"""Joints that turn the same body in some poses, with next to no inertia between them."""

import numpy as np

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel

_POSES = 300
"""Poses that are tried: of two joints that turn as far as they like, each is within 0.04 rad of a
common axis in 3 % of them."""
_SHARE = 1e-3
"""Share of the joints' own inertias that is next to none.  Arms whose links have masses keep six
times as much: 12 of URDFs, of 1 to 10 joints.  Of links that stand for one ball joint 1e-6 is left,
and computed torque leads a simulated arm 7 to 12 rad off its path."""
_TAKES_PART = 0.3
"""Of a joint in the motion with the least inertia, whose length is 1."""


def aligned_axes(arm: SerialArm) -> str:
    """Which joints have next to no inertia between them in a pose, and what to state; or ''."""
    model = SerialModel(compile_chain(arm))
    low, high = np.array([joint.range for joint in arm.joints]).T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    inertia = np.array([model.mass_matrix(q) for q in poses])
    own = np.sqrt(np.einsum('kii->ki', inertia))
    shares, motions = np.linalg.eigh(inertia / (own[:, :, None] * own[:, None, :]))
    worst = int(shares[:, 0].argmin())
    if shares[worst, 0] > _SHARE:
        return ''
    moves = np.abs(motions[worst, :, 0]) > _TAKES_PART
    names = ', '.join(name for name, one in zip(arm.joint_names, moves) if one)
    return (
        f'joints {names} turn the same body in some poses, with next to no inertia between them: '
        'no loop holds them there; state their rotor_inertia'
    )
