"""What is known of an arm's parameters before the recording: its URDF, with wide tolerances."""

import numpy as np

from lpv_core.serial_arm.description import SerialArm
from lpv_identify.model.rigid_body import build_model

_RELATIVE = 0.3  # of masses; of the lengths that first moments and inertias go with
_SHARE = 0.02  # of the arm's mass: the least that a link is taken to weigh
LOAD_WIDTH = 0.1
"""Standard deviation of load-dependent friction [N m per N m]."""
_LENGTH = 0.1  # least size of a link [m]


def structural_prior(arm: SerialArm) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of inertial parameters and rotor inertias, each of shape (11 n,).

    10 parameters of each link, then the rotors.  The inertias of the arm's URDF may be rough, or
    missing.
    """
    masses = np.array([joint.link.mass for joint in arm.joints])
    least = max(_SHARE * masses.sum(), 0.1)
    sigma = []
    for i, joint in enumerate(arm.joints):
        mass = max(joint.link.mass, least)
        center = np.linalg.norm(joint.link.first_moment) / mass
        following = arm.joints[i + 1].position if i + 1 < len(arm.joints) else arm.tip
        length = max(_LENGTH, float(center), float(np.linalg.norm(following)))
        sigma += [mass] + [mass * length] * 3 + [mass * length**2] * 6
    rotors = _joint_inertias(arm) + 0.01
    mean = np.concatenate([arm.inertial_parameters(), [j.rotor_inertia for j in arm.joints]])
    return mean, np.concatenate([_RELATIVE * np.array(sigma), rotors])


def _joint_inertias(arm: SerialArm) -> np.ndarray:
    """Largest inertia that each joint may see [kg m2]: all masses behind it, arm stretched."""
    import pinocchio

    model = build_model(arm)
    data = model.createData()
    rng = np.random.default_rng(5)
    seen = [np.diag(pinocchio.crba(model, data, rng.uniform(-3, 3, model.nq))) for _ in range(50)]
    return np.maximum(np.max(seen, axis=0), 0.0)
