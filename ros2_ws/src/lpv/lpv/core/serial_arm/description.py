"""Description of a serial arm of n joints: what its file says.

Units are those of revolute joints: for a prismatic one, read m for rad, N for N m, kg for kg m2.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from lpv.core.support.config import Section, sha256_of
from lpv.core.support.entries import entry, part
from lpv.core.support.limits import FAR, LARGEST, TURN

INERTIA_KEYS = ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')
"""Names of a link's moments and products of inertia in files."""
N_INERTIAL = 10
"""Inertial parameters of a link: mass, 3 first moments, 6 entries of its inertia."""

JOINT_TYPES = ('revolute', 'prismatic')
"""A joint turns about its axis, or moves along it."""
RATE_BIAS = 0.1
"""Bias of a rate sensor, over the standard deviation of its noise."""
UNSTATED_FRICTION = 0.3
"""Relative change of friction of an arm whose file does not state any."""
SIGMAS = 4.0
"""Standard deviations in a bound, unless asked otherwise: 1 in 16 000 normal errors is larger."""
_IDENTIFIED = 0.05
"""How indefinite a pseudo-inertia of unit mass and size may be: a published one is by 0.02."""
RATE_SOURCES = ('independent', 'derived', 'none')
"""Where measured rates come from: a sensor of their own, differences of positions, nowhere."""


@dataclass(frozen=True)
class LinkInertia:
    """Inertial parameters of a link and of all that is fixed to it.

    All refer to the URDF frame of the joint that moves the link (origin on its axis).
    """

    mass: float = entry('number', low=0.0, high=1e5)  # m [kg]
    # m times the centre of mass, (x, y, z) [kg m]
    first_moment: tuple[float, float, float] = entry('vector', 3, low=-1e6, high=1e6)
    # (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about the joint frame's origin [kg m2], the order that
    # Pinocchio uses
    inertia: tuple[float, float, float, float, float, float] = entry(
        'mapping', INERTIA_KEYS, low=-1e7, high=1e7
    )

    def check(self, section: Section) -> None:
        """ConfigError for a link that no body is."""
        if np.diag(self.rotational_inertia()).min() < 0.0:
            raise section.error('inertia', 'must not have a negative moment')

    def to_vector(self) -> np.ndarray:
        """Standard inertial parameters, shape (10,): mass, first moments, inertia."""
        return np.array([self.mass, *self.first_moment, *self.inertia])

    @staticmethod
    def from_vector(values: np.ndarray) -> 'LinkInertia':
        """Inertial parameters from a vector of shape (10,), as `to_vector` gives it."""
        mass, x, y, z, xx, xy, yy, xz, yz, zz = (float(v) for v in values)
        return LinkInertia(mass, (x, y, z), (xx, xy, yy, xz, yz, zz))

    def rotational_inertia(self) -> np.ndarray:
        """Inertia about the joint frame's origin, shape (3, 3) [kg m2]."""
        return inertia_matrix(self.inertia)

    def center(self) -> np.ndarray:
        """Centre of mass, shape (3,) [m]; the origin without a mass."""
        moment = np.array(self.first_moment)
        return moment / self.mass if self.mass != 0.0 else 0.0 * moment

    def about_center(self) -> np.ndarray:
        """Inertia about the centre of mass, shape (3, 3) [kg m2]."""
        c = self.center()
        return self.rotational_inertia() - self.mass * (c @ c * np.eye(3) - np.outer(c, c))

    def pseudo_inertia(self) -> np.ndarray:
        """Second moments of the mass distribution, shape (4, 4).

        Positive semidefinite exactly where some distribution of positive mass has these
        parameters (Wensing, Kim, Slotine 2018, equation 12).
        """
        inertia = self.rotational_inertia()
        result = np.empty((4, 4))
        result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        result[:3, 3] = result[3, :3] = self.first_moment
        result[3, 3] = self.mass
        return result

    @property
    def is_physical(self) -> bool:
        """Whether a body has these parameters, within the errors of identified ones."""
        pseudo, least = self.pseudo_inertia(), float(np.finfo(float).tiny)
        mass = max(self.mass, least)
        length = math.sqrt(max(float(np.trace(pseudo[:3, :3])), least) / mass)
        scale = math.sqrt(mass) * np.array([length, length, length, 1.0])
        return bool(np.linalg.eigvalsh(pseudo / np.outer(scale, scale))[0] > -_IDENTIFIED)


