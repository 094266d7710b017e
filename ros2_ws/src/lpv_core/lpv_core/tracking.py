"""Tracking with integral action, eqs. (57)-(66), with reference feed-forward."""

from dataclasses import dataclass

import numpy as np

from lpv_core.dynamics import inverse_dynamics
from lpv_core.joints import JointMap

COMPENSATION = ('off', 'confirmed', 'always')
"""Which position the loop closes on: measured, with confirmed faults removed, or estimated."""


@dataclass(frozen=True)
class Command:
    """One torque command.

    Attributes
    ----------
    torque : ndarray, shape (2,)
        Joint torques within limits [N m].
    saturated : bool
        Whether a limit was met.
    """

    torque: np.ndarray
    saturated: bool


class TrackingController:
    """State feedback u = M1 x + M2 eps (65), eps' = w - y (59).

    Method ``exact`` closes the loop on the deviation from the reference and adds the torque that
    the arm needs along it (inverse dynamics with Coriolis terms and friction):
    u = u_ref(w, w', w'') + M1 (x - x_ref) + M2 eps.  Method ``paper`` is (65) literally.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Designed gains of this arm.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    def __init__(self, arm, gains):
        gains.check_arm(arm)
        self._joints = JointMap(arm)
        self._constants = arm.constants()
        self._limit = np.array(arm.torque_limit)
        self._m1, self._m2 = gains.controller.m1, gains.controller.m2
        self._feed_forward = gains.controller.method == 'exact'
        self.integral = np.zeros(2)

    def reset(self):
        """Empty the integrator."""
        self.integral[:] = 0.0

    def update(self, reference, position, velocity, integrated_position, interval):
        """Torque for the present sample.

        Parameters
        ----------
        reference : Reference
            References at the sample's time, shape (2,) each.
        position, velocity : ndarray, shape (2,)
            State to feed back, joint coordinates [rad], [rad/s].
        integrated_position : ndarray, shape (2,)
            Position y of eq. (59), joint coordinates [rad].
        interval : float
            Time since the previous command [s]; 0 at the first.

        Returns
        -------
        Command
            Joint torques.
        """
        to_absolute = self._joints.absolute_position
        w = to_absolute(reference.position)
        rate = self._joints.absolute_velocity(reference.velocity)
        x = np.concatenate([to_absolute(position), self._joints.absolute_velocity(velocity)])
        step = interval * (w - to_absolute(integrated_position))
        feed_forward = np.zeros(2)
        if self._feed_forward:
            acceleration = self._joints.absolute_velocity(reference.acceleration)
            feed_forward = np.array(inverse_dynamics(*w, *rate, *acceleration, self._constants))
            x = x - np.concatenate([w, rate])
        wanted = self._torque(feed_forward, x, self.integral + step)
        torque = np.clip(wanted, -self._limit, self._limit)
        saturated = bool(np.any(torque != wanted))
        if not saturated:
            self.integral += step  # conditional integration: no wind-up at the limit
        return Command(torque, saturated)

    def _torque(self, feed_forward, x, integral):
        absolute = feed_forward + self._m1 @ x + self._m2 @ integral
        return self._joints.joint_torque(absolute)


def feedback_position(compensation, estimate, confirmed_fault, joints):
    """Joint position to close the loop on.

    Parameters
    ----------
    compensation : {'off', 'confirmed', 'always'}
        Which one.
    estimate : Estimate
        Latest estimate.
    confirmed_fault : ndarray, shape (2,)
        Fault estimates of confirmed sensors, zero elsewhere [rad].
    joints : JointMap
        Conversions of the arm.

    Returns
    -------
    ndarray, shape (2,)
        [rad].
    """
    if compensation == 'always':
        return estimate.position
    if compensation == 'off':
        return estimate.measured_position
    return joints.joint_from_sensor(estimate.sensor_position - confirmed_fault)
