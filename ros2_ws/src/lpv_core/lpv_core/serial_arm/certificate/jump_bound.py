"""Largest jump that a healthy reading shows, whatever the drives do."""

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, compile_chain
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.support.errors import SampleError

SIGMAS = 8.0
"""Standard deviations of noise: exceeded by one sample in 1e15."""
NET_TORQUE = 2.0
"""Net torque of a joint over its limit, at most: drives, weight, Coriolis torques and pushes."""
_POSES = 100


def jump_bound(arm: SerialArm) -> FloatArray:
    """Bound of e (see `lpv_core.serial_arm.diagnosis.sampling`) of a healthy arm.

    With rates that change by at most a T a sample, abs(e) <= a T^2 for rates of either kind; to
    that comes the noise of three or four readings.

    Parameters
    ----------
    arm : SerialArm
        Its torque limits, sensors and inertias count; accelerations are those at 100 random poses.

    Returns
    -------
    ndarray, shape (n,)
        [rad]; infinite where the mass matrix is not positive definite.
    """
    sensors, period = [joint.sensors for joint in arm.joints], arm.sample_time
    position = np.array([one.position_noise for one in sensors])
    rate = np.array([one.velocity_noise for one in sensors])
    step = np.array([one.quantization for one in sensors])
    derived = np.array([one.rates != 'independent' for one in sensors])
    deviation = np.where(
        derived, np.sqrt(5.0) * position, np.hypot(np.sqrt(2.0) * position, period * rate)
    )
    rounding = np.where(derived, 2.0, 1.0) * step
    return _acceleration(arm) * period**2 + SIGMAS * deviation + rounding


def _acceleration(arm: SerialArm) -> FloatArray:
    """Largest accelerations of the joints [rad/s2]."""
    model, rng = SerialModel(compile_chain(arm)), np.random.default_rng(0)
    limit = NET_TORQUE * np.array(arm.torque_limit)
    largest = np.zeros(len(limit))
    for q in rng.uniform(-np.pi, np.pi, (_POSES, len(limit))):
        try:
            inverse = np.linalg.inv(model.mass_matrix(q))
        except (np.linalg.LinAlgError, SampleError):
            return np.full(len(limit), np.inf)
        if np.diag(inverse).min() <= 0.0:
            return np.full(len(limit), np.inf)
        largest = np.maximum(largest, np.abs(inverse) @ limit)
    return largest
