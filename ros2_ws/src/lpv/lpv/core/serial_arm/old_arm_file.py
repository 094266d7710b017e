"""Arm files of the form of two-link arms, of versions before there was one kind of arm."""

import math
from types import SimpleNamespace
from typing import Any

from lpv.core.serial_arm.description import RATE_SOURCES, UNSTATED_FRICTION, SerialArm
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.support.config import Section, names_all_errors


@names_all_errors
def parse_two_links(data: dict[str, Any], source: str = 'arm') -> SerialArm:
    """Build an arm from the mapping of an arm file of the form before there was one kind of arm.

    Parameters
    ----------
    data : dict
        Content of the file.
    source : str, optional
        Name for error messages.

    Returns
    -------
    SerialArm
        The validated arm.

    Raises
    ------
    ConfigError
        If a field is missing, unknown, of the wrong type or out of range; it names the field.
    """
    top = Section(data, source)
    fields: dict[str, Any] = {
        'name': top.text('name'),
        'gravity': top.number('gravity', 9.81, above=0.0, high=100.0),
    }
    fields['links'] = _links(top)
    fields.update(_drive(top))
    fields.update(_joints_and_sensors(top))
    fields.update(_disturbance(top))
    region = top.section('region')
    fields['orientation'] = region.text('orientation', choices=('upright', 'hanging'))
    fields['cos_min'] = region.pair('cos_min', low=0.01, high=0.999)
    region.finish()
    fields['model_error'] = top.number('model_error', 0.0, 0.0, 0.5)
    fields['friction_error'] = UNSTATED_FRICTION
    fields['payload'] = top.number('payload', 0.0, 0.0, 1e4)
    fields['torque_tolerance'] = top.pair('torque_tolerance', 0.0, 0.0, 1e9)
    fields['sample_time'] = top.number('sample_time', 0.002, 1e-5, 0.1)
    top.finish()
    arm = SimpleNamespace(**fields)
    _check_inertia(arm, top)
    return two_link_arm(arm)


def _check_inertia(arm: SimpleNamespace, top: Section) -> None:
    """The mass matrix must be positive definite where the links are in line, and so everywhere."""
    one, two = arm.links
    first, across, second = arm.rotor
    inertia_1 = one.inertia + two.mass * one.length**2 + first - 2.0 * across + second
    coupling = abs(across - second) + two.mass * one.length * two.center_of_mass
    if not inertia_1 * (two.inertia + second) > coupling**2:
        raise top.error(
            'links',
            'give an inertia matrix that is not positive definite in every '
            'configuration (check inertia and inertia_reference)',
        )


def _links(top: Section) -> tuple[SimpleNamespace, SimpleNamespace]:
    sections = top.sections('links')
    if len(sections) != 2:
        raise top.error('links', f'must describe exactly two links, got {len(sections)}')
    about = top.text('inertia_reference', 'center_of_mass', ('center_of_mass', 'joint'))
    links = []
    for section in sections:
        link = SimpleNamespace(
            mass=section.number('mass', above=0.0, high=1e5),
            length=section.number('length', above=0.0, high=100.0),
            center_of_mass=section.number('center_of_mass', above=0.0, high=100.0),
            inertia=section.number('inertia', low=0.0, high=1e7),
        )
        if about == 'center_of_mass':
            link.inertia += link.mass * link.center_of_mass**2
        section.finish()
        links.append(link)
    return links[0], links[1]


def _drive(top: Section) -> dict[str, Any]:
    rotor = top.section('rotor', required=False)
    friction = top.section('friction', required=False)
    inertia = rotor.number('inertia', 0.0, 0.0, 1e4)
    ratio = rotor.number('gear_ratio', 1.0, above=0.0, high=1e4)
    fields = {
        # The rotor of joint 2 is carried by link 1: R = Ir*[[gr^2+1, -gr], [-gr, gr^2]].
        'rotor': (inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2),
        'offset': (0.0, 0.0),
        'viscous': friction.pair('viscous', 0.0, 0.0, 1e6),
        'coulomb': friction.pair('coulomb', 0.0, 0.0, 1e6),
        'coulomb_slope': (friction.number('coulomb_slope', 100.0, above=0.0, high=1e6),) * 2,
        'load': (0.0, 0.0),
        'torque_limit': top.pair('torque_limit', 1e9, above=0.0, high=1e9),
    }
    rotor.finish()
    friction.finish()
    return fields


def _joints_and_sensors(top: Section) -> dict[str, Any]:
    joints = top.section('joints')
    sensors = top.section('sensors')
    fields = {
        'joint_names': joints.names('names', 2),
        'zero_angle': joints.number('zero_angle', low=-math.pi, high=math.pi),
        'velocity_limit': joints.pair('velocity_limit', 100.0, above=0.0, high=1e4),
        'sensor_names': sensors.names('names', 2),
        'arrangement': sensors.text('arrangement', choices=('absolute', 'relative')),
        'position_noise': sensors.number('position_noise', above=0.0, high=10.0),
        'velocity_noise': sensors.number('velocity_noise', above=0.0, high=1e3),
        'velocity_error': sensors.number('velocity_error', 0.0, 0.0, 0.5),
        'rates': sensors.text('rates', 'independent', choices=RATE_SOURCES),
    }
    joints.finish()
    sensors.finish()
    return fields


def _disturbance(top: Section) -> dict[str, Any]:
    section = top.section('disturbance')
    fields = {
        'disturbance_direction': section.pair('direction', low=-1e3, high=1e3),
        'disturbance_mean': section.number('mean', low=-1e4, high=1e4),
        'disturbance_variance': section.number('variance', low=0.0, high=1e8),
    }
    section.finish()
    return fields
