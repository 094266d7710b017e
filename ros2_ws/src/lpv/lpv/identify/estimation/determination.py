"""Which parameters the data determine, and what motion would determine the others."""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.identify.estimation.regression import Fit
from lpv.identify.model.base_parameters import BaseParameters
from lpv.identify.model.friction import TERMS
from lpv.identify.model.prior import structural_prior

_LINK = ('mass', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
_REMEDIES = (
    (_LINK[:4], 'hold it, and those before it, in more different postures'),
    ((*_LINK[4:], 'rotor'), 'accelerate it more'),
    (TERMS, 'move it at more different speeds, both ways'),
)


@dataclass(frozen=True)
class Determination:
    """Parameters of a fit by name, with their standard deviations."""

    names: list[str]
    values: np.ndarray  # shape (parameters,)
    sigma: np.ndarray  # standard deviation, shape (parameters,)
    determined: np.ndarray  # the data say more than the prior, shape (parameters,)

    def advice(self, joints: tuple[str, ...]) -> list[str]:
        """What motion is missing, one sentence for each joint of which much is unknown."""
        texts = []
        for name in joints:
            whose = [one.partition(': ') for one, d in zip(self.names, self.determined) if not d]
            for terms, remedy in _REMEDIES:
                missing = [term for joint, _, term in whose if joint == name and term in terms]
                if missing:
                    texts.append(f'{name}: {", ".join(missing)} not determined; {remedy}')
        return texts


def determine(base: BaseParameters, fit: Fit, arm: SerialArm) -> Determination:
    """Deviations of a fit's parameters, and which are determined by half of the prior's."""
    names = parameter_names(base, arm.joint_names)
    used = np.diag(fit.normal) > 0.0
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    _, width = structural_prior(arm)
    prior = np.sqrt(np.sum((base.combination * width) ** 2, axis=1))
    friction = np.abs(fit.friction)
    size = np.maximum(friction[:, [0, 1, 2, 1]], fit.scale[:, None] * 0.5)
    size[:, TERMS.index('load')] = np.maximum(size[:, TERMS.index('load')], 0.05)
    limit = np.concatenate([prior / np.sqrt(5.0), size.ravel()])
    determined = (sigma > 0.0) & (sigma < limit) & used
    return Determination(names, fit.parameters, sigma, determined)


def parameter_names(base: BaseParameters, joints: tuple[str, ...]) -> list[str]:
    """Names of a fit's parameters; a base parameter has that of the column that stands for it."""
    structural = [f'{joint}: {part}' for joint in joints for part in _LINK]
    structural += [f'{joint}: rotor' for joint in joints]
    friction = [f'{joint}: {term}' for joint in joints for term in TERMS]
    return [structural[column] for column in base.columns] + friction
