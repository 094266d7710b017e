"""Rigid-body dynamics of the arm in absolute angles, eqs. (1)-(3), with friction.

``Xi(theta) theta'' + O(theta, theta') theta' + g(theta) + friction = Q + Xi(theta) Bd2 d``

Eq. (3) of the paper lost a factor g in its gravity term; eq. (7) has it, and so has this module.
All functions take ``params`` as of `lpv.core.serial_arm.two_links.ArmParameters.constants`.
"""

import math
from typing import Any

import numpy as np

from lpv.core.serial_arm.dynamics.friction import smooth_sign
from lpv.core.support.inequalities import SAME
from lpv.core.support.jit import njit_in_place as njit

Pair = Any
"""Values of both links: an array or a tuple, of which the first two count."""


@njit
def coupling(theta: Pair, params: np.record) -> float:
    """Off-diagonal inertia Xi12 = o + m2*L1*Lc2*phi1, phi1 = cos(theta1 - theta2), eq. (6)."""
    return params.rotor_coupling + params.coupling * math.cos(theta[0] - theta[1])


@njit
def solve_inertia(off: float, first: float, second: float, params: np.record) -> tuple[float, ...]:
    """Xi^-1 times a vector, where Xi12 = off."""
    det = params.inertia[0] * params.inertia[1] - off * off
    return (
        (params.inertia[1] * first - off * second) / det,
        (params.inertia[0] * second - off * first) / det,
    )


@njit
def _joint_friction(i: int, rate: float, torque: float, params: np.record) -> float:
    """Friction of a joint whose drive gives a torque."""
    slip = smooth_sign(rate, params.coulomb_slope[i])
    free = params.offset[i] + params.viscous[i] * rate + params.coulomb[i] * slip
    loaded = params.load[i] * slip
    if loaded == 0.0:
        return free
    # Of the drive's torque x = c + loaded abs(c) the gear carries c.
    torque -= free
    torque /= max(1.0 + math.copysign(loaded, loaded * torque), SAME)
    return free + loaded * abs(torque)


@njit
def friction(rate: Pair, torque: Pair, params: np.record) -> tuple[float, ...]:
    """Joint friction J^T tau_f [N m] at absolute rates theta' [rad/s] and generalised torques Q
    that the drives give [N m]."""
    tau_1 = _joint_friction(0, rate[0], torque[0] + torque[1], params)
    tau_2 = _joint_friction(1, rate[1] - rate[0], torque[1], params)
    return tau_1 - tau_2, tau_2


@njit
def rigid_torque(theta: Pair, rate: Pair, acc: Pair, params: np.record) -> tuple[float, ...]:
    """Generalised torques Q [N m] of a motion without friction, eq. (1).

    Absolute angles, rates and accelerations are in rad, rad/s and rad/s2.
    """
    off = coupling(theta, params)
    swirl = params.coriolis * params.coupling * math.sin(theta[0] - theta[1])
    gravity_1 = params.gravity[0] * math.sin(theta[0])
    gravity_2 = params.gravity[1] * math.sin(theta[1])
    return (
        params.inertia[0] * acc[0] + off * acc[1] + swirl * rate[1] * rate[1] - gravity_1,
        off * acc[0] + params.inertia[1] * acc[1] - swirl * rate[0] * rate[0] - gravity_2,
    )


@njit
def acceleration(theta: Pair, rate: Pair, torque: Pair, params: np.record) -> tuple[float, ...]:
    """Absolute accelerations theta'' [rad/s2] without disturbance, eq. (1) solved for them.

    Absolute angles and rates are in rad and rad/s, generalised torques Q in N m.
    """
    friction_1, friction_2 = friction(rate, torque, params)
    rest_1, rest_2 = rigid_torque(theta, rate, (0.0, 0.0), params)
    force_1, force_2 = torque[0] - friction_1 - rest_1, torque[1] - friction_2 - rest_2
    return solve_inertia(coupling(theta, params), force_1, force_2, params)
