"""Arms of two links in a vertical plane from the numbers that describe one in the plane."""

import math
from typing import Any

from lpv.core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    LpvRegion,
    SerialArm,
    SerialJoint,
    TorqueTolerance,
    Uncertainty,
)


def two_link_arm(arm: Any) -> SerialArm:
    """A planar arm as an arm file states it; the base has x forward and z up, axes point along -y.

    Parameters
    ----------
    arm : object
        With the fields of `lpv.core.uio.model.arm.ArmParameters`.

    Returns
    -------
    SerialArm
        With the region of the design.
    """
    joints = []
    upright = arm.zero_angle + math.pi / 2
    first, coupling, second = arm.rotor
    for i, link in enumerate(arm.links):
        friction = arm.offset[i], arm.viscous[i], arm.coulomb[i], arm.coulomb_slope[i], arm.load[i]
        joints.append(
            SerialJoint(
                name=arm.joint_names[i],
                position=((0.0, arm.links[0].length)[i], 0.0, 0.0),
                orientation=(0.0, (-upright, 0.0)[i], 0.0),
                axis=(0.0, -1.0, 0.0),
                link=LinkInertia(
                    link.mass,
                    (link.mass * link.center_of_mass, 0.0, 0.0),
                    (0.0, 0.0, link.inertia, 0.0, 0.0, link.inertia),
                ),
                friction=JointFriction(*friction),
                rotor_inertia=(first, second)[i],
                rotor_coupling=(0.0, coupling)[i],
                limits=JointLimits(velocity=arm.velocity_limit[i], torque=arm.torque_limit[i]),
                torque_tolerance=TorqueTolerance(torque=(arm.torque_tolerance[i],)),
                sensors=JointSensors(
                    arm.sensor_names[i], arm.position_noise, 0.0, arm.rates, arm.velocity_noise
                ),
            )
        )
    return SerialArm(
        arm.name,
        tuple(joints),
        gravity=arm.gravity,
        tip=(arm.links[1].length, 0.0, 0.0),
        uncertainty=Uncertainty(arm.payload, arm.friction_error, arm.model_error or None),
        sample_time=arm.sample_time,
        sensor_matrix=_ABSOLUTE if arm.arrangement == 'absolute' else None,
        lpv=LpvRegion(
            arm.orientation,
            arm.cos_min,
            arm.disturbance_direction,
            arm.disturbance_mean,
            arm.disturbance_variance,
            arm.velocity_error,
        ),
    )


_ABSOLUTE = ((1.0, 0.0), (1.0, 1.0))
"""S of sensors that measure the links' absolute angles; the zero is the driver's."""
