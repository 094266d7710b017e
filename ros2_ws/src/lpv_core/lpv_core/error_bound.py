"""Bounds on the error of the fault estimates, by configuration and past.

Gravity is the only absolute reference of an angle: what the model does not know of the torques is
explained as an angle error, and in time an error q/(G cos theta) builds up.
"""

import math

import numpy as np

from lpv_core.arm import A_11, B_12, C_22, G_1, G_2
from lpv_core.jit import njit
from lpv_core.joints import JointMap
from lpv_core.unknown_torque import UnknownTorque
from lpv_core.zonotope import COLUMNS, extent, map_columns, reduce_columns

_FASTEST = 100.0
_RATE_BIAS = 0.1
"""Bias of a rate sensor, over the standard deviation of its noise."""


@njit
def error_matrix(theta, rate, acc, kappa, mu, held, sign, arm, out):
    """N of the error of method ``exact`` at the estimate, for the state (e_1, e_2, r_1, r_2).

    r_i = s m_i / Xi_ii is the momentum error in units of a rate.  The coupling of inertia and
    Coriolis terms enters with its known sign; what its linearisation leaves out is quadratic in
    the error.

    Parameters
    ----------
    theta, rate, acc : ndarray, shape (2,)
        Absolute angles, rates, accelerations at the estimate.
    kappa, mu : ndarray, shape (2,)
        Gains.
    held : ndarray of bool, shape (2,)
        Links without correction.
    sign : float
        s: +1 upright, -1 hanging.
    arm : ndarray, shape (12,)
        Constants of the arm.
    out : ndarray, shape (4, 4)
        Receives N.
    """
    cosine, sine = math.cos(theta[0] - theta[1]), math.sin(theta[0] - theta[1])
    b = sign * arm[B_12]
    couple_1 = -b * (cosine * rate[1] * rate[1] - sine * acc[1]) / arm[A_11]
    couple_2 = b * (cosine * rate[0] * rate[0] + sine * acc[0]) / arm[C_22]
    out[:] = 0.0
    out[0, 2] = 0.0 if held[0] else -kappa[0] * arm[A_11]
    out[1, 3] = 0.0 if held[1] else -kappa[1] * arm[C_22]
    out[2, 0] = sign * arm[G_1] * math.cos(theta[0]) / arm[A_11] + couple_1
    out[2, 1] = -couple_1
    out[3, 0] = couple_2
    out[3, 1] = sign * arm[G_2] * math.cos(theta[1]) / arm[C_22] - couple_2
    out[2, 2], out[3, 3] = -mu[0], -mu[1]


@njit
def advance_set(columns, count, n, push, slip, dt, work):
    """Map a zonotope by exp(N dt) to second order and add a box of inputs.

    Parameters
    ----------
    columns : ndarray, shape (4, COLUMNS)
        The zonotope; changed in place.
    count : int
        Columns in use.
    n : ndarray, shape (4, 4)
        N.
    push : ndarray, shape (2,)
        Bounds on the inputs of r_1 and r_2 [rad/s2].
    slip : ndarray, shape (2,)
        Bounds on the inputs of e_1 and e_2: bias of the rates [rad/s].
    dt : float
        Interval [s].
    work : ndarray, shape (4,)
        Scratch.

    Returns
    -------
    int
        Columns in use afterwards.
    """
    step = np.eye(4) + dt * n + 0.5 * dt * dt * (n @ n)
    map_columns(columns, count, step, work)
    for i in range(2):
        columns[:, count] = 0.0
        columns[2 + i, count] = dt * push[i]
        # Half a step's travel of the input, for its effect within the interval.
        columns[i, count] = 0.5 * dt * dt * n[i, 2 + i] * push[i]
        columns[:, count + 1] = 0.0
        columns[i, count + 1] = dt * slip[i]
        count += 2
    if count + 4 > columns.shape[1]:
        count = reduce_columns(columns, count, work)
    return count


