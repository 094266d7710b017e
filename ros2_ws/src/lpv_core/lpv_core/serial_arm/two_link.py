"""The planar two-link arm as a serial chain, in its joint coordinates."""

import math

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.chain import Chain, body_parameters, make_chain


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
