"""One healthy run, compiled: an arm within its file against its own threshold.

All compiled functions of this package are in this file: machine code that is kept between runs
notices changes of its own file (and of lpv_core) only.
"""

import math

import numpy as np

from lpv_core.bound.error_bound import BOUND_CONSTANTS, BOUND_STATE, reset_bound, update_bound
from lpv_core.model.arm import ARM_CONSTANTS
from lpv_core.model.dynamics import inverse_dynamics, rk4_step
from lpv_core.model.joints import joint_angle, row_dot
from lpv_core.observer.sampled_observer import (
    ESTIMATE,
    NANOSECONDS,
    OBSERVER_CONSTANTS,
    OBSERVER_STATE,
    observe,
    reset_observer,
)
from lpv_core.residual.dead_reckoning import (
    RECKONING_CONSTANTS,
    RECKONING_STATE,
    reset_reckoning,
    update_dead_reckoning,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type

ATTACK = record_type(
    ('true_arm', ARM_CONSTANTS),
    ('centre', 'f8', (2,)),  # of the motion, absolute angles [rad]
    ('swing', 'f8', (2,)),  # its amplitudes [rad]
    ('speed', 'f8', (2,)),  # its circular frequencies [rad/s]
    ('phase', 'f8', (2,)),  # [rad]
    ('rest', 'f8'),  # the arm stops there after this share of the run
    ('disturbance', 'f8'),  # mean of d, with its sign
    ('disturbance_speed', 'f8'),  # of its bang-bang changes of sign [rad/s]; 0 for constant
    ('disturbance_phase', 'f8'),  # [rad]
    ('rate_scale', 'f8', (2,)),  # relative errors of the rate sensors
    ('rate_bias', 'f8', (2,)),  # [rad/s]
    ('rate_switch', 'f8'),  # 1: errors of the rates change their sign with the disturbance
    ('seed', 'i8'),  # of the noise
)
"""A motion, a true arm and time profiles that the arm file allows."""

SETUP = record_type(
    ('arm', ARM_CONSTANTS),  # nominal
    ('observer', OBSERVER_CONSTANTS),
    ('reckoning', RECKONING_CONSTANTS),
    ('bound', BOUND_CONSTANTS),
    ('sample_time', 'f8'),  # [s]
    ('stiffness', 'f8'),  # bandwidth of the loop that keeps the arm on its motion [1/s]
    ('torque_limit', 'f8', (2,)),  # joint torques [N m]
    ('direction', 'f8', (2,)),  # Bd
    ('push_deviation', 'f8'),  # standard deviation of d
    ('position_noise', 'f8'),  # [rad]
    ('velocity_noise', 'f8'),  # [rad/s]
    ('factor', 'f8'),  # threshold over bound
    ('smallest', 'f8'),  # smallest threshold [rad]
    ('largest', 'f8'),  # larger bounds are no evidence [rad]
)
"""What does not change between the runs of one search."""

WORK = record_type(
    ('observer', OBSERVER_STATE),
    ('estimate', ESTIMATE),
    ('reckoning', RECKONING_STATE),
    ('bound', BOUND_STATE),
    ('ratio', 'f8'),  # result: largest abs(f^)/threshold
    ('sensor', 'i8'),  # whose
    ('stamp', 'i8'),  # when [ns]
    ('threshold', 'f8'),  # there [rad]
    ('judged', 'f8'),  # share of the samples with a threshold that says something
)


@njit
def run_healthy(
    setup: np.record,
    attack: np.record,
    work: np.record,
    noise: np.random.Generator,
    samples: np.ndarray,
) -> None:
    """Simulate an attack; the largest ratio of estimate and threshold goes into ``work``.

    Parameters
    ----------
    setup, attack, work : numpy.record
        Of types `SETUP`, `ATTACK` and `WORK`.
    noise : numpy.random.Generator
        Of noise and disturbance.
    samples : ndarray, shape (n, 12)
        Its length is that of the run; receives measured joint positions, rates and efforts
        and true joint positions, f^ and thresholds.
    """
    reset_observer(work.observer)
    reset_bound(work.bound)
    reset_reckoning(work.reckoning)
    x, torque, measured = np.zeros(4), np.zeros(2), np.zeros(6)
    goal, rested = np.zeros(6), np.zeros(6)
    _follow(attack, 0.0, goal)
    x[0], x[1], x[2], x[3] = goal[0], goal[1], goal[2], goal[3]
    work.ratio, work.sensor, work.stamp, work.threshold = 0.0, 0, 0, 0.0
    judged, n = 0, len(samples)
    for k in range(n):
        time = k * setup.sample_time
        _measure(setup, attack, x, time, noise, measured)
        stamp = round(time * NANOSECONDS)
        used = observe(
            setup.observer,
            work.observer,
            work.estimate,
            stamp,
            measured[0:2],
            measured[2:4],
            torque,
        )
        if used:
            update_dead_reckoning(setup.reckoning, work.reckoning, work.estimate)
            update_bound(setup.bound, work.bound, work.estimate, work.reckoning)
            judged += _judge(setup, work, stamp, samples[k])
        for i in range(2):
            samples[k, i], samples[k, 2 + i] = measured[i], measured[2 + i]
            samples[k, 4 + i] = torque[i]
            samples[k, 6 + i] = joint_angle(
                setup.observer.recursion.joints, setup.observer.recursion.joints.j, i, x[0], x[1]
            )
        _follow(attack, time, goal)
        if time > attack.rest * n * setup.sample_time:
            _stop(goal, rested, setup.sample_time)
        else:
            rested[:] = goal
        _drive(setup, attack, x, goal, torque)
        _move(setup, attack, x, time, torque, noise)
    work.judged = judged / n


@njit
def _judge(setup: np.record, work: np.record, stamp: int, row: np.ndarray) -> int:
    judged = 0
    for i in range(2):
        bound = work.bound.bound[i]
        threshold = max(setup.factor * bound, setup.smallest)
        row[8 + i], row[10 + i] = work.estimate.fault[i], threshold
        spread = setup.bound.spread
        lost = (work.estimate.held[0] and spread[i, 0] > 0.0) or (
            work.estimate.held[1] and spread[i, 1] > 0.0
        )
        if lost or bound > setup.largest or work.estimate.mode == 2:
            continue
        judged = 1
        ratio = abs(work.estimate.fault[i]) / threshold
        if ratio > work.ratio:
            work.ratio, work.sensor, work.stamp, work.threshold = ratio, i, stamp, threshold
    return judged


@njit
def _sign(attack: np.record, time: float) -> float:
    """Sign of the bang-bang time profile."""
    if attack.disturbance_speed == 0.0:
        return 1.0
    return (
        1.0 if math.sin(attack.disturbance_speed * time + attack.disturbance_phase) >= 0.0 else -1.0
    )


@njit
def _follow(attack: np.record, time: float, goal: np.ndarray) -> None:
    """Angles, rates and accelerations of the motion."""
    for i in range(2):
        angle = attack.speed[i] * time + attack.phase[i]
        goal[i] = attack.centre[i] + attack.swing[i] * math.sin(angle)
        goal[2 + i] = attack.swing[i] * attack.speed[i] * math.cos(angle)
        goal[4 + i] = -attack.swing[i] * attack.speed[i] ** 2 * math.sin(angle)


@njit
def _stop(goal: np.ndarray, rested: np.ndarray, dt: float) -> None:
    """Come to rest from where the motion was left, within some tenths of a second."""
    for i in range(2):
        rate = 0.0 if abs(rested[2 + i]) < 1e-6 else rested[2 + i] * (1.0 - min(1.0, 10.0 * dt))
        goal[4 + i] = -10.0 * rate
        rested[i] += 0.5 * dt * (rested[2 + i] + rate)
        rested[2 + i] = rate
        goal[i], goal[2 + i] = rested[i], rate


@njit
def _measure(
    setup: np.record,
    attack: np.record,
    x: np.ndarray,
    time: float,
    noise: np.random.Generator,
    out: np.ndarray,
) -> None:
    joints = setup.observer.recursion.joints
    sign = _sign(attack, time) if attack.rate_switch > 0.5 else 1.0
    reading_1 = (
        row_dot(joints.sensor, 0, x[0], x[1]) + setup.position_noise * noise.standard_normal()
    )
    reading_2 = (
        row_dot(joints.sensor, 1, x[0], x[1]) + setup.position_noise * noise.standard_normal()
    )
    rate_1, rate_2 = row_dot(joints.sensor, 0, x[2], x[3]), row_dot(joints.sensor, 1, x[2], x[3])
    rate_1 += sign * (attack.rate_scale[0] * rate_1 + attack.rate_bias[0])
    rate_2 += sign * (attack.rate_scale[1] * rate_2 + attack.rate_bias[1])
    rate_1 += setup.velocity_noise * noise.standard_normal()
    rate_2 += setup.velocity_noise * noise.standard_normal()
    for i in range(2):
        out[i] = joint_angle(joints, joints.to_joint, i, reading_1, reading_2)
        out[2 + i] = row_dot(joints.to_joint, i, rate_1, rate_2)


@njit
def _drive(
    setup: np.record, attack: np.record, x: np.ndarray, goal: np.ndarray, torque: np.ndarray
) -> None:
    """Computed torque of the nominal arm on the true state, within the limits."""
    w = setup.stiffness
    a_1 = goal[4] + 2.0 * w * (goal[2] - x[2]) + w * w * (goal[0] - x[0])
    a_2 = goal[5] + 2.0 * w * (goal[3] - x[3]) + w * w * (goal[1] - x[1])
    q_1, q_2 = inverse_dynamics(x[0], x[1], x[2], x[3], a_1, a_2, attack.true_arm)
    torque[0] = min(max(q_1 + q_2, -setup.torque_limit[0]), setup.torque_limit[0])
    torque[1] = min(max(q_2, -setup.torque_limit[1]), setup.torque_limit[1])


@njit
def _move(
    setup: np.record,
    attack: np.record,
    x: np.ndarray,
    time: float,
    torque: np.ndarray,
    noise: np.random.Generator,
) -> None:
    d = attack.disturbance * _sign(attack, time) + setup.push_deviation * noise.standard_normal()
    push = setup.direction[0] * d, setup.direction[1] * d
    now, dt = (x[0], x[1], x[2], x[3]), 0.5 * setup.sample_time
    for _ in range(2):
        now = rk4_step(now, (torque[0] - torque[1], torque[1]), push, dt, attack.true_arm)
    x[0], x[1], x[2], x[3] = now
