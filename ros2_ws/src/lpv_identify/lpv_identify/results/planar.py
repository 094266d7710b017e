"""Two-link arms: to an arm of n joints and back to the two-link file."""

import copy
import math
from pathlib import Path
from typing import Any

import yaml

from lpv_core.model.arm import ArmParameters, parse_arm
from lpv_core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
)


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


def write_planar(data: dict[str, Any], arm: SerialArm, path: Path) -> None:
    """Write a two-link arm file with identified parameters; what was not identified stays.

    ``data`` is the content of the file that was started from.  ConfigError if the parameters are
    none of a two-link file.
    """
    result = copy.deepcopy(data)
    before = parse_arm(data)
    ratio = before.gear_ratio
    inertias = [joint.link.inertia[5] for joint in arm.joints]
    first, second = (joint.rotor_inertia for joint in arm.joints)
    # The file has one rotor for both joints, whose spin couples them; inertias take up the rest.
    rotor = second / (ratio**2 + ratio)
    inertias[0] += inertias[1] + first
    inertias[1] += ratio * rotor
    inertias[0] -= inertias[1] + (ratio**2 + 1.0) * rotor
    result['inertia_reference'] = 'joint'
    result['links'] = [
        _link(joint.link, inertia, length)
        for joint, inertia, length in zip(arm.joints, inertias, before.lengths)
    ]
    result['rotor'] = {'inertia': rotor, 'gear_ratio': ratio}
    frictions = [joint.friction for joint in arm.joints]
    slope = math.sqrt(frictions[0].coulomb_slope * frictions[1].coulomb_slope)
    result['friction'] = {
        'viscous': [max(f.viscous, 0.0) for f in frictions],
        'coulomb': [f.coulomb for f in frictions],
        'coulomb_slope': slope,
    }
    sensors = [joint.sensors for joint in arm.joints]
    result['sensors']['position_noise'] = max(s.position_noise for s in sensors)
    result['sensors']['velocity_noise'] = max(s.velocity_noise for s in sensors)
    result['torque_tolerance'] = [max(joint.torque_tolerance.torque) for joint in arm.joints]
    parse_arm(result, str(path))
    path.write_text(yaml.safe_dump(result, sort_keys=False, width=100), encoding='utf-8')


def _link(link: LinkInertia, inertia: float, length: float) -> dict[str, float]:
    center = math.hypot(*link.first_moment[:2]) / link.mass
    return {'mass': link.mass, 'length': length, 'center_of_mass': center, 'inertia': inertia}
