"""Arm files of the form of two-link arms, of versions before there was one kind of arm."""

import math
from dataclasses import dataclass, replace
from typing import Any

from lpv.core.serial_arm.description import RATE_SOURCES, UNSTATED_FRICTION, SerialArm
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.support.config import Section, names_all_errors
from lpv.core.support.entries import entry, positive, read_entries


@dataclass(frozen=True)
class _Link:
    mass: float = positive(1e5)
    length: float = positive(100.0)
    center_of_mass: float = positive(100.0)
    inertia: float = entry('number', low=0.0, high=1e7)


def _pair(low: float, high: float, **details: Any) -> Any:
    """A field of two numbers."""
    return entry('vector', 2, low=low, high=high, **details)


@dataclass(frozen=True, kw_only=True)
class _TwoLinks:
    """The file, with the fields that `two_link_arm` takes."""

    links: tuple[_Link, ...]
    name: str = entry('text')
    gravity: float = entry('number', default=9.81, above=0.0, high=100.0)
    rotor_inertia: float = entry('number', default=0.0, low=0.0, high=1e4, at='rotor.inertia')
    gear_ratio: float = entry('number', default=1.0, above=0.0, high=1e4, at='rotor.gear_ratio')
    viscous: tuple = _pair(0.0, 1e6, default=(0.0, 0.0), at='friction.viscous')
    coulomb: tuple = _pair(0.0, 1e6, default=(0.0, 0.0), at='friction.coulomb')
    slope: float = entry('number', default=100.0, above=0.0, high=1e6, at='friction.coulomb_slope')
    torque_limit: tuple = entry('vector', 2, default=(1e9, 1e9), above=0.0, high=1e9)
    joint_names: tuple = entry('names', 2, at='joints.names')
    zero_angle: float = entry('number', low=-math.pi, high=math.pi, at='joints.zero_angle')
    velocity_limit: tuple = entry(
        'vector', 2, default=(100.0, 100.0), above=0.0, high=1e4, at='joints.velocity_limit'
    )
    sensor_names: tuple = entry('names', 2, at='sensors.names')
    arrangement: str = entry('text', choices=('absolute', 'relative'), at='sensors.arrangement')
    position_noise: float = entry('number', above=0.0, high=10.0, at='sensors.position_noise')
    velocity_noise: float = entry('number', above=0.0, high=1e3, at='sensors.velocity_noise')
    velocity_error: float = entry(
        'number', default=0.0, low=0.0, high=0.5, at='sensors.velocity_error'
    )
    rates: str = entry('text', default='independent', choices=RATE_SOURCES, at='sensors.rates')
    disturbance_direction: tuple = _pair(-1e3, 1e3, at='disturbance.direction')
    disturbance_mean: float = entry('number', low=-1e4, high=1e4, at='disturbance.mean')
    disturbance_variance: float = entry('number', low=0.0, high=1e8, at='disturbance.variance')
    orientation: str = entry('text', choices=('upright', 'hanging'), at='region.orientation')
    cos_min: tuple = _pair(0.01, 0.999, at='region.cos_min')
    model_error: float = entry('number', default=0.0, low=0.0, high=0.5)
    payload: float = entry('number', default=0.0, low=0.0, high=1e4)
    torque_tolerance: tuple = _pair(0.0, 1e9, default=(0.0, 0.0))
    sample_time: float = entry('number', default=0.002, low=1e-5, high=0.1)
    offset = load = (0.0, 0.0)
    friction_error = UNSTATED_FRICTION

    @property
    def coulomb_slope(self) -> tuple[float, float]:
        """Of both joints."""
        return self.slope, self.slope

    @property
    def rotor(self) -> tuple[float, float, float]:
        """Rotor 2 is carried by link 1: R = Ir*[[gr^2+1, -gr], [-gr, gr^2]]."""
        inertia, ratio = self.rotor_inertia, self.gear_ratio
        return inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2


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
    arm = read_entries(_TwoLinks, top, links=_links(top))
    _check_inertia(arm, top)
    return two_link_arm(arm)


def _check_inertia(arm: _TwoLinks, top: Section) -> None:
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


def _links(top: Section) -> tuple[_Link, ...]:
    sections = top.sections('links')
    if len(sections) != 2:
        raise top.error('links', f'must describe exactly two links, got {len(sections)}')
    about = top.text('inertia_reference', 'center_of_mass', ('center_of_mass', 'joint'))
    links = tuple(read_entries(_Link, section) for section in sections)
    if about == 'joint':
        return links
    return tuple(
        replace(link, inertia=link.inertia + link.mass * link.center_of_mass**2) for link in links
    )
