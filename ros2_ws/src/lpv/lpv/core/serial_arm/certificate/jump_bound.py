"""Largest jump that a healthy reading shows, whatever the drives do."""

import numpy as np

from lpv.core.serial_arm.certificate.link_forms import rotors_below, spatial_inertia
from lpv.core.serial_arm.chain import FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm

SIGMAS = 8.0
"""Standard deviations of noise: exceeded by one sample in 1e15."""
NET_TORQUE = 2.0
"""Net torque of a joint over its limit, at most: a drive that moves its arm overcomes weight,
Coriolis torques and pushes, which are no larger than what it has."""


def jump_bound(arm: SerialArm) -> FloatArray:
    """Bound of e (see `lpv.core.serial_arm.diagnosis.jumps`) of a healthy arm.

    With rates that change by at most a T a sample, abs(e) <= a T^2 for rates of either kind; to
    that comes the noise of three or four readings.

    Parameters
    ----------
    arm : SerialArm
        Its torque limits, sensors and rotor inertias count.

    Returns
    -------
    ndarray, shape (n,)
        [rad]; infinite where the file states no inertia of the rotors.
    """
    (position, step, rate, independent), period = arm.sensors(), arm.sample_time
    deviation = np.where(
        independent, np.hypot(np.sqrt(2.0) * position, period * rate), np.sqrt(5.0) * position
    )
    rounding = np.where(independent, 1.0, 2.0) * step
    return _acceleration(arm) * period**2 + SIGMAS * deviation + rounding


def _acceleration(arm: SerialArm) -> FloatArray:
    """Largest accelerations of the readings S q in every configuration [rad/s2].

    M >= diag(c) with c of the rotors' inertias, as the links' part is positive semidefinite: from
    a^T M a = a^T tau follows sum c a^2 <= sum tau^2 / c, and (s a)^2 <= sum c a^2 sum s^2 / c.
    """
    rotor = rotors_below(compile_chain(arm).motor)
    links = [np.linalg.eigvalsh(spatial_inertia(joint.link.to_vector())) for joint in arm.joints]
    semidefinite = all(one.min() >= -1e-9 * max(one.max(), 1.0) for one in links)
    if rotor.min() <= 0.0 or not semidefinite:
        return np.full(len(rotor), np.inf)
    net = NET_TORQUE * np.array(arm.torque_limit)
    along = arm.joints_to_sensors() ** 2 @ (1.0 / rotor)
    return np.asarray(np.sqrt((net**2 / rotor).sum() * along))
