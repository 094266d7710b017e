"""One healthy run of a serial arm, compiled: motion, true arm, sensors.

Machine code that is kept between runs notices changes of its own file (and of lpv_core) only.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import Chain, FloatArray
from lpv_core.serial_arm.dynamics.friction import friction_torque
from lpv_core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv_core.serial_arm.simulation import plant_step
from lpv_core.support.jit import njit

CENTRE, SWING, SPEED, PHASE, PUSH, RATE_BIAS = range(6)
"""Rows of `Course.joints`."""


class Course(NamedTuple):
    """Motion and time profiles of a run."""

    # (6, n) centres and amplitudes of the motion [rad], circular frequencies [rad/s], phases [rad];
    # largest torques that the model misses [N m], biases of the rates [rad/s]
    joints: FloatArray
    rest: float  # from when on the arm comes to rest [s]
    switch_speed: float  # of the sign of the torques that the model misses; 0: constant [rad/s]
    switch_phase: float  # of that sign [rad]


class Sensing(NamedTuple):
    """Sensors: noise of readings [rad] and rates [rad/s], steps [rad], 1 for derived rates."""

    position_noise: FloatArray
    velocity_noise: FloatArray
    quantization: FloatArray
    derived: FloatArray
    period: float  # sample time [s]
    limit: FloatArray  # torques of the drives [N m]


@njit
def _follow(course: Course, time: float, goal: FloatArray) -> None:
    """Angles, rates and accelerations of the motion; from ``rest`` on it fades within 0.3 s."""
    fade, slope, bend = 1.0, 0.0, 0.0
    age = (time - course.rest) / 0.3
    if age > 0.0:
        # Time itself slows down: phase(t) = speed * s(t), s' = fade.
        age = min(age, 1.0)
        fade = (1.0 - age) ** 2
        slope = -2.0 * (1.0 - age) / 0.3
        bend = 0.3 * (1.0 - (1.0 - age) ** 3) / 3.0
    moved = time if age <= 0.0 else course.rest + bend
    for i in range(goal.shape[1]):
        swing, speed = course.joints[SWING, i], course.joints[SPEED, i]
        angle = speed * moved + course.joints[PHASE, i]
        goal[0, i] = course.joints[CENTRE, i] + swing * math.sin(angle)
        goal[1, i] = swing * speed * math.cos(angle) * fade
        goal[2, i] = (
            swing * speed * (math.cos(angle) * slope - speed * math.sin(angle) * fade * fade)
        )


@njit
def simulate(
    true_arm: Chain,
    course: Course,
    sensing: Sensing,
    substeps: tuple[float, int],
    noise: np.random.Generator,
    scratch: tuple[FloatArray, FloatArray, FloatArray],
    samples: FloatArray,
) -> bool:
    """Fill the samples of a run.

    Parameters
    ----------
    true_arm : Chain
        The arm; the loop that moves it knows it.
    course : Course
        What it does.
    sensing : Sensing
        Its sensors and drives.
    substeps : tuple
        Step [s] and number of steps of integration a sample.
    noise : numpy.random.Generator
        Of the sensors.
    scratch : tuple of ndarray
        As of `plant_step`, and a workspace.
    samples : ndarray, shape (N, 3, n)
        Written: readings, rates, efforts.

    Returns
    -------
    bool
        False if the mass matrix was not positive definite.
    """
    n = samples.shape[2]
    state, goal, wanted, friction = np.zeros((2, n)), np.zeros((3, n)), np.zeros(n), np.zeros(n)
    torque, applied, gain = np.zeros(n), np.zeros(n), min(20.0, 0.1 / sensing.period)
    _follow(course, 0.0, goal)
    state[0], state[1] = goal[0], goal[1]
    for k in range(samples.shape[0]):
        time = k * sensing.period
        _read(course, sensing, state, torque, noise, samples, k)
        _follow(course, time, goal)
        for i in range(n):
            wanted[i] = goal[2, i] + gain * gain * (goal[0, i] - state[0, i])
            wanted[i] += 2.0 * gain * (goal[1, i] - state[1, i])
        inverse_dynamics(true_arm, state[0], state[1], wanted, scratch[2], torque)
        friction_torque(true_arm, state[1], torque, friction)
        sign = 1.0
        if course.switch_speed > 0.0:
            sign = 1.0 if math.sin(course.switch_speed * time + course.switch_phase) > 0 else -1.0
        for i in range(n):
            wish = torque[i] + friction[i]
            torque[i] = min(max(wish, -sensing.limit[i]), sensing.limit[i])
            applied[i] = torque[i] + sign * course.joints[PUSH, i]
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
    noise: np.random.Generator,
    samples: FloatArray,
    k: int,
) -> None:
    """Readings of one sample."""
    for i in range(torque.shape[0]):
        reading = state[0, i] + sensing.position_noise[i] * noise.standard_normal()
        rate = state[1, i] + course.joints[RATE_BIAS, i]
        rate += sensing.velocity_noise[i] * noise.standard_normal()
        step = sensing.quantization[i]
        if step > 0.0:
            reading = np.round(reading / step) * step
        if sensing.derived[i] > 0.0:
            before = samples[k - 1, 0, i] if k > 0 else reading - state[1, i] * sensing.period
            rate = (reading - before) / sensing.period
        samples[k, 0, i], samples[k, 1, i], samples[k, 2, i] = reading, rate, torque[i]
