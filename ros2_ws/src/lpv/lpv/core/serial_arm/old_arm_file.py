"""Arm files of the form of two-link arms, of versions before there was one kind of arm."""

from dataclasses import dataclass, replace
from typing import Any

from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.two_links import ArmParameters, Link, two_link_arm
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.errors import each


@dataclass(frozen=True, kw_only=True)
class _File(ArmParameters):
    """What such a file states otherwise."""

    orientation: str = entry('text', choices=('upright', 'hanging'), at='region.orientation')
    cos_min: tuple = entry('vector', 2, low=0.01, high=0.999, at='region.cos_min')
    disturbance_direction: tuple = entry(
        'vector', 2, low=-1e3, high=1e3, at='disturbance.direction'
    )
    disturbance_mean: float = entry('number', low=-1e4, high=1e4, at='disturbance.mean')
    disturbance_variance: float = entry('number', low=0.0, high=1e8, at='disturbance.variance')
    velocity_error: float = entry(
        'number', default=0.0, low=0.0, high=0.5, at='sensors.velocity_error'
    )
    rotor_inertia: float = entry('number', default=0.0, low=0.0, high=1e4, at='rotor.inertia')
    gear_ratio: float = entry('number', default=1.0, above=0.0, high=1e4, at='rotor.gear_ratio')
    slope: float = entry('number', default=100.0, above=0.0, high=1e6, at='friction.coulomb_slope')


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
    file = read_entries(_File, top, links=lambda: _links(top))
    # Rotor 2 is carried by link 1: R = Ir*[[gr^2+1, -gr], [-gr, gr^2]].
    inertia, ratio = file.rotor_inertia, file.gear_ratio
    rotor = inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2
    arm = replace(file, rotor=rotor, coulomb_slope=(file.slope, file.slope))
    if not arm.is_physical():
        raise top.error(
            'links',
            'give an inertia matrix that is not positive definite in every '
            'configuration (check inertia and inertia_reference)',
        )
    return two_link_arm(arm)


def _links(top: Section) -> tuple[Link, ...]:
    sections = top.sections('links')
    if len(sections) != 2:
        raise top.error('links', f'must describe exactly two links, got {len(sections)}')
    about = top.text('inertia_reference', 'center_of_mass', ('center_of_mass', 'joint'))
    links = each(lambda section: read_entries(Link, section), sections)
    if about == 'joint':
        return links
    return tuple(
        replace(link, inertia=link.inertia + link.mass * link.center_of_mass**2) for link in links
    )
