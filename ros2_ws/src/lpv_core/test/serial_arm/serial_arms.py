"""Arms that are simulated in the tests."""

from dataclasses import replace

import numpy as np

from lpv_core.serial_arm.chain import Chain, compile_chain
from lpv_core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
    Uncertainty,
)

LENGTH = 0.4


def shoulder_arm(rates: str = 'derived') -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    turned = (np.pi / 2, 0.0, 0.0)
    places = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.2), turned),
              ((LENGTH, 0.0, 0.0), (0.0, 0.0, 0.0))]  # fmt: skip
    masses, limits = (4.0, 5.0, 3.0), (60.0, 80.0, 40.0)
    joints = []
    for i, (place, mass, limit) in enumerate(zip(places, masses, limits)):
        center, inertia = 0.5 * LENGTH, mass * LENGTH**2 / 3.0
        joints.append(SerialJoint(
            f'joint{i + 1}', place[0], place[1], (0.0, 0.0, 1.0),
            LinkInertia(mass, (mass * center, 0.0, 0.0), (0.1, 0.0, inertia, 0.0, 0.0, inertia)),
            JointFriction(viscous=0.3, coulomb=0.3, coulomb_slope=50.0), rotor_inertia=0.05,
            limits=JointLimits(-2.5, 2.5, 2.5, limit),
            sensors=JointSensors(f'encoder{i + 1}', 1e-4, 0.0, rates, 5e-3)))  # fmt: skip
    return SerialArm(
        'shoulder', tuple(joints), tip=(LENGTH, 0.0, 0.0), uncertainty=Uncertainty(0.5, 0.3)
    )


def wrong_plant(arm: SerialArm, seed: int, error: float = 0.05) -> Chain:
    """The same arm with masses, friction and a payload that the model does not know."""
    rng = np.random.default_rng(seed)
    changed = []
    for joint in arm.joints:
        scale = 1.0 + rng.uniform(-error, error)
        link = LinkInertia.from_vector(scale * joint.link.to_vector())
        friction = replace(
            joint.friction,
            viscous=joint.friction.viscous * rng.uniform(0.7, 1.3),
            coulomb=joint.friction.coulomb * rng.uniform(0.7, 1.3),
        )
        changed.append(replace(joint, link=link, friction=friction))
    return compile_chain(replace(arm, joints=tuple(changed)))
