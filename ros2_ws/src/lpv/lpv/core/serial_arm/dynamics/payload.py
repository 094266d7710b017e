"""A load that the last link carries."""

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import (
    MASS,
    Chain,
    FloatArray,
    body_parameters,
    joint_count,
    moved_body,
)
from lpv.core.support.errors import ConfigError

PAYLOAD_PLACE = 0.05
"""Largest distance of an unknown payload's centre from the tip, along each axis [m]."""


def payload_parameters(
    chain: Chain,
    mass: float,
    center: npt.ArrayLike = (0.0, 0.0, 0.0),
    inertia: npt.ArrayLike | None = None,
) -> FloatArray:
    """Inertial parameters of a load in the last joint frame.

    Parameters
    ----------
    chain : Chain
        The arm.
    mass : float
        [kg]; negative to take away what the model has.
    center : array_like, shape (3,), optional
        Centre of mass in the frame of the tip [m].
    inertia : array_like, shape (3, 3), optional
        About its centre of mass, along the axes of the tip [kg m2]; none by default.

    Returns
    -------
    ndarray, shape (10,)
        To add to the last row of `Chain.inertial`.

    Raises
    ------
    ConfigError
        If a value is not finite.
    """
    inertia = np.zeros((3, 3)) if inertia is None else np.asarray(inertia, float)
    body = body_parameters(mass, center, inertia)
    if not np.isfinite(body).all():
        raise ConfigError('payload', 'must be finite')
    return moved_body(body, chain.tip_rotation, chain.tip_translation)


def with_payload(
    chain: Chain,
    mass: float,
    center: npt.ArrayLike = (0.0, 0.0, 0.0),
    inertia: npt.ArrayLike | None = None,
) -> Chain:
    """The arm with a load at its tip; arguments as of `payload_parameters`.

    Raises
    ------
    ConfigError
        If the last link would be left without mass.
    """
    inertial = chain.inertial.copy()
    inertial[joint_count(chain) - 1] += payload_parameters(chain, mass, center, inertia)
    if not inertial[-1, MASS] > 0.0:
        raise ConfigError('payload', f'must leave the last link a mass, got {mass}')
    return chain._replace(inertial=inertial)
