"""The arm as an MJCF model, the file format of MuJoCo.

World frame: x as in the arm's plane, z up (REP-103), so that both joints turn about -y.  Joint
positions of the model are those of ``sensor_msgs/JointState``.  Each link's frame has its x-axis
along the link.
"""

import math
import xml.etree.ElementTree as ElementTree
from typing import Any

from lpv_core.model.arm import ArmParameters
from lpv_core.support.errors import ConfigError

COULOMB = ('smooth', 'dry')
"""Laws of Coulomb friction: the arm file's smooth one, which MJCF cannot express and which is
left out of the model, or MuJoCo's dry friction of the same size."""

_SMALLEST_INERTIA = 1e-12
"""Inertia about the centre of mass, over m Lc^2, of a link that is a point mass: MuJoCo wants
bodies that can turn."""
_WIDTH = 0.04
"""Thickness of the drawn links over their length."""


def mjcf(arm: ArmParameters, coulomb: str = 'smooth') -> str:
    """Write an arm as MJCF.

    The model has the arm's geometry, masses, rotors, viscous friction, torque limits and gravity,
    and no contacts: geoms are there to be looked at.  The rotor of motor 1 turns against the base
    and is the ``armature`` of joint 1; that of motor 2 sits on link 1 and turns at q1' - r q2',
    which is the armature of a tendon with these coefficients.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    coulomb : {'smooth', 'dry'}, optional
        Law of Coulomb friction; see `COULOMB`.

    Returns
    -------
    str
        XML.

    Raises
    ------
    ConfigError
        If a link is no rigid body: its inertia about the centre of mass is negative.
    """
    root = ElementTree.Element('mujoco', model=arm.name)
    add_element(root, 'compiler', angle='radian', autolimits='true')
    # Fourth order like the built-in simulator: a semi-implicit Euler step would have to be a
    # thousand times shorter for the same accuracy.
    option = add_element(
        root,
        'option',
        integrator='RK4',
        timestep=0.5 * arm.sample_time,
        gravity=(0.0, 0.0, -arm.gravity),
    )
    add_element(option, 'flag', contact='disable')
    # q1 = 0 puts link 1 at zero_angle from the vertical, that is pi/2 more from the x-axis.
    half = 0.5 * (arm.zero_angle + 0.5 * math.pi)
    upper = add_element(
        add_element(root, 'worldbody'),
        'body',
        name='link1',
        quat=(math.cos(half), 0.0, -math.sin(half), 0.0),
    )
    _fill_link(upper, arm, 0, coulomb)
    lower = add_element(upper, 'body', name='link2', pos=(arm.links[0].length, 0.0, 0.0))
    _fill_link(lower, arm, 1, coulomb)
    add_element(lower, 'site', name='tip', pos=(arm.links[1].length, 0.0, 0.0))
    _add_drives(root, arm)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def add_element(parent: ElementTree.Element, tag: str, **attributes: Any) -> ElementTree.Element:
    """A child element; numbers keep every digit."""
    return ElementTree.SubElement(
        parent, tag, {name: _text(value) for name, value in attributes.items()}
    )


def _text(value: str | float | tuple[float, ...]) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return ' '.join(repr(float(v)) for v in value)
    return repr(float(value))


def _fill_link(body: ElementTree.Element, arm: ArmParameters, index: int, coulomb: str) -> None:
    link = arm.links[index]
    add_element(
        body,
        'inertial',
        pos=(link.center_of_mass, 0.0, 0.0),
        mass=link.mass,
        diaginertia=(_central_inertia(arm, index),) * 3,
    )
    friction = arm.coulomb[index] if coulomb == 'dry' else 0.0
    # Friction that holds within 10 ms with 1 % of creep; MuJoCo's defaults are softer.
    stiff = (
        {
            'frictionloss': friction,
            'solreffriction': (0.01, 1.0),
            'solimpfriction': (0.99, 0.99, 0.001),
        }
        if friction
        else {}
    )
    add_element(
        body,
        'joint',
        name=arm.joint_names[index],
        type='hinge',
        axis=(0.0, -1.0, 0.0),
        armature=_spinning_inertia(arm) if index == 0 else 0.0,
        damping=arm.viscous[index],
        **stiff,
    )
    add_element(
        body,
        'geom',
        type='capsule',
        size=_WIDTH * link.length,
        fromto=(0.0, 0.0, 0.0, link.length, 0.0, 0.0),
        contype='0',
        conaffinity='0',
    )


def _spinning_inertia(arm: ArmParameters) -> float:
    return arm.rotor_inertia * arm.gear_ratio**2


def _central_inertia(arm: ArmParameters, index: int) -> float:
    link = arm.links[index]
    at_joint = link.mass * link.center_of_mass**2
    inertia = link.inertia
    if arm.inertia_reference == 'joint':
        inertia -= at_joint
    if inertia < 0.0:
        raise ConfigError(
            f'links[{index}].inertia',
            'is negative about the centre of mass '
            f'({inertia:.3g} kg m2): MuJoCo simulates rigid bodies only',
        )
    return max(inertia, _SMALLEST_INERTIA * at_joint)


def _add_drives(root: ElementTree.Element, arm: ArmParameters) -> None:
    first, second = arm.joint_names
    if arm.rotor_inertia:
        tendon = add_element(
            add_element(root, 'tendon'), 'fixed', name='rotor2', armature=arm.rotor_inertia
        )
        add_element(tendon, 'joint', joint=first, coef=1.0)
        add_element(tendon, 'joint', joint=second, coef=-arm.gear_ratio)
    motors = add_element(root, 'actuator')
    for name, limit in zip(arm.joint_names, arm.torque_limit):
        add_element(motors, 'motor', name=name, joint=name, ctrlrange=(-limit, limit))