class ReachableBound:
    """Bound for method ``exact``: reachable set of the error, plus ``sigmas`` times noise.

    The set holds every error that the unknown torques of a healthy arm (model error, payload,
    friction, mean disturbance) can have caused since the start, whatever their course in time;
    noise is added as a multiple of its designed standard deviation.

    Parameters
    ----------
    arm : ArmParameters
        What a healthy arm may do.
    gains : Gains
        Of method ``exact``.
    sigmas : float
        Standard deviations of noise in the bound.
    friction_uncertainty : float
        Relative uncertainty of Coulomb friction.
    """

    _LARGEST = 10.0
    """A larger set says nothing more [rad]."""

    def __init__(self, arm, gains, sigmas, friction_uncertainty):
        self._arm, self._constants = arm, arm.constants()
        self._kappa = np.ascontiguousarray(gains.observer.kappa)
        self._mu = np.ascontiguousarray(gains.observer.mu)
        self.spread = np.abs(JointMap(arm).sensor_matrix)
        self.noise = sigmas * np.asarray(gains.observer.fault_sigma)
        self._angle_noise = np.linalg.solve(self.spread, self.noise)
        to_angle = np.abs(np.linalg.inv(JointMap(arm).sensor_matrix))
        self._start = sigmas * arm.position_noise * to_angle.sum(axis=1)
        self._drift = (sigmas * arm.velocity_noise * math.sqrt(arm.sample_time)
                       * np.hypot(*to_angle.T))
        self._bias = _RATE_BIAS * arm.velocity_noise * to_angle.sum(axis=1)
        self._unknown = UnknownTorque(arm, friction_uncertainty)
        self._gravity = self._constants[[G_1, G_2]]
        self._inertia = self._constants[[A_11, C_22]]
        self._columns, self._count = np.zeros((4, COLUMNS)), 0
        self._n, self._work, self._extent = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
        self._held_for = np.zeros(2)

    def reset(self):
        """Forget the past: the next estimate is a first one."""
        self._columns[:], self._count = 0.0, 0
        self._held_for[:] = 0.0

    def adopt(self, other):
        """Go on from another bound's past, after new tuning."""
        self._columns[:], self._count = other._columns, other._count
        self._held_for[:] = other._held_for

    def update(self, estimate):
        """Follow the configuration.

        Parameters
        ----------
        estimate : Estimate
            Latest estimate.

        Returns
        -------
        ndarray, shape (2,)
            Bound on abs(f^ - f) per physical sensor [rad].
        """
        if self._count == 0:
            self._columns[0, 0], self._columns[1, 1] = self._start
            self._count = 2
        else:
            self._advance(estimate)
        extent(self._columns, self._count, self._extent)
        error = self._extent[:2] + self._dead_reckoning(estimate)
        return self._sensors(error)

    def _sensors(self, error):
        return self.spread @ np.minimum(error, self._LARGEST) + self.noise

    def _advance(self, estimate):
        if self._extent[:2].max() > self._LARGEST:
            return
        theta, rate = estimate.absolute_position, estimate.absolute_velocity
        acc = estimate.absolute_acceleration
        error_matrix(theta, rate, acc, self._kappa, self._mu, estimate.held, self._arm.sign,
                     self._constants, self._n)
        torque = self._unknown(theta, rate, acc, self._extent[:2] + self._angle_noise)
        steps = max(1, math.ceil(estimate.interval * self._mu.max() / 0.5))
        for _ in range(steps):
            self._count = advance_set(self._columns, self._count, self._n,
                                      torque / self._inertia, self._bias,
                                      estimate.interval / steps, self._work)

    def speed(self):
        """Bound on the speed of each sensor's fault-estimate error, noise apart [rad/s]."""
        angle = self._kappa * self._inertia * np.minimum(self._extent[2:], _FASTEST) + self._bias
        return self.spread @ angle

    def momentum(self):
        """Bound on the momentum error of each link over Xi_ii [rad/s]."""
        return self._extent[2:]

    def _dead_reckoning(self, estimate):
        """Integrated noise of the rates while a link is held [rad]; it is unlearnt as slowly."""
        fall = math.exp(-estimate.interval * float(np.min(
            self._kappa * self._gravity * self._arm.cos_min / self._mu)))
        self._held_for = np.where(estimate.held, self._held_for + estimate.interval,
                                  self._held_for * fall)
        return self._drift * np.sqrt(self._held_for)

    def static(self, theta):
        """Bound at rest in one configuration, after all transients.

        From the comparison system of the error, whose poles are real at every slope.

        Parameters
        ----------
        theta : ndarray, shape (2,)
            Absolute angles [rad].

        Returns
        -------
        ndarray, shape (2,)
            Per physical sensor [rad]; infinite where gravity cannot bound it.
        """
        still, error = np.zeros(2), np.zeros(2)
        # A bias of the rates is held up by a momentum, and that by a torque.
        torque = self._unknown(theta, still, still, still) + self._bias * self._mu / self._kappa
        # Distance from the vertical; the slope falls with it.
        away = np.arccos(np.clip(self._arm.sign * np.cos(theta), -1.0, 1.0))
        for _ in range(100):
            slope = self._gravity * np.cos(np.minimum(away + error + self._angle_noise, math.pi))
            error = np.where(slope > 0.0, torque / np.maximum(slope, 1e-12), math.pi)
            error = np.minimum(error, math.pi)
        error[error >= math.pi] = math.inf
        # Not 0*inf: a sensor that does not see a link does not see its error.
        return np.array([sum(c * e for c, e in zip(row, error) if c) for row in self.spread]
                        ) + self.noise