@dataclass(frozen=True)
class JointFriction:
    """Torque that friction takes at joint rate v.

    tau_f = offset + viscous*v + (coulomb + load*abs(tau_rigid))*(2/pi)*atan(coulomb_slope*v), with
    the rigid-body torque tau_rigid of the joint (inertial, Coriolis and gravity torques); where
    that is not known, the measured torque may stand for it.  Where friction falls with speed
    (Stribeck's effect), ``viscous`` is negative; within the velocity limit friction never drives.
    """

    offset: float = entry('number', default=0.0, low=-1e6, high=1e6)  # [N m]
    viscous: float = entry('number', default=0.0, low=-1e6, high=1e6)  # [N m s/rad]
    coulomb: float = entry('number', default=0.0, low=0.0, high=1e6)  # [N m]
    coulomb_slope: float = entry('number', default=100.0, above=0.0, high=1e6)  # [s/rad]
    load: float = entry('number', default=0.0, low=0.0, high=1.0)  # [N m per N m]

    def is_dissipative(self, velocity_limit: float) -> bool:
        """Whether friction brakes at every speed up to the limit [rad/s], the offset apart."""
        speed = np.linspace(0.0, velocity_limit, 65)[1:]
        way = coulomb_direction(speed, self.coulomb_slope)
        slack = 0.05 * self.coulomb + 1e-9
        return bool(np.all(self.viscous * speed + self.coulomb * way >= -slack))


@dataclass(frozen=True)
class JointLimits:
    """What the joint may do."""

    lower: float = entry('number', default=-math.inf, low=-LARGEST, high=LARGEST)  # [rad]
    upper: float = entry('number', default=math.inf, low=-LARGEST, high=LARGEST)  # [rad]
    velocity: float = entry('number', default=100.0, above=0.0, high=1e4)  # [rad/s]
    torque: float = entry('number', default=1e9, above=0.0, high=1e9)  # [N m]

    def check(self, section: Section) -> None:
        """ConfigError where there is no room between the limits."""
        low, high = self.lower, self.upper
        if not low < high and 'upper' in section:
            raise section.error('upper', f'must be above {low}, the lower limit, got {high}')
        if not low < high:
            raise section.error('lower', f'must be below {high}, the upper limit, got {low}')


@dataclass(frozen=True)
class TorqueTolerance:
    """Torque that a healthy arm's model may miss, as a function of the joint's speed.

    Piecewise linear over abs(v), constant beyond both ends.
    """

    # increasing [rad/s]
    speed: tuple[float, ...] = entry('numbers', 64, 0.0, 1e4, default=(0.0,))
    torque: tuple[float, ...] = entry('numbers', 64, 0.0, 1e9, default=(0.0,))  # [N m]

    def check(self, section: Section) -> None:
        """ConfigError where it is no function."""
        if any(b <= a for a, b in zip(self.speed, self.speed[1:])):
            raise section.error('speed', 'must increase')
        if len(self.torque) != len(self.speed):
            wanted, given = len(self.speed), len(self.torque)
            raise section.error('torque', f'must have {wanted} numbers, got {given}')


@dataclass(frozen=True)
class PositionSensor:
    """A position sensor of a joint, as the second one on the link side of an elastic gear."""

    name: str = entry('text')  # name of the position sensor; faults carry it
    # standard deviation per sample, without quantization [rad]
    position_noise: float = entry('number', default=1e-4, above=0.0, high=10.0)
    # step of the positions, 0 if none is known [rad]
    quantization: float = entry('number', default=0.0, low=0.0, high=10.0)


@dataclass(frozen=True)
class JointSensors(PositionSensor):
    """Sensors of one joint."""

    rates: str = entry('text', default='derived', choices=RATE_SOURCES)
    # standard deviation per sample [rad/s]
    velocity_noise: float = entry('number', default=1e-2, above=0.0, high=1e3)
    second_encoder: PositionSensor | None = part(PositionSensor, default=None)


class SensorArrays(NamedTuple):
    """`JointSensors` of all n joints, arrays of shape (n,)."""

    position_noise: np.ndarray  # [rad]
    quantization: np.ndarray  # [rad]
    velocity_noise: np.ndarray  # [rad/s]
    independent: np.ndarray  # whether the rate has a sensor of its own


