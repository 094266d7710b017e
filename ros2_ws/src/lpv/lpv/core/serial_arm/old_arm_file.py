"""Arm files of the form of two-link arms, of versions before there was one kind of arm."""

from dataclasses import dataclass, field, replace
from typing import Any

from lpv.core.serial_arm.description import LpvRegion, SerialArm
from lpv.core.serial_arm.two_links import ArmParameters, Link, two_link_arm
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.errors import each


def _moved(name: str, at: str) -> Any:
    """A field of `LpvRegion`, at another place and without a default."""
    return field(metadata={**LpvRegion.__dataclass_fields__[name].metadata, 'at': at})


@dataclass(frozen=True, kw_only=True)
class _File(ArmParameters):
    """What such a file states otherwise."""

    orientation: str = _moved('orientation', 'region.orientation')
    cos_min: tuple = _moved('cos_min', 'region.cos_min')
    disturbance_direction: tuple = _moved('disturbance_direction', 'disturbance.direction')
    disturbance_mean: float = _moved('disturbance_mean', 'disturbance.mean')
    disturbance_variance: float = _moved('disturbance_variance', 'disturbance.variance')
    velocity_error: float = entry(
        'number', default=0.0, low=0.0, high=0.5, at='sensors.velocity_error'
    )
    rotor_inertia: float = entry('number', default=0.0, low=0.0, high=1e4, at='rotor.inertia')
    gear_ratio: float = entry('number', default=1.0, above=0.0, high=1e4, at='rotor.gear_ratio')
    slope: float = entry('number', default=100.0, above=0.0, high=1e6, at='friction.coulomb_slope')


def parse_two_links(data: dict[str, Any], source: str = 'arm') -> SerialArm:
    """As `lpv.core.serial_arm.arm_file.parse_arm`, of a file of that form."""
    top = Section(data, source)
    file = read_entries(_File, top, links=lambda: _links(top))
    # Rotor 2 is carried by link 1: R = Ir*[[gr^2+1, -gr], [-gr, gr^2]].
    inertia, ratio = file.rotor_inertia, file.gear_ratio
    # Without a rotor 0.0, not -0.0, whose hash is another one.
    rotor = inertia * (ratio**2 + 1.0), 0.0 - inertia * ratio, inertia * ratio**2
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
