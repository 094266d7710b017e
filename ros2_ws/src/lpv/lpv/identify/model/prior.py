"""What is known of an arm's parameters before the recording: its URDF, with wide tolerances."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import UNSTATED_FRICTION, JointLimits, SerialArm
from lpv.core.serial_arm.diagnosis.parameter_error import typical_torque
from lpv.core.serial_arm.diagnosis.priors import USUAL_RATE
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.identify.model.friction import SLOPE
from lpv.identify.model.rigid_body import BaseParameters

_RELATIVE = 0.3  # of masses; of the lengths that first moments and inertias go with
_SHARE = 0.02  # of the arm's mass: the least that a link is taken to weigh
LOAD_WIDTH = 0.1
"""Standard deviation of load-dependent friction [N m per N m]."""
_LENGTH = 0.1  # least size of a link [m]
_LOST = 0.1  # share of a drive's largest torque that its gears may take
_ROTOR = 0.006  # inertia per unit of it of a geared rotor [s2]: RMS of UR10, Panda and PUMA 560


@dataclass(frozen=True)
class Prior:
    """Normal distribution of the parameters before the data."""

    mean: np.ndarray  # shape (parameters,)
    information: np.ndarray  # inverse covariance, shape (parameters, parameters)
    slope: np.ndarray | float = SLOPE  # of the Coulomb term, expected, shape (n,) [s/rad]
    strength: float = 1.0  # how often it counts, as if it had been seen so many times

    def times(self, strength: float) -> 'Prior':
        """The same distribution, as if it had been seen so many times."""
        information = strength * self.information
        return replace(self, information=information, strength=strength * self.strength)

    @property
    def score(self) -> np.ndarray:
        """Covariance of information @ (mean - truth): what is known does not change."""
        return self.strength * self.information


def structural_prior(arm: SerialArm, geared: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation of the links' parameters, then of the rotors', each (11 n,).

    Rotors that are not stated may be ``geared``: then they outweigh wrists.
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
    mean = np.concatenate([arm.inertial_parameters(), [j.rotor_inertia for j in arm.joints]])
    # A rotor as large as the inertia that its joint may see: of all masses behind it, stretched.
    chain = compile_chain(arm)
    model = SerialModel(chain._replace(motor=0.0 * chain.motor))
    poses = np.random.default_rng(5).uniform(-3, 3, (50, len(arm.joints)))
    seen = np.maximum(np.max([np.diag(model.mass_matrix(q)) for q in poses], axis=0), 0.0)
    usual = _ROTOR * _largest(arm) / arm.scales() * (geared & (mean[-len(seen) :] == 0.0))
    return mean, np.concatenate([_RELATIVE * np.array(sigma), np.maximum(seen + 0.01, usual)])


def _largest(arm: SerialArm) -> np.ndarray:
    """Largest torque of each drive; if none is stated, gears take one that moves the arm."""
    limit = np.array([joint.limits.torque for joint in arm.joints])
    usual = typical_torque(compile_chain(arm), arm.scales()).max()
    return np.where(limit < JointLimits.torque, limit, usual / _LOST)


def friction_prior(arm: SerialArm) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation of each joint's friction in the order of `TERMS`, each (n, 4)."""
    friction = [joint.friction for joint in arm.joints]
    mean = np.array([(f.viscous, f.coulomb, f.load, f.offset) for f in friction])
    stated = mean[:, 1] + np.abs(mean[:, 0]) * USUAL_RATE
    # As large as the torques that move the joint, or the share of its largest one that is usual;
    # as stated within its own size, or the share of that by which friction may change.
    size = np.maximum(typical_torque(compile_chain(arm), arm.scales()), _LOST * _largest(arm))
    size = np.where(stated > 0.0, np.maximum(stated, UNSTATED_FRICTION * size), size)
    load = np.full_like(size, LOAD_WIDTH)
    # An offset is what friction takes more one way than the other.
    width = size / USUAL_RATE, size, load, UNSTATED_FRICTION * size
    return mean, np.stack(width, axis=1)


def base_prior(arm: SerialArm, base: BaseParameters, geared: bool = False) -> Prior:
    """Prior of the base parameters, then of each joint's friction; see `structural_prior`."""
    mean, sigma = structural_prior(arm, geared)
    friction, width = friction_prior(arm)
    inertial = np.linalg.inv((base.combination * sigma**2) @ base.combination.T)
    information = block_diag(inertial, np.diag(width.ravel() ** -2))
    stated = [joint.friction for joint in arm.joints]
    slope = np.array([f.coulomb_slope if f.coulomb > 0.0 else SLOPE for f in stated])
    return Prior(np.append(base.combination @ mean, friction), information, slope)