class LaggedBound:
    """Estimate of the error bound for method ``paper``, whose model errors have no exact form.

    The static error of the configuration, which rises at once and falls at the certified decay
    rate.

    Parameters
    ----------
    arm, gains, sigmas, friction_uncertainty
        As `ReachableBound`.
    """

    def __init__(self, arm, gains, sigmas, friction_uncertainty):
        self._arm, self._decay = arm, gains.observer.decay
        self.spread = np.abs(JointMap(arm).sensor_matrix)
        self.noise = sigmas * np.asarray(gains.observer.fault_sigma)
        self._unknown = UnknownTorque(arm, friction_uncertainty)
        self._gravity = self._unknown.constants[[G_1, G_2]]
        self.e = None

    def reset(self):
        """As `ReachableBound.reset`."""
        self.e = None

    def adopt(self, other):
        """As `ReachableBound.adopt`."""
        self.e = None if other.e is None else other.e.copy()

    def static(self, theta):
        """As `ReachableBound.static`; the slope is clipped to the region."""
        return self.spread @ self._angle_error(theta) + self.noise

    def _angle_error(self, theta):
        torque = self._unknown(theta, *np.zeros((3, 2)))
        return torque / (self._gravity * np.maximum(np.abs(np.cos(theta)), self._arm.cos_min))

    def speed(self):
        """As `ReachableBound.speed`; twice what the error covers at the decay rate."""
        return self.spread @ (2.0 * self._decay * self.e + 0.02)

    def momentum(self):
        """Nothing is known of it."""
        return np.full(2, math.inf)

    def update(self, estimate):
        """As `ReachableBound.update`."""
        target = self._angle_error(estimate.absolute_position)
        if self.e is None:
            self.e = target
        fall = math.exp(-self._decay * estimate.interval)
        self.e = np.maximum(target, target + fall * (self.e - target))
        return self.spread @ self.e + self.noise


def make_bound(arm, gains, sigmas, friction_uncertainty):
    """The bound that belongs to the gains' method.

    Parameters
    ----------
    arm, gains, sigmas, friction_uncertainty
        As `ReachableBound`.

    Returns
    -------
    ReachableBound or LaggedBound
        Without a past.
    """
    kind = ReachableBound if gains.observer.method == 'exact' else LaggedBound
    return kind(arm, gains, sigmas, friction_uncertainty)
