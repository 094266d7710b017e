"""Computed torque: tracking control of serial arms by inverse dynamics.

tau = M(q) a + C(q, v) v + g(q) + F(v_r), a = q_r'' + kd (v_r - v) + kp (q_r - q) + ki eps,
eps' = q_r - q.

With the true model the error of every joint has three poles at -w, w the bandwidth: kd = 3 w,
kp = 3 w^2, ki = w^3.  For a wrong model see
`lpv.core.serial_arm.certificate`.
"""

import numpy as np

from lpv.core.control.latency import loop_latency
from lpv.core.control.tracking_law import LawParts, TrackingLaw, apply_limits
from lpv.core.serial_arm.chain import FloatArray, compile_chain, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import memory, new_record, record_type

BANDWIDTH = 10.0
"""Default [rad/s]."""


def computed_torque_type(joints: int) -> np.dtype:
    """Record type of the controller: gains and state."""
    return record_type(
        ('kp', 'f8'),  # [1/s2]
        ('kd', 'f8'),  # [1/s]
        ('ki', 'f8'),  # [1/s3]
        ('limit', 'f8', (joints,)),  # of the joint torques [N m]
        ('integral', 'f8', (joints,)),  # eps [rad s]
        ('torque', 'f8', (joints,)),  # of the last command [N m]
        ('saturated', '?'),  # whether they met a limit
        ('acceleration', 'f8', (joints,)),  # work space: a [rad/s2]
        ('friction', 'f8', (joints,)),  # work space [N m]
        ('step', 'f8', (joints,)),  # work space: step of eps [rad s]
    )


@njit
def computed_torque(
    parts: LawParts,
    reference: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    integrated: FloatArray,
    interval: float,
) -> None:
    """One torque command, into ``parts.state``; the rest is as of `TrackingLaw.answer`."""
    chain, state, n = parts.chain, parts.state[0], position.shape[0]
    for i in range(n):
        state.step[i] = interval * (reference[0, i] - integrated[i])
        state.acceleration[i] = (
            reference[2, i]
            + state.kd * (reference[1, i] - velocity[i])
            + state.kp * (reference[0, i] - position[i])
            + state.ki * (state.integral[i] + state.step[i])
        )
    inverse_dynamics(chain, position, velocity, state.acceleration, parts.work, state.torque)
    # Friction along the reference: noise of rates around zero would make it chatter.
    friction_torque(chain, reference[1], state.torque, state.friction)
    for i in range(n):
        state.torque[i] += state.friction[i]
    apply_limits(state, state.limit)


class ComputedTorqueController(TrackingLaw):
    """Computed torque with PD and integral action.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    bandwidth : float, optional
        Distance of the loop's three poles from zero, with a true model [rad/s].

    Attributes
    ----------
    tolerated_latency, integrates_measurement
        As of `lpv.core.control.tracking.TrackingController`.

    Raises
    ------
    ConfigError
        If the sampled loop with this bandwidth is not stable.
    """

    integrates_measurement = False

    def __init__(self, arm: SerialArm, bandwidth: float = BANDWIDTH) -> None:
        gains = _triple_pole(bandwidth)
        self.tolerated_latency = serial_loop_latency(bandwidth, arm.sample_time)
        if self.tolerated_latency < arm.sample_time:
            raise ConfigError(
                'bandwidth', f'{bandwidth:g} rad/s is unstable at {arm.sample_time:g} s a sample'
            )
        state = new_record(
            computed_torque_type(len(arm.joints)),
            ki=gains[0],
            kp=gains[1],
            kd=gains[2],
            limit=arm.torque_limit,
        )
        chain = compile_chain(arm)
        parts = LawParts(chain, memory(state), workspace(chain))
        super().__init__(computed_torque, parts)


def serial_loop_latency(bandwidth: float, sample_time: float) -> float:
    """`joint_loop_latency` of a `ComputedTorqueController` [s]."""
    return joint_loop_latency(_triple_pole(bandwidth), sample_time)


def _triple_pole(bandwidth: float) -> np.ndarray:
    """ki, kp, kd."""
    return bandwidth**3 * np.array([1.0, 3.0 / bandwidth, 3.0 / bandwidth**2])


def joint_loop_latency(gains: np.ndarray, sample_time: float) -> float:
    """Longest constant latency with which the loop of one joint is stable, with a true model [s].

    Parameters
    ----------
    gains : ndarray, shape (3,)
        ki, kp, kd.
    sample_time : float
        [s].
    """
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # of eps, q, v
    b = np.array([[0.0], [0.0], [1.0]])
    return loop_latency([(a, b)], -gains[None], sample_time)
