"""The tracking law of all arms: their model, feedback with integral action, limits of torques.

    tau = M(q) a + C(q, v) v + g(q) + F(v_r) + K x,
    a = q_r'' + kd (v_r - v) + kp (q_r - q) + ki eps,    eps' = q_r - y.

Computed torque takes the model at the measured state, with K = 0.  Designed gains K act on
x = (q - q_r, v - v_r, eps), with the model along the reference and kp = kd = ki = 0; or on the
state itself without a model, as eq. (65) does literally.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import record_type

NO_MODEL, AT_STATE, AT_REFERENCE = range(3)
"""Where the model of the arm is taken."""


def law_type(joints: int) -> np.dtype:
    """Record type of the law: gains and state."""
    return record_type(
        ('model', 'u1'),  # where it is taken
        ('kp', 'f8'),  # [1/s2]
        ('kd', 'f8'),  # [1/s]
        ('ki', 'f8'),  # [1/s3]
        ('gains', 'f8', (joints, 3 * joints)),  # K [N m/rad], [N m s/rad], [N m/(rad s)]
        ('zero', 'f8', (joints,)),  # joint positions that are 0 for K without a model [rad]
        ('limit', 'f8', (joints,)),  # of the joint torques [N m]
        ('integral', 'f8', (joints,)),  # eps [rad s]
        ('torque', 'f8', (joints,)),  # of the last command [N m]
        ('saturated', '?'),  # whether they met a limit
        ('acceleration', 'f8', (joints,)),  # work space: a [rad/s2]
        ('x', 'f8', (3 * joints,)),  # work space
        ('friction', 'f8', (joints,)),  # work space [N m]
        ('step', 'f8', (joints,)),  # work space: step of eps [rad s]
    )


class LawParts(NamedTuple):
    """What the law is made of."""

    chain: Chain  # the arm's model
    state: np.ndarray  # memory of a record of `law_type`
    work: FloatArray  # from `lpv.core.serial_arm.chain.workspace`


@njit
def track(
    parts: LawParts,
    reference: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    integrated: FloatArray,
    interval: float,
) -> None:
    """Write one command, the torques [N m], into ``parts.state``.

    Parameters
    ----------
    parts : LawParts
        The law.
    reference : ndarray, shape (3, n)
        Positions, rates and accelerations [rad], [rad/s], [rad/s2].
    position, velocity : ndarray, shape (n,)
        State to feed back, joint coordinates, contiguous [rad], [rad/s].
    integrated : ndarray, shape (n,)
        Position that eps integrates, contiguous [rad].
    interval : float
        Time since the previous command [s]; 0 at the first.
    """
    chain, state, n = parts.chain, parts.state[0], position.shape[0]
    torque, x, a = state.torque, state.x, state.acceleration
    for i in range(n):
        state.step[i] = interval * (reference[0, i] - integrated[i])
        x[i], x[n + i] = position[i] - reference[0, i], velocity[i] - reference[1, i]
        x[2 * n + i] = state.integral[i] + state.step[i]
        a[i] = reference[2, i] - state.kd * x[n + i] - state.kp * x[i] + state.ki * x[2 * n + i]
        if state.model == NO_MODEL:
            x[i], x[n + i], torque[i] = position[i] - state.zero[i], velocity[i], 0.0
    if state.model == AT_STATE:
        inverse_dynamics(chain, position, velocity, a, parts.work, torque)
    elif state.model == AT_REFERENCE:
        inverse_dynamics(chain, reference[0], reference[1], a, parts.work, torque)
    if state.model != NO_MODEL:
        # Friction along the reference: noise of rates around zero would make it chatter.
        friction_torque(chain, reference[1], torque, state.friction)
        for i in range(n):
            torque[i] += state.friction[i]
    if state.model != AT_STATE:
        for i in range(n):
            for j in range(3 * n):
                torque[i] += state.gains[i, j] * x[j]
    _apply_limits(state)


@njit
def _apply_limits(state: np.record) -> None:
    """Clip torques to their limits [N m], and integrate eps where none is met."""
    state.saturated, limit = False, state.limit
    for i in range(limit.shape[0]):
        wanted = state.torque[i]
        state.torque[i] = min(max(wanted, -limit[i]), limit[i])
        if state.torque[i] != wanted:
            state.saturated = True
    if not state.saturated:
        # Conditional integration: no wind-up at the limit.
        for i in range(limit.shape[0]):
            state.integral[i] += state.step[i]
