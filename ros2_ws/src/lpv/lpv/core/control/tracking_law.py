"""The tracking law of all arms: their model, feedback with integral action, limits of torques.

    tau = M(q) a + C(q, v) v + g(q) + F(v_r) + K x,
    a = q_r'' + kd (v_r - v) + kp (q_r - q) + ki eps,    eps' = q_r - y.

Computed torque takes the model at the measured state, with K = 0.  Designed gains K act on
x = (q - q_r, v - v_r, eps), with the model along the reference and kp = kd = ki = 0; or on the
state itself without a model, as eq. (65) does literally.
"""

from typing import NamedTuple

from lpv.core.serial_arm.chain import BoolArray, Chain, FloatArray
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit_in_place as njit

NO_MODEL, AT_STATE, AT_REFERENCE = range(3)
"""Where the model of the arm is taken."""


class LawParts(NamedTuple):
    """What the law is made of: model, gains and parts."""

    chain: Chain  # the arm's model
    work: FloatArray  # from `lpv.core.serial_arm.chain.workspace`
    model: int  # where it is taken
    ki: float  # [1/s3]
    kp: float  # [1/s2]
    kd: float  # [1/s]
    gains: FloatArray  # (n, 3 n) K [N m/rad], [N m s/rad], [N m/(rad s)]
    zero: FloatArray  # (n,) joint positions that are 0 for K without a model [rad]
    limit: FloatArray  # (n,) of the joint torques [N m]
    saturated: BoolArray  # (1,) whether the last command met a limit
    x: FloatArray  # (3 n,) work space
    integral: FloatArray  # (n,) eps [rad s]
    torque: FloatArray  # (n,) of the last command [N m]
    acceleration: FloatArray  # (n,) work space: a [rad/s2]
    friction: FloatArray  # (n,) work space [N m]
    step: FloatArray  # (n,) work space: step of eps [rad s]


@njit
def track(
    parts: LawParts,
    reference: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    integrated: FloatArray,
    interval: float,
) -> None:
    """Write one command, the torques [N m], into ``parts.torque``.

    ``reference``, shape (3, n), has positions, rates and accelerations [rad], [rad/s], [rad/s2].
    The others are contiguous, shape (n,), in joint coordinates: ``position`` and ``velocity``, the
    state to feed back [rad], [rad/s], and ``integrated``, the position that eps integrates [rad].
    ``interval`` is the time since the previous command [s]; 0 at the first.
    """
    chain, n = parts.chain, position.shape[0]
    torque, x, a = parts.torque, parts.x, parts.acceleration
    for i in range(n):
        parts.step[i] = interval * (reference[0, i] - integrated[i])
        x[i], x[n + i] = position[i] - reference[0, i], velocity[i] - reference[1, i]
        x[2 * n + i] = parts.integral[i] + parts.step[i]
        a[i] = reference[2, i] - parts.kd * x[n + i] - parts.kp * x[i] + parts.ki * x[2 * n + i]
        if parts.model == NO_MODEL:
            x[i], x[n + i], torque[i] = position[i] - parts.zero[i], velocity[i], 0.0
    if parts.model == AT_STATE:
        inverse_dynamics(chain, position, velocity, a, parts.work, torque)
    elif parts.model == AT_REFERENCE:
        inverse_dynamics(chain, reference[0], reference[1], a, parts.work, torque)
    if parts.model != NO_MODEL:
        # Friction along the reference: noise of rates around zero would make it chatter.
        friction_torque(chain, reference[1], torque, parts.friction)
        for i in range(n):
            torque[i] += parts.friction[i]
    if parts.model != AT_STATE:
        for i in range(n):
            for j in range(3 * n):
                torque[i] += parts.gains[i, j] * x[j]
    _apply_limits(parts)


@njit
def _apply_limits(parts: LawParts) -> None:
    """Clip torques to their limits [N m], and integrate eps where none is met."""
    saturated, limit = False, parts.limit
    for i in range(limit.shape[0]):
        wanted = parts.torque[i]
        parts.torque[i] = min(max(wanted, -limit[i]), limit[i])
        saturated = saturated or parts.torque[i] != wanted
    parts.saturated[0] = saturated
    if not saturated:
        # Conditional integration: no wind-up at the limit.
        for i in range(limit.shape[0]):
            parts.integral[i] += parts.step[i]
