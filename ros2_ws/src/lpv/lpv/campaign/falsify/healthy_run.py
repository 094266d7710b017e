"""One healthy run of any arm, compiled: motion, true arm, sensors.

Machine code that is kept between runs notices changes of its own file (and of lpv.core) only.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.serial_arm.simulation import plant_step
from lpv.core.support.jit import njit

_ROWS = range(9)
CENTRE, SWING, SPEED, PHASE, PUSH, ACCELERATION, SHAKE, RATE_BIAS, RATE_SCALE = _ROWS
"""Rows of `Course.joints`."""


class Course(NamedTuple):
    """Motion, disturbances and errors of the rates in a run."""

    to_joint: FloatArray  # (n, n) joint positions from the angles that follow the motion
    # (9, n) centres and amplitudes of these [rad], circular frequencies [rad/s], phases [rad];
    # torques that the model misses [N m]; accelerations by the disturbance [rad/s2], and standard
    # deviations of their white part; bias [rad/s] and relative error of each sensor's rate
    joints: FloatArray
    rest: float  # from when on the arm comes to rest [s]
    switch_speed: float  # of the sign of what disturbs; 0: constant [rad/s]
    switch_phase: float  # of that sign [rad]
    rate_switch: float  # 1: errors of the rates change their sign with it


class Sensing(NamedTuple):
    """Sensors and drives."""

    to_joint: FloatArray  # (n, n) joint positions from readings
    from_joint: FloatArray  # its inverse
    position_noise: FloatArray  # of readings [rad]
    velocity_noise: FloatArray  # of rates [rad/s]
    quantization: FloatArray  # steps [rad]
    derived: FloatArray  # 1 for rates derived from readings
    period: float  # sample time [s]
    limit: FloatArray  # torques of the drives [N m]


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
    true_arm: Chain,
    course: Course,
    sensing: Sensing,
    substeps: tuple[float, int],  # step [s] and number of steps of integration a sample
    noise: np.random.Generator,  # of sensors and disturbance
    scratch: tuple[FloatArray, FloatArray, FloatArray],  # two of `plant_step`, and a workspace
    samples: FloatArray,  # joint positions, rates and efforts as measured
) -> bool:
    """Fill samples (N, 3, n) of a run; False if the mass matrix is not positive definite."""
    n = samples.shape[2]
    state, goal, wanted, friction = np.zeros((2, n)), np.zeros((3, n)), np.zeros(n), np.zeros(n)
    torque, applied, gain = np.zeros(n), np.zeros(n), min(20.0, 0.1 / sensing.period)
    disturbed = np.abs(course.joints[ACCELERATION : SHAKE + 1]).max() > 0.0
    _follow(course, 0.0, goal)
    state[0], state[1] = goal[0], goal[1]
    for k in range(samples.shape[0]):
        time, sign = k * sensing.period, 1.0
        if course.switch_speed > 0.0:
            sign = 1.0 if math.sin(course.switch_speed * time + course.switch_phase) > 0 else -1.0
        _read(course, sensing, state, torque, sign, noise, samples, k)
        _follow(course, time, goal)
        for i in range(n):
            wanted[i] = goal[2, i] + gain * gain * (goal[0, i] - state[0, i])
            wanted[i] += 2.0 * gain * (goal[1, i] - state[1, i])
        inverse_dynamics(true_arm, state[0], state[1], wanted, scratch[2], torque)
        friction_torque(true_arm, state[1], torque, friction)
        if disturbed:
            # Torques that a disturbance of the accelerations is the same as.
            white = noise.standard_normal()
            for i in range(n):
                wanted[i] += sign * course.joints[ACCELERATION, i] + course.joints[SHAKE, i] * white
            inverse_dynamics(true_arm, state[0], state[1], wanted, scratch[2], applied)
        for i in range(n):
            push = applied[i] - torque[i] if disturbed else 0.0
            torque[i] = min(max(torque[i] + friction[i], -sensing.limit[i]), sensing.limit[i])
            applied[i] = torque[i] + push + sign * course.joints[PUSH, i]
        if not plant_step(
            true_arm, state, applied, substeps[0], substeps[1], scratch[0], scratch[1]
        ):
            return False
    return True


@njit
def _read(
    course: Course,
    sensing: Sensing,
    state: FloatArray,
    torque: FloatArray,
    sign: float,
    noise: np.random.Generator,
    samples: FloatArray,
    k: int,
) -> None:
    """Readings of one sample."""
    n = torque.shape[0]
    position, rate = np.zeros(n), np.zeros(n)
    for i in range(n):
        position[i] = sensing.position_noise[i] * noise.standard_normal()
        true_rate = 0.0
        for j in range(n):
            true_rate += sensing.from_joint[i, j] * state[1, j]
        wrong = course.joints[RATE_BIAS, i] + course.joints[RATE_SCALE, i] * true_rate
        rate[i] = wrong * (sign if course.rate_switch > 0.5 else 1.0)
        rate[i] += sensing.velocity_noise[i] * noise.standard_normal()
    for i in range(n):
        reading, derivative = state[0, i], state[1, i]
        for j in range(n):
            reading += sensing.to_joint[i, j] * position[j]
            derivative += sensing.to_joint[i, j] * rate[j]
        step = sensing.quantization[i]
        if step > 0.0:
            reading = np.round(reading / step) * step
        if sensing.derived[i] > 0.0:
            before = samples[k - 1, 0, i] if k > 0 else reading - state[1, i] * sensing.period
            derivative = (reading - before) / sensing.period
        samples[k, 0, i], samples[k, 1, i], samples[k, 2, i] = reading, derivative, torque[i]
