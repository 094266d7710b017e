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
COSINE, SINE, ANGLE = range(3)
"""Rows of a pose, shape (3, 3): of theta1, theta2 and theta1 - theta2.  In place of the last angle
is whether there are any."""


@njit
def set_pose(pose: np.ndarray, theta: Pair) -> None:
    """Write cosines and sines of absolute angles, which many terms share, unless they are there."""
    if pose[ANGLE, 2] == 1.0 and pose[ANGLE, 0] == theta[0] and pose[ANGLE, 1] == theta[1]:
        return
    pose[ANGLE, 2] = 1.0
    for i in range(2):
        pose[ANGLE, i] = theta[i]
        pose[COSINE, i], pose[SINE, i] = math.cos(theta[i]), math.sin(theta[i])
    difference = theta[0] - theta[1]
    pose[COSINE, 2], pose[SINE, 2] = math.cos(difference), math.sin(difference)


@njit
def coupling(pose: np.ndarray, params: np.record) -> float:
    """Off-diagonal inertia Xi12 = o + m2*L1*Lc2*phi1, phi1 = cos(theta1 - theta2), eq. (6)."""
    return params.rotor_coupling + params.coupling * pose[COSINE, 2]


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
    is_dry = params.coulomb[i] != 0.0 or params.load[i] != 0.0
    slip = smooth_sign(rate, params.coulomb_slope[i]) if is_dry else 0.0
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
def rigid_torque(pose: np.ndarray, rate: Pair, acc: Pair, params: np.record) -> tuple[float, ...]:
    """Generalised torques Q [N m] of a motion without friction, eq. (1).

    Absolute rates and accelerations are in rad/s and rad/s2.
    """
    off = coupling(pose, params)
    swirl = params.coriolis * params.coupling * pose[SINE, 2]
    gravity_1 = params.gravity[0] * pose[SINE, 0]
    gravity_2 = params.gravity[1] * pose[SINE, 1]
    return (
        params.inertia[0] * acc[0] + off * acc[1] + swirl * rate[1] * rate[1] - gravity_1,
        off * acc[0] + params.inertia[1] * acc[1] - swirl * rate[0] * rate[0] - gravity_2,
    )


@njit
def acceleration(
    pose: np.ndarray, rate: Pair, torque: Pair, params: np.record
) -> tuple[float, ...]:
    """Absolute accelerations theta'' [rad/s2] without disturbance, eq. (1) solved for them.

    Absolute rates are in rad/s, generalised torques Q in N m.
    """
    friction_1, friction_2 = friction(rate, torque, params)
    rest_1, rest_2 = rigid_torque(pose, rate, (0.0, 0.0), params)
    force_1, force_2 = torque[0] - friction_1 - rest_1, torque[1] - friction_2 - rest_2
    return solve_inertia(coupling(pose, params), force_1, force_2, params)
