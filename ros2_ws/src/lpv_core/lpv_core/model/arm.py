"""Description of a two-link arm: what its file says, and the constants that follow."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv_core.support.config import Section, names_all_errors, read_yaml, sha256_of
from lpv_core.support.errors import ConfigError
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

ARM_CONSTANTS = record_type(
    ('inertia', 'f8', (2,)),  # Xi_11 and Xi_22 of eq. (5) [kg m2]
    ('coupling', 'f8'),  # m2 L1 Lc2, the part of Xi_12 that cos(theta1 - theta2) scales [kg m2]
    ('rotor_coupling', 'f8'),  # the constant part of Xi_12 [kg m2]
    ('gravity', 'f8', (2,)),  # G_i: largest gravity torque of each angle [N m]
    ('viscous', 'f8', (2,)),  # joint friction [N m s/rad]
    ('coulomb', 'f8', (2,)),  # joint friction [N m]
    ('coulomb_slope', 'f8'),  # steepness of its sign change [s/rad]
    ('coriolis', 'f8'),  # 1, or 0 without the quadratic term O(theta, theta')
)
"""Constants of eqs. (1)-(3) for compiled functions."""
N_CONSTANTS = 12
"""Numbers in `ARM_CONSTANTS`; each is linear in masses, inertias, payload and friction."""
RATES = ('independent', 'derived', 'none')
"""What the rates of an arm may be."""


@dataclass(frozen=True)
class Link:
    """One link."""

    mass: float  # m_i [kg]
    length: float  # L_i, joint to joint (or to the tip) [m]
    center_of_mass: float  # L_ci, joint to centre of mass [m]
    # I_i [kg m2], about the centre of mass or the joint (``ArmParameters.inertia_reference``)
    inertia: float


@dataclass(frozen=True)
class ArmParameters:
    """A planar two-link arm in a vertical plane, its sensors and its operating region.

    Angles of the model are ABSOLUTE link angles from the upper vertical (paper, Fig. 1);
    ``lpv_core.model.joints`` holds the only conversion to ROS joint coordinates.
    The disturbance enters as in eq. (31).
    """

    name: str  # name of the arm
    links: tuple  # two, of type Link
    # 'center_of_mass' or 'joint': the point that each ``Link.inertia`` refers to
    inertia_reference: str = 'center_of_mass'
    gravity: float = 9.81  # g [m/s2]
    rotor_inertia: float = 0.0  # of the motors [kg m2]; 0 without motors
    gear_ratio: float = 1.0  # of the motors; 1 without motors
    # joint friction, tau = viscous*v + coulomb*(2/pi)*atan(coulomb_slope*v) [N m s]
    viscous: tuple = (0.0, 0.0)
    coulomb: tuple = (0.0, 0.0)  # see viscous [N m]
    coulomb_slope: float = 100.0  # steepness of the Coulomb term [s/rad]
    joint_names: tuple = ('joint1', 'joint2')  # names in ``sensor_msgs/JointState``
    zero_angle: float = -math.pi / 2  # absolute angle of link 1 at joint position q1 = 0 [rad]
    # names of the two physical position sensors; faults are reported under them
    sensor_names: tuple = ('joint1_encoder', 'joint2_encoder')
    # whether a position sensor measures a link's 'absolute' angle or a joint's 'relative' one
    arrangement: str = 'relative'
    position_noise: float = 1e-3  # standard deviation of white sensor noise [rad]
    velocity_noise: float = 1e-2  # the same of rates [rad/s]
    # relative error of the rates (scale, delay); limits of changes grow with it
    velocity_error: float = 0.0
    # whether rates have sensors of their own ('independent'), are computed from the positions
    # ('derived'), or are missing ('none'); see `lpv_core.residual.rate_independence`
    rates: str = 'independent'
    # last two rows of Bd: accelerations of the absolute angles per unit of d
    disturbance_direction: tuple = (0.7, 0.0)
    disturbance_mean: float = 0.2  # of the white disturbance d that the design must live with
    disturbance_variance: float = 0.9  # the same
    model_error: float = 0.0  # relative error of masses and inertias that thresholds must tolerate
    payload: float = 0.0  # largest unknown point mass at the tip that thresholds must tolerate [kg]
    # generalised torques that the model may miss for moments (transmission, ripple) [N m]; only the
    # test of consistency needs them, what lasts belongs to the entries above
    torque_tolerance: tuple = (0.0, 0.0)
    torque_limit: tuple = (1e9, 1e9)  # largest joint torques [N m]
    # largest plausible joint rates [rad/s]; a sample with a larger one is not used
    velocity_limit: tuple = (100.0, 100.0)
    # operating region of both links: cos(theta) > 0 ('upright') or cos(theta) < 0 ('hanging')
    orientation: str = 'upright'
    # smallest abs(cos(theta_i)) of the region in which gains are certified
    cos_min: tuple = (0.3, 0.3)
    sample_time: float = 0.002  # Ts [s]

    @property
    def lengths(self) -> tuple[float, float]:
        """Link lengths (L1, L2) [m]."""
        return self.links[0].length, self.links[1].length

    @property
    def sign(self) -> float:
        """+1 for an upright region, -1 for a hanging one (sign of cos(theta))."""
        return 1.0 if self.orientation == 'upright' else -1.0

    def constants(self, coriolis: bool = True) -> np.record:
        """Constants of eqs. (2)-(3), as compiled functions take them.

        The printed eqs. (5), (14), (15) have m2*Lc1^2 in the (1, 1) inertia; the physics, and
        eq. (2), is m2*L1^2, which is used here.  The rotor terms are those of motors on the
        joint axes, carried over to absolute angles.

        Parameters
        ----------
        coriolis : bool, optional
            Keep the quadratic term O(theta, theta') of eq. (1); the paper drops it in eq. (4).

        Returns
        -------
        numpy.record
            Of type `ARM_CONSTANTS`.
        """
        one, two = self.links
        inertia_1, inertia_2 = one.inertia, two.inertia
        if self.inertia_reference == 'center_of_mass':
            inertia_1 += one.mass * one.center_of_mass**2
            inertia_2 += two.mass * two.center_of_mass**2
        inertia_1 += two.mass * one.length**2
        # J^T R J for R = Ir*[[gr^2+1, -gr], [-gr, gr^2]] in joint coordinates, q' = J theta'.
        ratio, rotor = self.gear_ratio, self.rotor_inertia
        inertia_1 += rotor * (2 * ratio**2 + 2 * ratio + 1)
        inertia_2 += rotor * ratio**2
        moment_1 = one.mass * one.center_of_mass + two.mass * one.length
        return new_record(
            ARM_CONSTANTS,
            inertia=(inertia_1, inertia_2),
            coupling=two.mass * one.length * two.center_of_mass,
            rotor_coupling=-rotor * ratio * (ratio + 1),
            gravity=(moment_1 * self.gravity, two.mass * two.center_of_mass * self.gravity),
            viscous=self.viscous,
            coulomb=self.coulomb,
            coulomb_slope=self.coulomb_slope,
            coriolis=coriolis,
        )

    def with_payload(self, mass: float) -> ArmParameters:
        """Return this arm with a point mass at its tip.

        Parameters
        ----------
        mass : float
            Payload [kg]; a negative one takes away a payload that the model has.

        Returns
        -------
        ArmParameters
            Link 2 with combined mass, centre of mass and inertia.
        """
        if not -self.links[1].mass < mass < math.inf:
            raise ConfigError('payload', f'must be finite and leave link 2 a mass, got {mass}')
        link = self.links[1]
        total = link.mass + mass
        center = (link.mass * link.center_of_mass + mass * link.length) / total
        if self.inertia_reference == 'joint':
            inertia = link.inertia + mass * link.length**2
        else:
            inertia = (
                link.inertia
                + link.mass * (link.center_of_mass - center) ** 2
                + mass * (link.length - center) ** 2
            )
        return replace(self, links=(self.links[0], Link(total, link.length, center, inertia)))

    def scaled(
        self,
        mass_factors: Sequence[float] = (1.0, 1.0),
        inertia_factors: Sequence[float] = (1.0, 1.0),
    ) -> ArmParameters:
        """Return this arm with masses and inertias multiplied (model error).

        Parameters
        ----------
        mass_factors, inertia_factors : sequence of two floats
            Factor per link.

        Returns
        -------
        ArmParameters
            The other arm.
        """
        links = tuple(
            replace(link, mass=link.mass * m, inertia=link.inertia * i)
            for link, m, i in zip(self.links, mass_factors, inertia_factors)
        )
        return replace(self, links=links)

    def is_physical(self) -> bool:
        """Whether Xi is positive definite in every configuration; identified links need not be."""
        values = self.constants()
        coupling = abs(values.rotor_coupling) + values.coupling
        return bool(values.inertia[0] * values.inertia[1] > coupling**2)

    def to_json(self) -> str:
        """All parameters as one line of JSON; `arm_from_json` reads it back exactly."""
        parameters = asdict(self)
        if self.rates == RATES[0]:
            del parameters['rates']  # as written before rates could be stated
        return json.dumps(parameters, sort_keys=True)

    def sha256(self) -> str:
        """Hash of every parameter of the design: gains carry it, so that they fit one arm only."""
        parameters = asdict(self)
        del parameters['rates']
        return sha256_of(parameters)


def constants_vector(constants: np.record) -> np.ndarray:
    """Numbers of `ARM_CONSTANTS` in their order, for what is linear in all of them."""
    return np.concatenate([np.ravel(constants[name]) for name in ARM_CONSTANTS.names or ()])


def vector_slice(name: str) -> slice:
    """Where a field of `ARM_CONSTANTS` is in `constants_vector`."""
    assert ARM_CONSTANTS.fields is not None
    kind, offset = ARM_CONSTANTS.fields[name][:2]
    return slice(offset // 8, (offset + kind.itemsize) // 8)


@njit
def set_constants(constants: np.record, vector: np.ndarray) -> None:
    """Fill a record of type `ARM_CONSTANTS` from `constants_vector`."""
    for i in range(2):
        constants.inertia[i] = vector[i]
        constants.gravity[i] = vector[4 + i]
        constants.viscous[i] = vector[6 + i]
        constants.coulomb[i] = vector[8 + i]
    constants.coupling, constants.rotor_coupling = vector[2], vector[3]
    constants.coulomb_slope, constants.coriolis = vector[10], vector[11]


def arm_from_json(text: str) -> ArmParameters:
    """Arm from `ArmParameters.to_json`.

    Parameters
    ----------
    text : str
        JSON.

    Returns
    -------
    ArmParameters
        The same arm, bit by bit.

    Raises
    ------
    ConfigError
        If it is no such text.
    """
    try:
        data = json.loads(text)
        data['links'] = tuple(Link(**link) for link in data['links'])
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in data.items()
        }
        return ArmParameters(**fields)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigError('arm', f'is not the description of an arm ({error})') from error


def load_arm(path: str | Path) -> ArmParameters:
    """Read an arm file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/arm-file.md`` for its fields.

    Returns
    -------
    ArmParameters
        The validated arm.

    Raises
    ------
    ConfigError
        If a field is missing, unknown, of the wrong type or out of range; it names the field.
    """
    return parse_arm(read_yaml(path), str(Path(path)))


@names_all_errors
def parse_arm(data: dict[str, Any], source: str = 'arm') -> ArmParameters:
    """Build an arm from the mapping of an arm file.

    Parameters
    ----------
    data : dict
        Content of the file.
    source : str, optional
        Name for error messages.

    Returns
    -------
    ArmParameters
        The validated arm.

    Raises
    ------
    ConfigError
        As `load_arm`.
    """
    top = Section(data, source)
    fields: dict[str, Any] = {
        'name': top.text('name'),
        'gravity': top.number('gravity', 9.81, above=0.0, high=100.0),
    }
    fields['inertia_reference'] = top.text(
        'inertia_reference', 'center_of_mass', ('center_of_mass', 'joint')
    )
    fields['links'] = _links(top)
    fields.update(_drive(top))
    fields.update(_joints_and_sensors(top))
    fields.update(_disturbance(top))
    region = top.section('region')
    fields['orientation'] = region.text('orientation', choices=('upright', 'hanging'))
    fields['cos_min'] = region.pair('cos_min', low=0.01, high=0.999)
    region.finish()
    fields['model_error'] = top.number('model_error', 0.0, 0.0, 0.5)
    fields['payload'] = top.number('payload', 0.0, 0.0, 1e4)
    fields['torque_tolerance'] = top.pair('torque_tolerance', 0.0, 0.0, 1e9)
    fields['sample_time'] = top.number('sample_time', 0.002, 1e-5, 0.1)
    top.finish()
    arm = ArmParameters(**fields)
    _check_inertia(arm, top)
    return arm


def _check_inertia(arm: ArmParameters, top: Section) -> None:
    if not arm.is_physical():
        raise top.error(
            'links',
            'give an inertia matrix that is not positive definite in every '
            'configuration (check inertia and inertia_reference)',
        )


def _links(top: Section) -> tuple[Link, Link]:
    sections = top.sections('links')
    if len(sections) != 2:
        raise top.error('links', f'must describe exactly two links, got {len(sections)}')
    links = []
    for section in sections:
        link = Link(
            mass=section.number('mass', above=0.0, high=1e5),
            length=section.number('length', above=0.0, high=100.0),
            center_of_mass=section.number('center_of_mass', above=0.0, high=100.0),
            inertia=section.number('inertia', low=0.0, high=1e7),
        )
        section.finish()
        links.append(link)
    return links[0], links[1]


def _drive(top: Section) -> dict[str, Any]:
    rotor = top.section('rotor', required=False)
    friction = top.section('friction', required=False)
    fields = {
        'rotor_inertia': rotor.number('inertia', 0.0, 0.0, 1e4),
        'gear_ratio': rotor.number('gear_ratio', 1.0, above=0.0, high=1e4),
        'viscous': friction.pair('viscous', 0.0, 0.0, 1e6),
        'coulomb': friction.pair('coulomb', 0.0, 0.0, 1e6),
        'coulomb_slope': friction.number('coulomb_slope', 100.0, above=0.0, high=1e6),
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
        'rates': sensors.text('rates', 'independent', choices=RATES),
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
