"""A two-link arm of the paper: the constants that follow from its numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lpv.core.serial_arm.two_links import Link, TwoLinks
from lpv.core.support.config import sha256_of
from lpv.core.support.errors import ConfigError
from lpv.core.support.records import new_record, record_type

ARM_CONSTANTS = record_type(
    # Of links and rotors, see `lpv.core.serial_arm.two_links.ArmNumbers`:
    ('inertia', 'f8', (2,)),
    ('coupling', 'f8'),
    ('rotor_coupling', 'f8'),
    ('gravity', 'f8', (2,)),
    ('offset', 'f8', (2,)),  # joint friction [N m]
    ('viscous', 'f8', (2,)),  # joint friction [N m s/rad]
    ('coulomb', 'f8', (2,)),  # joint friction [N m]
    ('coulomb_slope', 'f8', (2,)),  # steepness of its sign change [s/rad]
    ('load', 'f8', (2,)),  # growth of Coulomb friction with the torque that a gear carries [-]
    ('coriolis', 'f8'),  # 1, or 0 without the quadratic term O(theta, theta')
)
"""Constants of eqs. (1)-(3) for compiled functions."""


@dataclass(frozen=True, kw_only=True)
class ArmParameters(TwoLinks):
    """A planar two-link arm in the paper's symbols.

    Angles of the model are absolute; ``lpv.core.uio.model.joints`` holds the only conversion to ROS
    joint coordinates.
    """

    @property
    def lengths(self) -> tuple[float, float]:
        """Link lengths (L1, L2) [m]."""
        return self.links[0].length, self.links[1].length

    @property
    def sign(self) -> float:
        """+1 for an upright region, -1 for a hanging one (sign of cos(theta))."""
        return 1.0 if self.orientation == 'upright' else -1.0

    def constants(self, coriolis: bool = True) -> np.record:
        """Constants of eqs. (1)-(3) for compiled functions, of type `ARM_CONSTANTS`.

        Without ``coriolis``, the quadratic term O(theta, theta') of eq. (1) is left out, as the
        paper does in eq. (4).
        """
        return new_record(
            ARM_CONSTANTS,
            **self.numbers()._asdict(),
            offset=self.offset,
            viscous=self.viscous,
            coulomb=self.coulomb,
            coulomb_slope=self.coulomb_slope,
            load=self.load,
            coriolis=coriolis,
        )

    def with_payload(self, mass: float) -> ArmParameters:
        """This arm with a point mass at its tip [kg]; a negative one takes a payload away."""
        if not -self.links[1].mass < mass < math.inf:
            raise ConfigError('payload', f'must be finite and leave link 2 a mass, got {mass}')
        link = self.links[1]
        total = link.mass + mass
        center = (link.mass * link.center_of_mass + mass * link.length) / total
        inertia = link.inertia + mass * link.length**2
        return replace(self, links=(self.links[0], Link(total, link.length, center, inertia)))

    def scaled(
        self,
        mass_factors: Sequence[float] = (1.0, 1.0),
        inertia_factors: Sequence[float] = (1.0, 1.0),
    ) -> ArmParameters:
        """This arm with the masses and inertias of its links multiplied (model error)."""
        links = tuple(
            replace(link, mass=link.mass * m, inertia=link.inertia * i)
            for link, m, i in zip(self.links, mass_factors, inertia_factors)
        )
        return replace(self, links=links)

    def to_json(self) -> str:
        """All parameters as one line of JSON; `arm_from_json` reads it back exactly."""
        parameters = self._stated()
        if self.rates != 'independent':
            parameters['rates'] = self.rates
        return json.dumps(parameters, sort_keys=True)

    def sha256(self) -> str:
        """Hash of every parameter of the design: gains carry it, so that they fit one arm only."""
        return sha256_of(self._stated())

    def _stated(self) -> dict[str, Any]:
        """All parameters but the source of rates, as files with the first ones have them: their
        gains stay those of this arm."""
        parameters = {**asdict(self), 'inertia_reference': 'joint'}
        del parameters['rates']
        for name in ('offset', 'load'):
            if not any(parameters[name]):
                del parameters[name]
        if len(set(self.coulomb_slope)) == 1:
            parameters['coulomb_slope'] = self.coulomb_slope[0]
        return parameters


def arm_from_json(text: str) -> ArmParameters:
    """The same arm, bit by bit, from `ArmParameters.to_json`; ConfigError for any other text."""
    try:
        data = json.loads(text)
        if data.pop('inertia_reference') != 'joint':
            raise ValueError('inertias must be about the joints')
        data['links'] = tuple(Link(**link) for link in data['links'])
        for name, value in data.items():
            data[name] = tuple(value) if isinstance(value, list) else value
        if not isinstance(data['coulomb_slope'], tuple):
            data['coulomb_slope'] = (data['coulomb_slope'],) * 2
        return ArmParameters(**data)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigError('arm', f'is not the description of an arm ({error})') from error