@dataclass(frozen=True)
class SerialJoint:
    """A joint, the link that it moves, its drive and its sensors.

    At q = 0 the joint's frame stands at ``position`` and ``orientation`` in the frame of the joint
    before it (of the base, for the first one); the joint turns it about ``axis``, or moves it along
    ``axis`` (see `JOINT_TYPES`).
    """

    name: str  # as in sensor_msgs/JointState
    position: tuple[float, float, float]  # of the joint's frame in the one before [m]
    orientation: tuple[float, float, float]  # roll, pitch, yaw, as in URDF [rad]
    axis: tuple[float, float, float]  # unit vector in the joint's frame
    link: LinkInertia
    friction: JointFriction = part(JointFriction, default=JointFriction())
    # reflected to the joint [kg m2]
    rotor_inertia: float = entry('number', default=0.0, low=0.0, high=1e5)
    # of the rotor, if the link before carries it: -rotor_inertia/gear_ratio where the axes of both
    # joints are parallel; couples the joint with the one before it [kg m2]
    rotor_coupling: float = entry('number', default=0.0, low=-1e5, high=1e5)
    # joint torque per unit of the reported effort [N m/unit]
    torque_gain: float = entry('number', default=1.0, low=-1e6, high=1e6)
    # of reported efforts behind the motion [s]
    effort_delay: float = entry('number', default=0.0, low=-1.0, high=1.0)
    limits: JointLimits = JointLimits()
    torque_tolerance: TorqueTolerance = part(TorqueTolerance, default=TorqueTolerance())
    sensors: JointSensors = JointSensors('encoder')
    type: str = entry('text', default='revolute', choices=JOINT_TYPES)

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint moves its link along the axis."""
        return self.type == 'prismatic'

    @property
    def range(self) -> tuple[float, float]:
        """Positions of usual motions [rad]: the limits within half a turn about what is next to 0.

        Of a prismatic joint, the limits, or 1 m where there are none.
        """
        low, high = self.limits.lower, self.limits.upper
        if not self.is_prismatic:
            middle = min(max(low, 0.0), high)
            return max(low, middle - math.pi), min(high, middle + math.pi)
        if math.isinf(low):
            low = high - 1.0 if math.isfinite(high) else -0.5
        return low, low + 1.0 if math.isinf(high) else high

    @property
    def is_endless(self) -> bool:
        """Whether the joint turns without end: revolute, without limits."""
        return not self.is_prismatic and math.isinf(self.limits.upper - self.limits.lower)

    @property
    def scale(self) -> float:
        """What counts as much as 1 rad in thresholds: of a prismatic joint, at most 1 m.

        The whole range of a prismatic joint counts as one turn.
        """
        low, high = self.range
        return min((high - low) / (2.0 * math.pi), 1.0) if self.is_prismatic else 1.0

    @property
    def farthest(self) -> float:
        """Positions beyond are in degrees or mm: a turn past the limits, thirty times those."""
        if self.is_prismatic:
            return math.sqrt(1e3) * max(map(abs, self.range))
        return max(map(abs, (self.limits.lower, self.limits.upper))) + 2.0 * math.pi

    @property
    def units(self) -> tuple[str, str]:
        """Units of position and torque."""
        return ('m', 'N') if self.is_prismatic else ('rad', 'N m')


@dataclass(frozen=True)
class ParameterCovariance:
    """Uncertainty of the identified parameters.

    The vector is that of `SerialArm.parameter_vector`.  Combinations that the data do not
    determine carry the width of the prior that held them.
    """

    factor: tuple[tuple[float, ...], ...]  # rows F: the covariance is F^T F
    # number of base and drive parameters that the data determine
    determined: int = entry('integer', low=0)

    def matrix(self) -> np.ndarray:
        """Covariance, shape (15 n, 15 n)."""
        factor = np.array(self.factor)
        return factor.T @ factor


@dataclass(frozen=True)
class Uncertainty:
    """What may differ from the description while the arm is healthy."""

    # largest unknown mass at the tip, 0 if it never carries any; None: not stated [kg]
    payload: float | None = entry('number', default=None, low=0.0, high=1e4)
    # relative change of all friction, as with temperature [-]
    friction: float = entry('number', default=0.0, low=0.0, high=1.0)
    # of masses, places of masses, inertias [-]; None: not stated
    model_error: float | None = entry('number', default=None, low=0.0, high=1.0)
    # torque that the model misses, a standard deviation for each joint; None: not measured.
    # sigma(v)^2 = torque_error^2 + (torque_error_speed*v)^2 at joint rate v
    torque_error: tuple[float, ...] | None = None  # in slow motion [N m]
    torque_error_speed: tuple[float, ...] | None = None  # growth with the joint's rate [N m s/rad]
    # in which its correlation falls to 1/e [s]
    torque_error_time: float | None = entry('number', default=None, low=0.0, high=1e4)

    @property
    def largest_payload(self) -> float:
        """Largest payload of which something can be guaranteed: as stated, else none [kg]."""
        return self.payload or 0.0


@dataclass(frozen=True)
class LpvRegion:
    """What the LPV design of the paper's observer and controller needs of a planar two-link arm.

    Angles theta are those of the links from the upper vertical (paper, Fig. 1).
    """

    # of both links: cos(theta) > 0 ('upright') or cos(theta) < 0 ('hanging')
    orientation: str = entry('text', choices=('upright', 'hanging'))
    # smallest abs(cos(theta_i)) in which gains are certified
    cos_min: tuple[float, float] = entry('vector', 2, low=0.01, high=0.999)
    # last two rows of Bd, eq. (31): accelerations of theta per unit of the disturbance d
    disturbance_direction: tuple[float, float] = entry(
        'vector', 2, default=(0.0, 0.0), low=-1e3, high=1e3, at='disturbance.direction'
    )
    # of the white disturbance d that the design must live with
    disturbance_mean: float = entry(
        'number', default=0.0, low=-1e4, high=1e4, at='disturbance.mean'
    )
    disturbance_variance: float = entry(
        'number', default=0.0, low=0.0, high=1e8, at='disturbance.variance'
    )
    # relative error of the rates (scale, delay)
    velocity_error: float = entry('number', default=0.0, low=0.0, high=0.5)


@dataclass(frozen=True)
class SerialArm:
    """A serial arm of n joints, its sensors and what may vary."""

    name: str  # name of the arm
    joints: tuple[SerialJoint, ...]  # from the base to the tip
    urdf: str = ''  # path of the URDF that kinematics came from, or ''
    # joints of the URDF that are held at an angle [rad] (a gripper's)
    locked: tuple[tuple[str, float], ...] = ()
    # roll, pitch, yaw of the base in a frame whose z-axis points up [rad]
    base_orientation: tuple[float, float, float] = entry(
        'vector', 3, default=(0.0, 0.0, 0.0), low=-TURN, high=TURN
    )
    gravity: float = entry('number', default=9.81, low=0.0, high=100.0)  # g [m/s2]
    # reference point of a payload in the last joint's frame [m]
    tip: tuple[float, float, float] = entry(
        'vector', 3, default=(0.0, 0.0, 0.0), low=-FAR, high=FAR
    )
    sample_time: float = entry('number', default=0.002, low=1e-5, high=1.0)  # Ts [s]
    # unit of the reported efforts, ``torque_gain`` leads from it to N m
    effort_unit: str = entry('text', default='N m', at='effort.unit')
    # whether the reported efforts contain the torque that holds the arm's weight
    effort_includes_gravity: bool = entry('flag', default=True, at='effort.includes_gravity')
    # above this frequency the reported efforts carry nothing [Hz]; inf if none is known
    effort_bandwidth: float = entry(
        'number', default=math.inf, above=0.0, high=1e6, at='effort.bandwidth'
    )
    uncertainty: Uncertainty = Uncertainty()  # what may vary
    # S of y = S q + f, rows by sensor: None where each joint has its own sensor (S = 1)
    sensor_matrix: tuple[tuple[float, ...], ...] | None = None
    # of a planar two-link arm with designed gains
    lpv: LpvRegion | None = part(LpvRegion, default=None)
    covariance: ParameterCovariance | None = None  # of the identified parameters

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, from the base to the tip."""
        return tuple(joint.name for joint in self.joints)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the position sensors, one for each joint."""
        return tuple(joint.sensors.name for joint in self.joints)

    @property
    def position_units(self) -> tuple[str, ...]:
        """Units of the joints' positions, which are also those of their sensors."""
        return tuple(joint.units[0] for joint in self.joints)

    @property
    def velocity_limit(self) -> tuple[float, ...]:
        """Largest joint rates, one for each joint [rad/s]."""
        return tuple(joint.limits.velocity for joint in self.joints)

    @property
    def torque_limit(self) -> tuple[float, ...]:
        """Largest joint torques, one for each joint [N m]."""
        return tuple(joint.limits.torque for joint in self.joints)

    @property
    def torque_gain(self) -> tuple[float, ...]:
        """Joint torques by unit of what drives report as effort, one for each joint."""
        return tuple(joint.torque_gain for joint in self.joints)

    def sensors(self) -> SensorArrays:
        """What is stated of the sensors, joint by joint."""
        every = [joint.sensors for joint in self.joints]
        return SensorArrays(
            np.array([one.position_noise for one in every], float),
            np.array([one.quantization for one in every], float),
            np.array([one.velocity_noise for one in every], float),
            np.array([one.rates == 'independent' for one in every]),
        )

    def scales(self) -> np.ndarray:
        """What counts as much as 1 rad in thresholds, shape (n,); see `SerialJoint.scale`."""
        return np.array([joint.scale for joint in self.joints])

    def joints_to_sensors(self) -> np.ndarray:
        """S of y = S q + f: readings of the position sensors by joint positions, shape (n, n)."""
        n = len(self.joints)
        return np.eye(n) if self.sensor_matrix is None else np.array(self.sensor_matrix, float)

    def sensors_to_joints(self) -> np.ndarray:
        """Inverse of S: joint positions by readings without faults, shape (n, n)."""
        return np.linalg.inv(self.joints_to_sensors())

    def gravity_vector(self) -> np.ndarray:
        """Acceleration of gravity in the base's frame, shape (3,) [m/s2]."""
        return -self.gravity * rotation_from_rpy(self.base_orientation)[2]

    def inertial_parameters(self) -> np.ndarray:
        """Standard inertial parameters of all links, shape (10 n,)."""
        return np.concatenate([joint.link.to_vector() for joint in self.joints])

    def parameter_vector(self) -> np.ndarray:
        """All parameters that torques are linear in, shape (15 n,).

        10 inertial parameters of each link, then for all joints each: rotor inertia, viscous
        friction, Coulomb friction, load-dependent friction, offset.
        """
        drive = [
            [j.rotor_inertia for j in self.joints],
            [j.friction.viscous for j in self.joints],
            [j.friction.coulomb for j in self.joints],
            [j.friction.load for j in self.joints],
            [j.friction.offset for j in self.joints],
        ]
        return np.concatenate([self.inertial_parameters(), *drive])

    def sha256(self) -> str:
        """Hash of every parameter: what is designed for this arm carries it."""
        content = asdict(self)
        # What is designed holds for what is stated; files without these fields keep their hash.
        content['uncertainty']['payload'] = self.uncertainty.largest_payload
        for name in ('torque_error', 'torque_error_speed', 'torque_error_time'):
            if content['uncertainty'][name] is None:
                del content['uncertainty'][name]
        for joint in content['joints']:
            if joint['rotor_coupling'] == 0.0:
                del joint['rotor_coupling']
            if joint['type'] == 'revolute':
                del joint['type']
        for name in ('sensor_matrix', 'lpv'):
            if content[name] is None:
                del content[name]
        return sha256_of(content)


def inertia_matrix(entries: Sequence[float] | np.ndarray) -> np.ndarray:
    """Symmetric matrix, shape (3, 3), of its entries in the order of `INERTIA_KEYS`."""
    xx, xy, yy, xz, yz, zz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def coulomb_direction(velocity: np.ndarray, slope: float | np.ndarray) -> np.ndarray:
    """Direction of Coulomb friction, (2/pi) atan(k v), of shape ``velocity.shape``."""
    return (2.0 / math.pi) * np.arctan(slope * velocity)


def rotation_from_rpy(angles: tuple[float, float, float]) -> np.ndarray:
    """Rotation of URDF's roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll).

    Parameters
    ----------
    angles : tuple of float
        Roll, pitch, yaw [rad].

    Returns
    -------
    ndarray, shape (3, 3)
        Columns are the turned axes.
    """
    (sr, cr), (sp, cp), (sy, cy) = [(math.sin(a), math.cos(a)) for a in angles]
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
