"""One healthy run of any arm, compiled: its motion, and what the arm file allows meanwhile.

Machine code that is kept between runs notices changes of its own file (and of lpv.core) only.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import COULOMB, LOAD, FloatArray
from lpv.core.serial_arm.diagnosis.healthy_balance import tolerated
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.simulation.arm_simulator import PlantParts, integrate, read_sensors, set_torque
from lpv.core.support.jit import njit

_ROWS = range(7)
CENTRE, SWING, SPEED, PHASE, PUSH, RATE_BIAS, RATE_SCALE = _ROWS
"""Rows of `Course.joints`."""


class Course(NamedTuple):
    """Motion, disturbances and errors of the rates in a run."""

    to_joint: FloatArray  # (n, n) joint positions from the angles that follow the motion
    # (7, n) centres and amplitudes of these [rad], circular frequencies [rad/s], phases [rad];
    # torques that the model misses, and friction of a joint at rest, over the largest; bias [rad/s]
    # and relative error of each sensor's rate
    joints: FloatArray
    tolerance: FloatArray  # (n, 2, s) speeds [rad/s], torques that the model may miss there [N m]
    # (m, n) signs of these for ``signs_each`` samples each; none: that of ``switch_speed``
    signs: FloatArray
    signs_each: int
    still: FloatArray  # (n,) rates below which a joint that is to rest does so [rad/s]
    before: int  # samples before those, of which late efforts tell
    disturbance: float  # mean of the arm's d
    rest: float  # from when on the arm comes to rest [s]
    switch_speed: float  # of the sign of what disturbs; 0: constant [rad/s]
    switch_phase: float  # of that sign [rad]
    rate_switch: float  # 1: errors of the rates change their sign with it


@njit
def _follow(course: Course, time: float, goal: FloatArray) -> None:
    """Joint positions, rates and accelerations; from ``rest`` on the motion fades within 0.3 s."""
    fade, slope, bend = 1.0, 0.0, 0.0
    age = (time - course.rest) / 0.3
    if age > 0.0:
        # Time itself slows down: phase(t) = speed * s(t), s' = fade.
        age = min(age, 1.0)
        fade = (1.0 - age) ** 2
        slope = -2.0 * (1.0 - age) / 0.3
        bend = 0.3 * (1.0 - (1.0 - age) ** 3) / 3.0
    moved = time if age <= 0.0 else course.rest + bend
    goal[:] = 0.0
    for j in range(goal.shape[1]):
        swing, speed = course.joints[SWING, j], course.joints[SPEED, j]
        angle = speed * moved + course.joints[PHASE, j]
        bow, climb = swing * math.sin(angle), swing * speed * math.cos(angle)
        for i in range(goal.shape[1]):
            share = course.to_joint[i, j]
            goal[0, i] += share * (course.joints[CENTRE, j] + bow)
            goal[1, i] += share * climb * fade
            goal[2, i] += share * (climb * slope - speed * speed * bow * fade * fade)


@njit
def simulate(
    plant: PlantParts,  # with faults that are an error of each sensor's rate
    course: Course,
    noise: np.random.Generator,  # of sensors and disturbance
    samples: FloatArray,  # joint positions, rates and efforts as measured
) -> bool:
    """Fill samples (N, 3, n) of a run; False if the mass matrix is not positive definite."""
    params, state, true_arm, n = plant.constants, plant.state, plant.chain, samples.shape[2]
    own, work = state.own[0], plant.scratch[:n]
    goal, wanted, friction = np.zeros((3, n)), np.zeros(n), np.zeros(n)
    torque, gain = np.zeros(n), min(20.0, 0.1 / params.sample_time)
    pushes, stuck = np.zeros(n), np.zeros(n)
    _follow(course, -course.before * params.sample_time, goal)
    state.motion[:], state.torque[:], state.reading[:] = goal[:2], 0.0, 0.0
    own.step_count, own.failed = 0, False
    for k in range(samples.shape[0]):
        time, sign = (k - course.before) * params.sample_time, 1.0
        if course.switch_speed > 0.0:
            sign = 1.0 if math.sin(course.switch_speed * time + course.switch_phase) > 0 else -1.0
        for i in range(n):
            wrong = course.joints[RATE_BIAS, i]
            for j in range(n):
                wrong += course.joints[RATE_SCALE, i] * params.sensor[i, j] * state.motion[1, j]
            plant.faults[i].amount = wrong * (sign if course.rate_switch > 0.5 else 1.0)
        read_sensors(plant, noise, noise)
        _follow(course, time, goal)
        for i in range(n):
            samples[k, 0, i] = state.measured_position[i]
            samples[k, 2, i] = state.effort[i] + stuck[i] / params.effort_gain[i]
            samples[k, 1, i] = state.measured_velocity[i]
            wanted[i] = goal[2, i] + gain * gain * (goal[0, i] - state.motion[0, i])
            wanted[i] += 2.0 * gain * (goal[1, i] - state.motion[1, i])
        inverse_dynamics(true_arm, state.motion[0], state.motion[1], wanted, work, torque)
        friction_torque(true_arm, state.motion[1], torque, friction)
        for i in range(n):
            row, push = true_arm.friction[i], sign * course.joints[PUSH, i]
            if course.signs.shape[0] > 0:
                at = max(k - course.before, 0) // course.signs_each
                at = min(at, course.signs.shape[0] - 1)
                push = course.joints[PUSH, i] * course.signs[at, i]
            speed, stuck[i] = abs(state.motion[1, i]), 0.0
            # Friction at rest takes what the drive does too much.
            if goal[1, i] == 0.0 and speed < course.still[i]:
                stuck[i] = -push * (row[COULOMB] + row[LOAD] * abs(torque[i]))
            torque[i] += friction[i]
            pushes[i] = push * tolerated(course.tolerance[i], speed, speed)
        own.push_mean = sign * course.disturbance
        set_torque(plant, torque, noise)
        for i in range(n):
            torque[i] = state.torque[i] + pushes[i]
        integrate(plant, torque)
        if own.failed:
            return False
    return True
