"""Arms of two links in a vertical plane from the numbers that describe one in the plane."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from lpv.core.serial_arm.description import (
    RATE_SOURCES,
    UNSTATED_FRICTION,
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    LpvRegion,
    SerialArm,
    SerialJoint,
    TorqueTolerance,
    Uncertainty,
)
from lpv.core.support.config import sha256_of
from lpv.core.support.entries import entry, positive
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import NumberType
from lpv.core.support.records import new_record, record_type


def _pair(low: float, high: float, **details: Any) -> Any:
    """A field of two numbers."""
    return entry('vector', 2, low=low, high=high, **details)


@dataclass(frozen=True)
class Link:
    """One link."""

    mass: float = positive(1e5)  # m_i [kg]
    length: float = positive(100.0)  # L_i, joint to joint (or to the tip) [m]
    center_of_mass: float = positive(100.0)  # L_ci, joint to centre of mass [m]
    inertia: float = entry('number', low=0.0, high=1e7)  # I_i, about the joint [kg m2]


class ArmNumbers(NamedTuple):
    """Constants of eqs. (1)-(3) that links and rotors make, in numbers of any kind."""

    inertia: tuple[Any, Any]  # Xi_11 and Xi_22 of eq. (5) [kg m2]
    coupling: Any  # m2 L1 Lc2, the part of Xi_12 that cos(theta1 - theta2) scales [kg m2]
    rotor_coupling: Any  # the constant part of Xi_12 [kg m2]
    gravity: tuple[Any, Any]  # G_i: largest gravity torque of each angle [N m]


ARM_CONSTANTS = record_type(
    # Of links and rotors, see `ArmNumbers`:
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
class ArmParameters(LpvRegion):
    """A planar two-link arm in the paper's symbols, its sensors and its operating region.

    Angles are ABSOLUTE link angles from the upper vertical (paper, Fig. 1);
    ``lpv.core.uio.model.joints`` holds the only conversion to ROS joint coordinates.  Entries are
    those of arm files of the form before there was one kind of arm.
    """

    name: str = entry('text')  # name of the arm
    links: tuple[Link, ...]  # two
    gravity: float = entry('number', default=9.81, above=0.0, high=100.0)  # g [m/s2]
    # rotors: inertia reflected to joint 1, coupling of both joints, inertia reflected to joint 2,
    # in joint coordinates [kg m2]
    rotor: tuple = (0.0, 0.0, 0.0)
    offset: tuple = (0.0, 0.0)  # constant part of the joint friction [N m]
    # joint friction, see `lpv.core.serial_arm.description.JointFriction` [N m s]
    viscous: tuple = _pair(0.0, 1e6, default=(0.0, 0.0), at='friction.viscous')
    # see viscous [N m]
    coulomb: tuple = _pair(0.0, 1e6, default=(0.0, 0.0), at='friction.coulomb')
    coulomb_slope: tuple = (100.0, 100.0)  # see viscous [s/rad]
    load: tuple = (0.0, 0.0)  # see viscous [N m per N m]
    # largest joint torques [N m]
    torque_limit: tuple = entry('vector', 2, default=(1e9, 1e9), above=0.0, high=1e9)
    joint_names: tuple = entry('names', 2, at='joints.names')  # in ``sensor_msgs/JointState``
    # absolute angle of link 1 at joint position q1 = 0 [rad]
    zero_angle: float = entry('number', low=-math.pi, high=math.pi, at='joints.zero_angle')
    # largest plausible joint rates [rad/s]; a sample with a larger one is not used
    velocity_limit: tuple = entry(
        'vector', 2, default=(100.0, 100.0), above=0.0, high=1e4, at='joints.velocity_limit'
    )
    # names of the two physical position sensors; faults are reported under them
    sensor_names: tuple = entry('names', 2, at='sensors.names')
    # whether a position sensor measures a link's 'absolute' angle or a joint's 'relative' one
    arrangement: str = entry('text', choices=('absolute', 'relative'), at='sensors.arrangement')
    # standard deviation of white sensor noise [rad]
    position_noise: float = entry('number', above=0.0, high=10.0, at='sensors.position_noise')
    # the same of rates [rad/s]
    velocity_noise: float = entry('number', above=0.0, high=1e3, at='sensors.velocity_noise')
    # whether rates have sensors of their own ('independent'), are computed from the positions
    # ('derived'), or are missing ('none'); see `lpv.core.serial_arm.rate_independence`
    rates: str = entry('text', default='independent', choices=RATE_SOURCES, at='sensors.rates')
    # relative error of masses and inertias that thresholds must tolerate
    model_error: float = entry('number', low=0.0, high=0.5, default=0.0)
    friction_error: float = UNSTATED_FRICTION  # relative error of Coulomb friction in bounds
    # largest unknown point mass at the tip that thresholds must tolerate [kg]
    payload: float = entry('number', low=0.0, high=1e4, default=0.0)
    # generalised torques that the model may miss for moments (transmission, ripple) [N m]; only the
    # test of consistency needs them, what lasts belongs to the entries above
    torque_tolerance: tuple = _pair(0.0, 1e9, default=(0.0, 0.0))
    sample_time: float = entry('number', low=1e-5, high=0.1, default=0.002)  # Ts [s]

    def numbers(self, number: NumberType = float) -> ArmNumbers:
        """Constants of eqs. (2), (3) as floats, or as exact ``fractions.Fraction``.

        The printed eqs. (5), (14), (15) have m2*Lc1^2 in the (1, 1) inertia; the physics, and
        eq. (2), is m2*L1^2, which is used here.  Rotors are those of motors on the joint axes.
        """
        rows = [(link.mass, link.length, link.center_of_mass, link.inertia) for link in self.links]
        (m_1, l_1, c_1, i_1), (m_2, _, c_2, i_2) = ([number(v) for v in row] for row in rows)
        # J^T R J for R = [[first, across], [across, second]] in joint coordinates, q' = J theta'.
        first, across, second = (number(value) for value in self.rotor)
        g = number(self.gravity)
        return ArmNumbers(
            (i_1 + m_2 * l_1**2 + (first - 2 * across + second), i_2 + second),
            m_2 * l_1 * c_2,
            across - second,
            ((m_1 * c_1 + m_2 * l_1) * g, m_2 * c_2 * g),
        )

    def is_physical(self) -> bool:
        """Whether Xi is positive definite in every configuration; identified links need not be."""
        values = self.numbers()
        coupling = abs(values.rotor_coupling) + values.coupling
        return bool(values.inertia[0] * values.inertia[1] > coupling**2)

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

    def with_payload(self, mass: float) -> 'ArmParameters':
        """This arm with a point mass at its tip [kg]; a negative one takes a payload away."""
        if not -self.links[1].mass < mass < math.inf:
            raise ConfigError('payload', f'must be finite and leave link 2 a mass, got {mass}')
        link = self.links[1]
        total = link.mass + mass
        center = (link.mass * link.center_of_mass + mass * link.length) / total
        inertia = link.inertia + mass * link.length**2
        return replace(self, links=(self.links[0], Link(total, link.length, center, inertia)))

    def scaled(self, masses: Sequence[float], inertias: Sequence[float]) -> 'ArmParameters':
        """This arm with masses and inertias of its links times these factors (model error)."""
        links = tuple(
            replace(link, mass=link.mass * m, inertia=link.inertia * i)
            for link, m, i in zip(self.links, masses, inertias)
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


def two_link_arm(arm: ArmParameters) -> SerialArm:
    """A planar arm as an arm file states it, with the region of the design; the base has x forward
    and z up, axes point along -y."""
    joints = []
    upright = arm.zero_angle + math.pi / 2
    first, coupling, second = arm.rotor
    for i, link in enumerate(arm.links):
        friction = arm.offset[i], arm.viscous[i], arm.coulomb[i], arm.coulomb_slope[i], arm.load[i]
        joints.append(
            SerialJoint(
                name=arm.joint_names[i],
                position=((0.0, arm.links[0].length)[i], 0.0, 0.0),
                orientation=(0.0, (-upright, 0.0)[i], 0.0),
                axis=(0.0, -1.0, 0.0),
                link=LinkInertia(
                    link.mass,
                    (link.mass * link.center_of_mass, 0.0, 0.0),
                    (0.0, 0.0, link.inertia, 0.0, 0.0, link.inertia),
                ),
                friction=JointFriction(*friction),
                rotor_inertia=(first, second)[i],
                rotor_coupling=(0.0, coupling)[i],
                limits=JointLimits(velocity=arm.velocity_limit[i], torque=arm.torque_limit[i]),
                torque_tolerance=TorqueTolerance(torque=(arm.torque_tolerance[i],)),
                sensors=JointSensors(
                    arm.sensor_names[i], arm.position_noise, 0.0, arm.rates, arm.velocity_noise
                ),
            )
        )
    return SerialArm(
        arm.name,
        tuple(joints),
        gravity=arm.gravity,
        tip=(arm.links[1].length, 0.0, 0.0),
        uncertainty=Uncertainty(arm.payload, arm.friction_error, arm.model_error or None),
        sample_time=arm.sample_time,
        sensor_matrix=_ABSOLUTE if arm.arrangement == 'absolute' else None,
        lpv=LpvRegion(**{one.name: getattr(arm, one.name) for one in fields(LpvRegion)}),
    )


_ABSOLUTE = ((1.0, 0.0), (1.0, 1.0))
"""S of sensors that measure the links' absolute angles; the zero is the driver's."""
