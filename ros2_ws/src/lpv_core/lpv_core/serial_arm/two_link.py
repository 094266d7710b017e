"""The planar two-link arm as a serial chain, in its joint coordinates."""

import math

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.serial_arm.chain import Chain, body_parameters, make_chain
from lpv_core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
)
from lpv_core.support.resources import bringup_file


def two_link_chain(arm: ArmParameters) -> Chain:
    """Chain of a two-link arm; the base has x forward and z up, joints turn about -y.

    Parameters
    ----------
    arm : ArmParameters
        The arm, in ROS joint coordinates (relative angles).

    Returns
    -------
    Chain
        With the arm's rotors and friction.
    """
    # Frames whose z is -y of the base and whose x points along the link at theta = pi/2.
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    angle = arm.zero_angle + math.pi / 2
    c, s = math.cos(angle), math.sin(angle)
    first = upright @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    bodies = []
    for link in arm.links:
        inertia = link.inertia
        if arm.inertia_reference == 'joint':
            inertia -= link.mass * link.center_of_mass**2
        center = (link.center_of_mass, 0.0, 0.0)
        bodies.append(body_parameters(link.mass, center, np.diag([0.0, inertia, inertia])))
    ratio, rotor = arm.gear_ratio, arm.rotor_inertia
    motor = rotor * np.array([[ratio**2 + 1.0, -ratio], [-ratio, ratio**2]])
    friction = [
        [viscous, coulomb, 0.0, 0.0, arm.coulomb_slope]
        for viscous, coulomb in zip(arm.viscous, arm.coulomb)
    ]
    first_length, second_length = arm.lengths
    return make_chain(
        [first, np.eye(3)], [[0.0, 0.0, 0.0], [first_length, 0.0, 0.0]], bodies, motor, friction,
        (0.0, 0.0, -arm.gravity), (np.eye(3), (second_length, 0.0, 0.0)))  # fmt: skip


def serial_from_planar(arm: ArmParameters) -> SerialArm:
    """The two-link arm as a serial arm that moves in its base's x-y plane.

    At q = 0 both links lie along x; the base is turned so that the upper vertical is where
    ``zero_angle`` says.  The coupling of the rotors' spin, gear_ratio times the rotor inertia, is
    left out.
    """
    # Joint angle q1 = theta1 - zero_angle, theta counted counter-clockwise from the vertical.
    upright = math.pi / 2 + arm.zero_angle
    joints = []
    for i, link in enumerate(arm.links):
        inertia = link.inertia
        if arm.inertia_reference == 'center_of_mass':
            inertia += link.mass * link.center_of_mass**2
        joints.append(
            SerialJoint(
                name=arm.joint_names[i],
                position=((0.0, arm.lengths[0])[i], 0.0, 0.0),
                orientation=(0.0, 0.0, (upright, 0.0)[i]),
                axis=(0.0, 0.0, 1.0),
                link=LinkInertia(
                    link.mass,
                    (link.mass * link.center_of_mass, 0.0, 0.0),
                    (0.0, 0.0, inertia, 0.0, 0.0, inertia),
                ),
                friction=JointFriction(0.0, arm.viscous[i], arm.coulomb[i], arm.coulomb_slope),
                rotor_inertia=arm.rotor_inertia * (arm.gear_ratio**2 + (1.0, 0.0)[i]),
                limits=JointLimits(velocity=arm.velocity_limit[i], torque=arm.torque_limit[i]),
                sensors=JointSensors(
                    arm.sensor_names[i], arm.position_noise, 0.0, 'derived', arm.velocity_noise
                ),
            )
        )
    # y of the plane is up: the base's frame is the world's turned about x.
    return SerialArm(
        arm.name,
        tuple(joints),
        base_orientation=(math.pi / 2, 0.0, 0.0),
        gravity=arm.gravity,
        tip=(arm.lengths[1], 0.0, 0.0),
        sample_time=arm.sample_time,
    )


def serial_arm_of(name: str) -> SerialArm:
    """Arm of n joints of an arm file, of two links, too, or of a shipped arm's name."""
    arm = load_any_arm(bringup_file('arms', name))
    return arm if isinstance(arm, SerialArm) else serial_from_planar(arm)
