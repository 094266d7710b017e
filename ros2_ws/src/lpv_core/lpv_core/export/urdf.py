"""The arm as a URDF, and where its links are: for RViz, Foxglove and other simulators.

Frames (REP-103): ``base_link`` has z up; the arm moves in its x-z plane, so that x and z are the x
and y of the paper's Figure 1.  Angles count counter-clockwise in that plane, from x to z, which is
a rotation about -y.  The x axis of ``link1`` and ``link2`` points along the link.  Joint 1 carries
the arm's ``zero_angle``: at q1 = 0 link 1 stands at that angle from the upper vertical.
"""

import math
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.support.errors import ConfigError

BASE, LINKS, TIP = 'base_link', ('link1', 'link2'), 'tip'
"""Names of the URDF's links."""
COLOURS = ('0.27 0.47 0.67 1', '0.40 0.60 0.80 1')
"""Default colours of the links: red, green, blue, alpha."""
_SLENDER = 1e-3
"""Inertia about a link's long axis over that across it: the arm file does not know it."""
_UNLIMITED = 1e8
"""Torque limits from here on mean that there is none."""


def frame_angles(arm: ArmParameters, q: np.ndarray) -> np.ndarray:
    """Angles of the two links in the plane of the arm."""
    q = np.asarray(q, float)
    first = q[..., 0] + arm.zero_angle + math.pi / 2
    return np.stack([first, first + q[..., 1]], axis=-1)


def points(arm: ArmParameters, q: np.ndarray) -> np.ndarray:
    """Elbow and tip."""
    angles = frame_angles(arm, q)
    steps = np.array(arm.lengths)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.cumsum(steps, axis=-2)


