"""Rigid-body dynamics of the arm in absolute angles, eqs. (1)-(3), with friction.

``Xi(theta) theta'' + O(theta, theta') theta' + g(theta) + friction = Q + Xi(theta) Bd2 d``

Eq. (3) of the paper lost a factor g in its gravity term; eq. (7) has it, and so has this module.
All functions take the record of :meth:`lpv_core.model.arm.ArmParameters.constants` as ``params``.
"""

import math

import numpy as np

from lpv_core.model.runge_kutta import State, ahead, weighted
from lpv_core.support.jit import njit

_TWO_OVER_PI = 2.0 / math.pi


@njit
def coupling(theta_1: float, theta_2: float, params: np.record) -> float:
    """Off-diagonal inertia Xi12 = o + m2*L1*Lc2*phi1, phi1 = cos(theta1 - theta2), eq. (6)."""
    return params.rotor_coupling + params.coupling * math.cos(theta_1 - theta_2)


@njit
def friction(rate_1: float, rate_2: float, params: np.record) -> tuple[float, ...]:
    """Joint friction as generalised torques of the absolute angles.

    Parameters
    ----------
    rate_1, rate_2 : float
        Absolute rates theta' [rad/s]; joint rates are (rate_1, rate_2 - rate_1).
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of float
        J^T tau_f [N m].
    """
    relative = rate_2 - rate_1
    tau_1 = params.viscous[0] * rate_1 + params.coulomb[0] * _TWO_OVER_PI * math.atan(
        params.coulomb_slope * rate_1
    )
    tau_2 = params.viscous[1] * relative + params.coulomb[1] * _TWO_OVER_PI * math.atan(
        params.coulomb_slope * relative
    )
    return tau_1 - tau_2, tau_2


@njit
def acceleration(
    theta_1: float,
    theta_2: float,
    rate_1: float,
    rate_2: float,
    torque_1: float,
    torque_2: float,
    params: np.record,
) -> tuple[float, ...]:
    """Absolute accelerations without disturbance, eq. (1) solved for theta''.

    Parameters
    ----------
    theta_1, theta_2 : float
        Absolute angles [rad].
    rate_1, rate_2 : float
        Absolute rates [rad/s].
    torque_1, torque_2 : float
        Generalised torques Q [N m].
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of float
        theta'' [rad/s2].
    """
    off = coupling(theta_1, theta_2, params)
    friction_1, friction_2 = friction(rate_1, rate_2, params)
    swirl = params.coriolis * params.coupling * math.sin(theta_1 - theta_2)
    force_1 = (
        torque_1 - friction_1 - swirl * rate_2 * rate_2 + params.gravity[0] * math.sin(theta_1)
    )
    force_2 = (
        torque_2 - friction_2 + swirl * rate_1 * rate_1 + params.gravity[1] * math.sin(theta_2)
    )
    det = params.inertia[0] * params.inertia[1] - off * off
    return (
        (params.inertia[1] * force_1 - off * force_2) / det,
        (params.inertia[0] * force_2 - off * force_1) / det,
    )


@njit
def inverse_dynamics(
    theta_1: float,
    theta_2: float,
    rate_1: float,
    rate_2: float,
    acc_1: float,
    acc_2: float,
    params: np.record,
) -> tuple[float, ...]:
    """Generalised torques Q that produce the given motion (feed-forward), eq. (1).

    Parameters
    ----------
    theta_1, theta_2, rate_1, rate_2, acc_1, acc_2 : float
        Absolute angles, rates and accelerations [rad], [rad/s], [rad/s2].
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of float
        Q [N m].
    """
    off = coupling(theta_1, theta_2, params)
    friction_1, friction_2 = friction(rate_1, rate_2, params)
    swirl = params.coriolis * params.coupling * math.sin(theta_1 - theta_2)
    return (
        params.inertia[0] * acc_1
        + off * acc_2
        + swirl * rate_2 * rate_2
        - params.gravity[0] * math.sin(theta_1)
        + friction_1,
        off * acc_1
        + params.inertia[1] * acc_2
        - swirl * rate_1 * rate_1
        - params.gravity[1] * math.sin(theta_2)
        + friction_2,
    )


@njit
def energy(
    theta_1: float, theta_2: float, rate_1: float, rate_2: float, params: np.record
) -> float:
    """Kinetic plus potential energy [J]; conserved without torque, friction and disturbance."""
    off = coupling(theta_1, theta_2, params)
    kinetic = 0.5 * (params.inertia[0] * rate_1 * rate_1 + params.inertia[1] * rate_2 * rate_2)
    return (
        kinetic
        + off * rate_1 * rate_2
        + params.gravity[0] * math.cos(theta_1)
        + params.gravity[1] * math.cos(theta_2)
    )


@njit
def _slope(
    x: State, torque: tuple[float, float], push: tuple[float, float], params: np.record
) -> State:
    acc_1, acc_2 = acceleration(x[0], x[1], x[2], x[3], torque[0], torque[1], params)
    return x[2], x[3], acc_1 + push[0], acc_2 + push[1]


@njit
def rk4_step(
    x: State, torque: tuple[float, float], push: tuple[float, float], dt: float, params: np.record
) -> State:
    """Advance the nonlinear arm by one Runge-Kutta step with torques held.

    Parameters
    ----------
    x : tuple of float
        Absolute angles and rates of both links [rad], [rad/s].
    torque : tuple of float
        Generalised torques Q [N m].
    push : tuple of float
        Acceleration Bd*d of the disturbance, eq. (31) [rad/s2].
    dt : float
        Step [s].
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of float
        The absolute state after ``dt``.
    """
    k1 = _slope(x, torque, push, params)
    k2 = _slope(ahead(x, k1, 0.5 * dt), torque, push, params)
    k3 = _slope(ahead(x, k2, 0.5 * dt), torque, push, params)
    k4 = _slope(ahead(x, k3, dt), torque, push, params)
    return weighted(x, k1, k2, k3, k4, dt)
