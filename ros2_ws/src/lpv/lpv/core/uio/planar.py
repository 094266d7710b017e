"""A serial arm of two joints as the planar arm of the paper, and the other way round.

The paper's coordinates: both axes are parallel and horizontal; theta_i is the angle of link i from
the upper vertical, counted as the joints count.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import (
    UNSTATED_FRICTION,
    LpvRegion,
    SerialArm,
    rotation_from_rpy,
)
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.two_links import ArmParameters, Link
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import SAME
from lpv.core.uio.model.joints import J_INVERSE


@lru_cache(maxsize=64)
def planar_model(arm: SerialArm) -> ArmParameters:
    """The planar arm that the LPV design is made for; its inertias refer to the joints' axes.

    Raises
    ------
    ConfigError
        If the arm is not planar in a vertical plane, or states no region; it says what is wrong.
    """
    region = arm.lpv
    if region is None:
        reason = 'is missing: gains are designed for its region, arms without one need none'
        raise ConfigError('lpv', reason, arm.name)
    across, links, first = _geometry(arm)
    sensors = [joint.sensors for joint in arm.joints]
    friction: dict[str, Any] = {
        name: tuple(getattr(joint.friction, name) for joint in arm.joints)
        for name in ('offset', 'viscous', 'coulomb', 'coulomb_slope', 'load')
    }
    one, two = (joint.rotor_inertia for joint in arm.joints)
    stated = arm.uncertainty.model_error
    zero = math.remainder(first - math.pi / 2, 2 * math.pi)
    return ArmParameters(
        name=arm.name,
        links=links,
        gravity=arm.gravity,
        rotor=(one, arm.joints[1].rotor_coupling, two),
        **friction,
        joint_names=arm.joint_names,
        zero_angle=zero + 2 * math.pi if zero <= -math.pi + SAME else zero,  # within (-pi, pi]
        sensor_names=arm.sensor_names,
        arrangement=_arrangement(arm),
        position_noise=max(math.hypot(s.position_noise, s.quantization / 12**0.5) for s in sensors),
        velocity_noise=max(s.velocity_noise for s in sensors),
        rates=sensors[0].rates,
        model_error=priors.MODEL_ERROR if stated is None else stated,
        friction_error=arm.uncertainty.friction or UNSTATED_FRICTION,
        payload=arm.uncertainty.largest_payload,
        torque_tolerance=tuple(max(joint.torque_tolerance.torque) for joint in arm.joints),
        torque_limit=arm.torque_limit,
        velocity_limit=arm.velocity_limit,
        sample_time=arm.sample_time,
        **vars(region),
    )


def _arrangement(arm: SerialArm) -> str:
    """Whether sensors measure absolute or relative angles."""
    matrix = arm.joints_to_sensors()
    for name, expected in (('relative', np.eye(2)), ('absolute', J_INVERSE)):
        if np.array_equal(matrix, expected):
            return name
    raise ConfigError(
        'sensor_matrix', 'must be [[1, 0], [0, 1]] or [[1, 0], [1, 1]] for designed gains', arm.name
    )


def _geometry(arm: SerialArm) -> tuple[FloatArray, tuple[Link, Link], float]:
    """Axis of both joints, links, and angle of link 1 from the horizontal at q = 0 [rad]."""
    if len(arm.joints) != 2:
        raise _not_planar(arm, f'it has {len(arm.joints)} joints')
    if any(joint.is_prismatic for joint in arm.joints):
        raise _not_planar(arm, 'it has a prismatic joint')
    if not arm.gravity > 0.0:
        raise _not_planar(arm, 'no gravity tells its plane')
    frames, origins, frame, origin = [], [], np.eye(3), np.zeros(3)
    for joint in arm.joints:
        origin = origin + frame @ np.array(joint.position)
        frame = frame @ rotation_from_rpy(joint.orientation)
        frames.append(frame)
        origins.append(origin)
    axes = [frame @ np.array(joint.axis) for frame, joint in zip(frames, arm.joints)]
    up = -arm.gravity_vector() / arm.gravity
    if abs(axes[0] @ up) > SAME or np.linalg.norm(axes[0] - axes[1]) > SAME:
        raise _not_planar(arm, 'its axes are not parallel and horizontal')
    forward = np.cross(up, axes[0])
    ends = [origins[1], origins[1] + frames[1] @ np.array(arm.tip)]
    links, angles = [], []
    for joint, frame, begin, end in zip(arm.joints, frames, origins, ends):
        way = end - begin
        along = math.hypot(way @ forward, way @ up)
        if not along > 0.0:
            raise _not_planar(arm, f'the link of {joint.name!r} has no length')
        direction = ((way @ forward) * forward + (way @ up) * up) / along
        moment = frame @ np.array(joint.link.first_moment)
        aside = moment @ np.cross(axes[0], direction)
        if joint.link.mass <= 0.0 or abs(aside) > SAME * joint.link.mass * along:
            raise _not_planar(arm, f'the mass of {joint.name!r} is not on the line of its link')
        inertia = frame @ joint.link.rotational_inertia() @ frame.T
        center = float(moment @ direction) / joint.link.mass
        links.append(Link(joint.link.mass, along, center, float(axes[0] @ inertia @ axes[0])))
        angles.append(math.atan2(way @ up, way @ forward))
    if abs(math.remainder(angles[1] - angles[0], 2 * math.pi)) > SAME:
        raise _not_planar(arm, 'joint 2 does not count from the direction of link 1')
    return axes[0], (links[0], links[1]), angles[0]


def plane_of(arm: SerialArm) -> tuple[FloatArray, FloatArray]:
    """Origin of joint 1, shape (3,), and rows forward and up, shape (2, 3), in the base frame [m];
    ConfigError if the arm is not planar."""
    axis = _geometry(arm)[0]
    up = -arm.gravity_vector() / arm.gravity
    return np.array(arm.joints[0].position), np.stack([np.cross(up, axis), up])


def _not_planar(arm: SerialArm, reason: str) -> ConfigError:
    return ConfigError(
        'lpv', f'is for planar arms of two links: {reason}; others leave it out', arm.name
    )


def is_planar(arm: SerialArm) -> bool:
    """Whether an arm moves two links in a vertical plane."""
    try:
        _geometry(arm)
    except ConfigError:
        return False
    return True


def planar_links(arm: SerialArm) -> ArmParameters:
    """Geometry and dynamics of an arm with or without a region, for kinematics and drawing;
    ConfigError if it is not planar."""
    region = arm.lpv or LpvRegion('hanging', (0.5, 0.5))
    return planar_model(replace(arm, lpv=region, sensor_matrix=None))
