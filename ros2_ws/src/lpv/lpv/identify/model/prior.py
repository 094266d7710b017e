"""What is known of an arm's parameters before the recording: its URDF, with wide tolerances."""

from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import UNSTATED_FRICTION, JointLimits, SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.parameter_error import typical_torque
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.identify.model.friction import SLOPE, TERMS
from lpv.identify.model.rigid_body import STANDARD, BaseParameters

_RELATIVE = 0.3  # of masses; of the lengths that first moments and inertias go with
_SHARE = 0.02  # of the arm's mass: the least that a link is taken to weigh
LOAD_WIDTH = 0.1
"""Standard deviation of load-dependent friction [N m per N m]."""
HELD_LOAD = 1e-4
"""The same where it is what the arm's file says."""
_LENGTH = 0.1  # least size of a link [m]
_LOST = 0.1  # share of a drive's largest torque that its gears may take
_ROTOR = 0.006  # inertia per unit of it of a geared rotor [s2]: RMS of UR10, Panda and PUMA 560


@dataclass(frozen=True)
class Prior:
    """Normal distribution of the parameters before the data."""

    mean: np.ndarray  # shape (parameters,)
    information: np.ndarray  # inverse covariance, shape (parameters, parameters)
    slope: np.ndarray | float = SLOPE  # of the Coulomb term, expected, shape (n,) [s/rad]
    whole: tuple[np.ndarray, ...] = ()  # `prior_of_all`, of which it is a part
    strength: float = 1.0  # how often it counts, as if it had been seen so many times

    def times(self, strength: float) -> 'Prior':
        """The same distribution, as if it had been seen so many times."""
        information = strength * self.information
        return replace(self, information=information, strength=strength * self.strength)

    @property
    def score(self) -> np.ndarray:
        """Covariance of information @ (mean - truth): what is known does not change."""
        return self.strength * self.information


def parameter_map(base: BaseParameters, joints: int) -> np.ndarray:
    """Matrix T that leads from `SerialArm.parameter_vector` to base parameters and friction."""
    terms, structural = len(TERMS), STANDARD * joints
    result = np.zeros((base.size + terms * joints, structural + terms * joints))
    result[: base.size, :structural] = base.combination
    # There friction is by terms, here by joints.
    order = np.arange(terms * joints).reshape(terms, joints).T.ravel()
    result[base.size :, structural:] = np.eye(terms * joints)[order]
    return result


def prior_of_all(arm: SerialArm, geared: bool, load: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation of `SerialArm.parameter_vector` before the data, each (15 n,).

    Rotors that are not stated may be ``geared``: then they outweigh wrists.  ``load`` is the
    deviation of load-dependent friction.
    """
    masses = np.array([joint.link.mass for joint in arm.joints])
    least = max(_SHARE * masses.sum(), 0.1)
    sigma = []
    for i, joint in enumerate(arm.joints):
        mass = max(joint.link.mass, least)
        center = np.linalg.norm(joint.link.first_moment) / mass
        following = arm.joints[i + 1].position if i + 1 < len(arm.joints) else arm.tip
        length = max(_LENGTH, float(center), float(np.linalg.norm(following)))
        sigma += [mass] + [mass * length] * 3 + [mass * length**2] * 6
    mean = arm.parameter_vector()
    rotor, viscous, coulomb, _, _ = mean[len(sigma) :].reshape(-1, len(masses))
    # A rotor as large as the inertia that its joint may see: of all masses behind it, stretched.
    chain = compile_chain(arm)
    model = SerialModel(chain._replace(motor=0.0 * chain.motor))
    poses = np.random.default_rng(5).uniform(-3, 3, (50, len(arm.joints)))
    seen = np.maximum(np.max([np.diag(model.mass_matrix(q)) for q in poses], axis=0), 0.0)
    moving = typical_torque(chain, arm.scales())
    # Largest torque of each drive; if none is stated, gears take one that moves the arm.
    limit = np.array([joint.limits.torque for joint in arm.joints])
    largest = np.where(limit < JointLimits.torque, limit, moving.max() / _LOST)
    usual = _ROTOR * largest / arm.scales() * (geared & (rotor == 0.0))
    # Friction as large as the torques that move the joint, or the share of its largest one that is
    # usual; as stated within its own size, or the share of that by which friction may change.
    stated = coulomb + np.abs(viscous) * priors.USUAL_RATE
    size = np.maximum(moving, _LOST * largest)
    size = np.where(stated > 0.0, np.maximum(stated, UNSTATED_FRICTION * size), size)
    # An offset is what friction takes more one way than the other.
    friction = size / priors.USUAL_RATE, size, np.full_like(size, load), UNSTATED_FRICTION * size
    return mean, np.concatenate(
        [_RELATIVE * np.array(sigma), np.maximum(seen + 0.01, usual), *friction]
    )


def base_prior(
    arm: SerialArm, base: BaseParameters, geared: bool = False, load: float = LOAD_WIDTH
) -> Prior:
    """Prior of the base parameters, then of each joint's friction; see `prior_of_all`."""
    mean, sigma = whole = prior_of_all(arm, geared, load)
    turn = parameter_map(base, len(arm.joints))
    stated = [joint.friction for joint in arm.joints]
    slope = np.array([f.coulomb_slope if f.coulomb > 0.0 else SLOPE for f in stated])
    return Prior(turn @ mean, np.linalg.inv((turn * sigma**2) @ turn.T), slope, whole)
