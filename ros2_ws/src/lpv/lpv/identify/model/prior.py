"""What is known of an arm's parameters before the recording: its URDF, with wide tolerances."""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.identify.model.base_parameters import BaseParameters
from lpv.identify.model.friction import TERMS

_RELATIVE = 0.3  # of masses; of the lengths that first moments and inertias go with
_SHARE = 0.02  # of the arm's mass: the least that a link is taken to weigh
LOAD_WIDTH = 0.1
"""Standard deviation of load-dependent friction [N m per N m]."""
_LENGTH = 0.1  # least size of a link [m]


@dataclass(frozen=True)
class Prior:
    """Normal distribution of the parameters before the data."""

    mean: np.ndarray  # shape (parameters,)
    information: np.ndarray  # inverse covariance, shape (parameters, parameters)

    def times(self, strength: float) -> 'Prior':
        """The same distribution, as if it had been seen so many times."""
        return Prior(self.mean, strength * self.information)


def structural_prior(arm: SerialArm) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation of the links' parameters, then of the rotors', each (11 n,)."""
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
    return mean, np.concatenate([_RELATIVE * np.array(sigma), _joint_inertias(arm) + 0.01])


def _joint_inertias(arm: SerialArm) -> np.ndarray:
    """Largest inertia that each joint may see [kg m2]: all masses behind it, arm stretched."""
    chain = compile_chain(arm)
    model = SerialModel(chain._replace(motor=0.0 * chain.motor))
    poses = np.random.default_rng(5).uniform(-3, 3, (50, len(arm.joints)))
    return np.maximum(np.max([np.diag(model.mass_matrix(q)) for q in poses], axis=0), 0.0)


def base_prior(arm: SerialArm, base: BaseParameters) -> Prior:
    """Prior of the base parameters, then of each joint's friction, of which little is known."""
    mean, sigma = structural_prior(arm)
    covariance = (base.combination * sigma**2) @ base.combination.T
    size = base.size + len(TERMS) * len(arm.joints)
    information = np.zeros((size, size))
    information[: base.size, : base.size] = np.linalg.inv(covariance)
    load = base.size + TERMS.index('load') + len(TERMS) * np.arange(len(arm.joints))
    information[load, load] = LOAD_WIDTH**-2
    return Prior(np.concatenate([base.combination @ mean, np.zeros(size - base.size)]), information)