def transforms(arm: ArmParameters, q: np.ndarray) -> list[tuple[Any, ...]]:
    """Transforms that a robot state publisher would send for one configuration.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    q : array_like, shape (2,)
        Joint positions [rad].

    Returns
    -------
    list of tuple
        ``(parent, child, translation, quaternion)`` from the base to the tip; translations x, y, z
        [m], quaternions x, y, z, w.
    """
    first = float(frame_angles(arm, q)[0])
    return [
        (BASE, LINKS[0], (0.0, 0.0, 0.0), _about_minus_y(first)),
        (LINKS[0], LINKS[1], (arm.links[0].length, 0.0, 0.0), _about_minus_y(float(q[1]))),
        (LINKS[1], TIP, (arm.links[1].length, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
    ]


def _about_minus_y(angle: float) -> tuple[float, float, float, float]:
    return 0.0, -math.sin(angle / 2), 0.0, math.cos(angle / 2)


def arm_urdf(arm: ArmParameters, inertial: bool = True, colours: Sequence[str] = COLOURS) -> str:
    """URDF of an arm.

    Friction goes into ``dynamics``; rotor inertia has no place in a URDF and is left out.  The
    inertia about a link's long axis is not in the arm file and is taken as that of a thin rod.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    inertial : bool, optional
        Whether to write masses and inertias; pictures need none.
    colours : sequence of two str, optional
        Red, green, blue and alpha of the links, each 0 to 1.

    Returns
    -------
    str
        XML.

    Raises
    ------
    ConfigError
        If an inertia about a centre of mass is not positive: identified parameters need not be,
        but a URDF cannot say it.
    """
    robot = ElementTree.Element('robot', name=arm.name)
    for name, colour in zip(LINKS, colours):
        material = ElementTree.SubElement(robot, 'material', name=f'{name}_colour')
        ElementTree.SubElement(material, 'color', rgba=colour)
    radius = 0.04 * sum(arm.lengths) / 2
    base = ElementTree.SubElement(robot, 'link', name=BASE)
    _cylinder(base, 'link1_colour', 1.6 * radius, 3.0 * radius, xyz=(0.0, 0.0, 0.0), pitch=False)
    for i, name in enumerate(LINKS):
        _link(robot, name, arm, i, radius, inertial)
    ElementTree.SubElement(robot, 'link', name=TIP)
    _joint(robot, arm, 0, BASE, LINKS[0], (0.0, 0.0, 0.0), -(arm.zero_angle + math.pi / 2))
    _joint(robot, arm, 1, LINKS[0], LINKS[1], (arm.links[0].length, 0.0, 0.0), 0.0)
    fixed = ElementTree.SubElement(robot, 'joint', name='tip_joint', type='fixed')
    _ends(fixed, LINKS[1], TIP)
    _origin(fixed, (arm.links[1].length, 0.0, 0.0))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding='unicode') + '\n'


def _link(
    robot: ElementTree.Element,
    name: str,
    arm: ArmParameters,
    index: int,
    radius: float,
    inertial: bool,
) -> None:
    link = ElementTree.SubElement(robot, 'link', name=name)
    if inertial:
        _inertial(link, arm, index)
    length = arm.links[index].length
    _cylinder(link, f'{name}_colour', radius, length, xyz=(length / 2, 0.0, 0.0), pitch=True)
    _cylinder(link, f'{name}_colour', 1.4 * radius, 2.6 * radius, (0.0, 0.0, 0.0), pitch=False)


def _inertial(link: ElementTree.Element, arm: ArmParameters, index: int) -> None:
    described = arm.links[index]
    inertia = described.inertia
    if arm.inertia_reference == 'joint':
        inertia -= described.mass * described.center_of_mass**2
    if inertia <= 0.0:
        raise ConfigError(
            f'links[{index}].inertia',
            'is not positive about the centre of mass '
            f'({inertia:.4g} kg m2): a URDF cannot express that',
            arm.name,
        )
    element = ElementTree.SubElement(link, 'inertial')
    _origin(element, (described.center_of_mass, 0.0, 0.0))
    ElementTree.SubElement(element, 'mass', value=_text(described.mass))
    ElementTree.SubElement(
        element,
        'inertia',
        ixx=_text(_SLENDER * inertia),
        iyy=_text(inertia),
        izz=_text(inertia),
        ixy='0',
        ixz='0',
        iyz='0',
    )


def _cylinder(
    link: ElementTree.Element,
    material: str,
    radius: float,
    length: float,
    xyz: Sequence[float],
    pitch: bool,
) -> None:
    """A visual along x (``pitch``), or along the joint axis y."""
    visual = ElementTree.SubElement(link, 'visual')
    _origin(visual, xyz, (0.0, math.pi / 2, 0.0) if pitch else (math.pi / 2, 0.0, 0.0))
    geometry = ElementTree.SubElement(visual, 'geometry')
    ElementTree.SubElement(geometry, 'cylinder', radius=_text(radius), length=_text(length))
    ElementTree.SubElement(visual, 'material', name=material)


def _joint(
    robot: ElementTree.Element,
    arm: ArmParameters,
    index: int,
    parent: str,
    child: str,
    xyz: Sequence[float],
    pitch: float,
) -> None:
    joint = ElementTree.SubElement(robot, 'joint', name=arm.joint_names[index], type='continuous')
    _ends(joint, parent, child)
    _origin(joint, xyz, (0.0, pitch, 0.0))
    ElementTree.SubElement(joint, 'axis', xyz='0 -1 0')
    if arm.torque_limit[index] < _UNLIMITED:
        ElementTree.SubElement(
            joint,
            'limit',
            effort=_text(arm.torque_limit[index]),
            velocity=_text(arm.velocity_limit[index]),
        )
    ElementTree.SubElement(
        joint, 'dynamics', damping=_text(arm.viscous[index]), friction=_text(arm.coulomb[index])
    )


def _ends(joint: ElementTree.Element, parent: str, child: str) -> None:
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)


def _origin(
    element: ElementTree.Element, xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)
) -> None:
    ElementTree.SubElement(
        element, 'origin', xyz=' '.join(map(_text, xyz)), rpy=' '.join(map(_text, rpy))
    )


def _text(value: float) -> str:
    return repr(float(value)) if value else '0'
