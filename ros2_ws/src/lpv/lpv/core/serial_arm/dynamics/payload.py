"""A load that the last link carries."""

import numpy as np

from lpv.core.serial_arm.chain import MASS, Chain, FloatArray, moved_body
from lpv.core.support.errors import ConfigError

PAYLOAD_PLACE = 0.05
"""Largest distance of an unknown payload's centre from the tip, along each axis [m]."""


def payload_parameters(chain: Chain, mass: float) -> FloatArray:
    """Inertial parameters of a point mass at the tip in the last joint frame, shape (10,).

    They add to the last row of `Chain.inertial`; ``mass`` [kg] is negative to take away what the
    model has.  ConfigError if it is not finite.
    """
    if not np.isfinite(mass):
        raise ConfigError('payload', 'must be finite')
    point = np.array([mass, *np.zeros(9)])
    return moved_body(point, chain.tip_rotation, chain.tip_translation)


def with_payload(chain: Chain, mass: float) -> Chain:
    """The arm with a point mass [kg] at its tip.

    Raises
    ------
    ConfigError
        If the last link would be left without mass.
    """
    inertial = chain.inertial.copy()
    inertial[-1] += payload_parameters(chain, mass)
    if not inertial[-1, MASS] > 0.0:
        raise ConfigError('payload', f'must leave the last link a mass, got {mass}')
    return chain._replace(inertial=inertial)
