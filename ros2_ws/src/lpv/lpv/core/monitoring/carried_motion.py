"""Motion of sensors whose readings jump or are noisy: torques carry it on, readings correct it.

The state of each sensor is what a healthy one would read, its rate, and the acceleration that the
model of the arm misses, which is correlated over `STEADY_FOR` (Singer's model).  How much that is
comes from the balances.  Healthy readings count as they are: none is filtered.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import (
    COULOMB,
    LOAD,
    SLOPE,
    VISCOUS,
    Chain,
    FloatArray,
    compile_chain,
    workspace,
)
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.momentum import mass_matrix, solve_positive
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place


class CarriedMotion(NamedTuple):
    """What is predicted, by sensor, and the model of the arm."""

    acceleration: FloatArray  # of the readings by torques, shape (n,) [rad/s2]
    missed: FloatArray  # acceleration that the model misses, shape (n,) [rad/s2]
    covariance: FloatArray  # of reading, rate and missed acceleration, shape (n, 3, 3)
    rate_noise: FloatArray  # variances of rates with a sensor of their own, shape (n,) [rad2/s2]
    limit: FloatArray  # rates that no joint exceeds, shape (n,) [rad/s]
    chain: Chain
    to_sensors: FloatArray  # S of y = S q + f, shape (n, n)
    to_joints: FloatArray  # S^-1
    joints: FloatArray  # (5, n) work space
    work: FloatArray  # as of `workspace`
    matrix: FloatArray  # (n, n) work space


def new_motion(arm: SerialArm) -> CarriedMotion:
    """Nothing is carried on yet."""
    n, chain, noise = len(arm.joints), compile_chain(arm), arm.sensors().velocity_noise
    acceleration, missed = np.zeros((2, n))
    return CarriedMotion(
        acceleration, missed, np.zeros((n, 3, 3)), noise**2, np.array(arm.velocity_limit), chain,
        arm.joints_to_sensors(), arm.sensors_to_joints(), np.zeros((5, n)), workspace(chain),
        np.zeros((n, n)),
    )  # fmt: skip


@njit_in_place
def accelerate(
    motion: CarriedMotion,
    position: FloatArray,
    velocity: FloatArray,
    torque: FloatArray,
    interval: float,
) -> None:
    """Write accelerations of the readings by the model, for an interval [s] with torques [N m].

    ``position`` and ``velocity``, shape (n,), are those of the sensors.  A torque that is not known
    (NaN) is taken for what the motion needs.
    """
    q, v, a = motion.joints[0], motion.joints[1], motion.joints[2]
    load, friction = motion.joints[3], motion.joints[4]
    chain, n = motion.chain, torque.shape[0]
    map_vector(motion.to_joints, position, q)
    map_vector(motion.to_joints, velocity, v)
    for i in range(v.shape[0]):  # the torques of larger rates would let them grow without end
        v[i] = min(max(v[i], -motion.limit[i]), motion.limit[i])
    a[:] = 0.0
    inverse_dynamics(chain, q, v, a, motion.work, load)
    friction_torque(chain, v, load, friction)
    mass_matrix(chain, q, motion.work, motion.matrix)
    for i in range(n):
        row = chain.friction[i]
        dry, steep = row[COULOMB] + row[LOAD] * abs(load[i]), row[SLOPE]
        slope = row[VISCOUS] + dry * steep * (2.0 / math.pi) / (1.0 + (steep * v[i]) ** 2)
        motion.matrix[i, i] += interval * slope  # linearly implicit: friction at rest is stiff
        a[i] = torque[i] - load[i] - friction[i] if np.isfinite(torque[i]) else 0.0
    if solve_positive(motion.matrix, a):
        map_vector(motion.to_sensors, a, motion.acceleration)


@njit_in_place
def begin(motion: CarriedMotion, i: int, reading: float, rate: float, missed: float) -> None:
    """Begin to carry on a sensor, with variances of its reading, its rate and what is missed."""
    own = motion.covariance[i]
    own[:] = 0.0
    own[0, 0], own[1, 1], own[2, 2] = reading, rate, missed
    motion.missed[i] = 0.0


@njit_in_place
def carry(motion: CarriedMotion, i: int, predicted: float, missed: float, interval: float) -> float:
    """Carry on a sensor over an interval [s]; its acceleration [rad/s2].

    Of accelerations a share is ``predicted`` by torques, the rest has the variance ``missed``.
    """
    kept = math.exp(-interval / priors.STEADY_FOR)
    half, own = 0.5 * interval**2, motion.covariance[i]
    whole = predicted * motion.acceleration[i] + motion.missed[i]
    motion.missed[i] *= kept
    for j in range(3):  # F P
        own[0, j] += interval * own[1, j] + half * own[2, j]
        own[1, j] += interval * own[2, j]
        own[2, j] *= kept
    for j in range(3):  # F P F^T
        own[j, 0] += interval * own[j, 1] + half * own[j, 2]
        own[j, 1] += interval * own[j, 2]
        own[j, 2] *= kept
    own[2, 2] += (1.0 - kept * kept) * missed
    return float(whole)


@njit_in_place
def correct(
    motion: CarriedMotion, i: int, row: int, innovation: float, noise: float
) -> tuple[float, float]:
    """Corrections of reading and rate by a reading (row 0) or a rate (row 1), with its variance."""
    own = motion.covariance[i]
    first, second, third = own[0, row], own[1, row], own[2, row]
    variance = own[row, row] + noise
    share = innovation / variance
    motion.missed[i] += third * share
    for j in range(3):
        other = own[j, row] / variance
        own[j, 0] -= other * first
        own[j, 1] -= other * second
        own[j, 2] -= other * third
    return first * share, second * share
