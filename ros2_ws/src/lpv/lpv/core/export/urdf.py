"""An arm as a URDF, for RViz, Foxglove and other simulators.

``base_link`` is the arm's base, ``link1`` to ``linkN`` have the frames of the joints that move
them, ``tip`` is the reference point of a payload.
"""

import math
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import SerialArm, SerialJoint
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import LARGEST

BASE, TIP = 'base_link', 'tip'
"""Names of the URDF's first and last link."""
_COLOURS = ('0.27 0.47 0.67 1', '0.40 0.60 0.80 1')
"""Colours of the links, in turn: red, green, blue, alpha."""
_SLENDER = 1e-3
"""Least inertia about an axis over the largest: that of a rod 40 times as long as thick."""
_ROUNDED = 1e-12
"""Share of the inertia about the joint that counts as none about the centre of mass."""
_THICKNESS = 0.04
"""Radius of the drawn links, over their mean length."""


def link_names(arm: SerialArm) -> list[str]:
    """Names of the URDF's links from the base to the tip."""
    return [BASE, *(f'link{i + 1}' for i in range(len(arm.joints))), TIP]


def arm_urdf(arm: SerialArm, inertial: bool = True) -> str:
    """URDF of an arm; links are drawn as cylinders from joint to joint.

    Friction goes into ``dynamics``; rotor inertia has no place in a URDF and is left out.

    ``inertial`` writes masses and inertias, which pictures do not need.  ConfigError if an inertia
    about a centre of mass is negative: identified parameters need not be, but a URDF cannot
    say it.
    """
    robot, names = ElementTree.Element('robot', name=arm.name), link_names(arm)
    for i, colour in enumerate(_COLOURS):
        material = _add_element(robot, 'material', name=f'colour{i + 1}')
        _add_element(material, 'color', rgba=colour)
    ends = [np.array(joint.position) for joint in arm.joints] + [np.array(arm.tip)]
    radius = _THICKNESS * float(np.mean([np.linalg.norm(end) for end in ends]) or 1.0)
    for i, name in enumerate(names[:-1]):
        link = _add_element(robot, 'link', name=name)
        if i > 0 and inertial:
            _inertial(link, arm, i - 1)
        colour = f'colour{1 + i % len(_COLOURS)}'
        axis = np.array(arm.joints[max(i - 1, 0)].axis)
        _cylinder(link, colour, 1.4 * radius, 0.0 * axis, 2.6 * radius * axis)
        if np.linalg.norm(ends[i]) > 0.0:
            _cylinder(link, colour, radius, 0.5 * ends[i], ends[i])
    _add_element(robot, 'link', name=TIP)
    for i, joint in enumerate(arm.joints):
        _joint(robot, joint, names[i], names[i + 1])
    fixed = _add_element(robot, 'joint', name='tip_joint', type='fixed')
    _ends(fixed, names[-2], TIP)
    _origin(fixed, arm.tip)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding='unicode') + '\n'


def _inertial(link: ElementTree.Element, arm: SerialArm, index: int) -> None:
    described = arm.joints[index].link
    if described.mass == 0.0:
        return
    values, axes = np.linalg.eigh(described.about_center())
    # A mass point has none, but what rounding leaves.
    values[np.abs(values) <= _ROUNDED * np.trace(described.rotational_inertia())] = 0.0
    if values[1] < 0.0:
        raise ConfigError(
            f'joints[{index}].link.inertia',
            'is negative about the centre of mass '
            f'({values.min():.4g} kg m2): a URDF cannot express that',
            arm.name,
        )
    inertia = axes @ np.diag(np.maximum(values, _SLENDER * values[2])) @ axes.T
    element = _add_element(link, 'inertial')
    _origin(element, described.center())
    _add_element(element, 'mass', value=described.mass)
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia
    _add_element(element, 'inertia', ixx=ixx, iyy=iyy, izz=izz, ixy=ixy, ixz=ixz, iyz=iyz)


def _cylinder(
    link: ElementTree.Element, material: str, radius: float, middle: FloatArray, along: FloatArray
) -> None:
    """A visual around a middle, along a vector of its length."""
    length = float(np.linalg.norm(along))
    yaw, pitch = math.atan2(along[1], along[0]), math.acos(along[2] / length)
    visual = _add_element(link, 'visual')
    _origin(visual, middle, (0.0, pitch, yaw))
    geometry = _add_element(visual, 'geometry')
    _add_element(geometry, 'cylinder', radius=radius, length=length)
    _add_element(visual, 'material', name=material)


def _joint(robot: ElementTree.Element, joint: SerialJoint, parent: str, child: str) -> None:
    limits = joint.limits
    kind = 'continuous' if joint.is_endless else joint.type
    element = _add_element(robot, 'joint', name=joint.name, type=kind)
    _ends(element, parent, child)
    _origin(element, joint.position, joint.orientation)
    _add_element(element, 'axis', xyz=joint.axis)
    values = {'effort': min(limits.torque, LARGEST), 'velocity': limits.velocity}
    if not joint.is_endless:  # what is left out is 0 to readers
        values |= {'lower': max(limits.lower, -LARGEST), 'upper': min(limits.upper, LARGEST)}
    if not joint.is_endless or limits.torque < LARGEST:
        _add_element(element, 'limit', **values)
    friction = joint.friction
    _add_element(element, 'dynamics', damping=friction.viscous, friction=friction.coulomb)


def _ends(joint: ElementTree.Element, parent: str, child: str) -> None:
    _add_element(joint, 'parent', link=parent)
    _add_element(joint, 'child', link=child)


def _origin(
    element: ElementTree.Element,
    xyz: Sequence[float] | FloatArray,
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    _add_element(element, 'origin', xyz=xyz, rpy=rpy)


def _add_element(parent: ElementTree.Element, tag: str, **attributes: Any) -> ElementTree.Element:
    """A child element; numbers and sequences of numbers keep every digit."""
    texts = {name: _text(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ' '.join(map(_digits, np.atleast_1d(value)))


def _digits(value: float) -> str:
    return repr(float(value)) if value else '0'
