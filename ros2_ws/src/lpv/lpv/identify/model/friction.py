"""Regressors of friction, and those of all parameters."""

import numpy as np

from lpv.core.serial_arm.description import coulomb_direction

TERMS = ('viscous', 'coulomb', 'load', 'offset')
"""Friction parameters of a joint, in the order of their columns."""
SLOPE = 50.0
"""Slope of the Coulomb term where none is stated [s/rad]: about the middle of `SLOPES`."""
SLOPES = 3.0, 1000.0
"""Least and largest slope of the Coulomb term [s/rad]."""


def least_viscous(slope: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Viscous friction, per unit of Coulomb's, with which nothing is left at a speed [s/rad].

    Beyond its maximum friction may fall with speed (Stribeck's effect); it drives at no speed up
    to this one if it does not there.
    """
    return -coulomb_direction(speed, slope) / speed


def direction_slope(velocity: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Derivative of `coulomb_direction` with respect to log(k)."""
    turned = slope * velocity
    return (2.0 / np.pi) * turned / (1.0 + turned**2)


def friction_columns(velocity: np.ndarray, slope: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Regressor (samples, n, 4) of friction at rates [rad/s], slopes [s/rad], loads [N m]."""
    way = coulomb_direction(velocity, slope)
    return np.stack([velocity, way, np.abs(load) * way, np.ones_like(velocity)], axis=2)


def join_columns(base: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Regressor of all parameters, shape (rows, n, base + terms n), of those of each joint."""
    count, n, terms = friction.shape
    spread = np.zeros((count, n, n, terms))
    spread[:, np.arange(n), np.arange(n)] = friction
    return np.concatenate([base, spread.reshape(count, n, n * terms)], axis=2)
