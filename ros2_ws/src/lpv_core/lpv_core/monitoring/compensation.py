"""Readings of a serial arm with confirmed faults removed, and jumps bridged."""

from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS, NEVER

BRIDGED = 6
"""Samples over which a reading that jumps is carried on by its rate: by then the jump is known."""
_LONGEST_STEP = 10.0
"""Sample times after which nothing is carried on."""


class Compensation(NamedTuple):
    """Work space of one arm; arrays of shape (n,) if not stated otherwise."""

    applied: FloatArray  # fault that is being removed [rad]
    position: FloatArray  # of the sample before, corrected [rad]
    velocity: FloatArray  # of the sample before, corrected [rad/s]
    change: FloatArray  # of that velocity over the last interval [rad/s]
    bridged: IntArray  # samples for which a reading has been carried on
    stamp: IntArray  # of the sample before [ns], shape (1,)


def new_compensation(joints: int) -> Compensation:
    """Nothing is removed yet."""
    applied, position, velocity, change = np.zeros((4, joints))
    bridged, stamp = np.zeros(joints, np.int64), np.array([NEVER])
    return Compensation(applied, position, velocity, change, bridged, stamp)


@njit
def compensate(
    work: Compensation,
    stamps: IntArray,
    measured: FloatArray,
    fault: FloatArray,
    drift: FloatArray,
    limits: FloatArray,
    tuning: tuple[float, float],
    result: FloatArray,
) -> None:
    """Corrected positions and rates of samples in a row.

    What is removed follows the confirmed fault at a limited rate; jumps were added to
    ``work.applied`` by the caller.

    Parameters
    ----------
    work : Compensation
        Changed.
    stamps : ndarray of int64, shape (N,)
        [ns].
    measured : ndarray, shape (N, 2, n)
        Readings and rates [rad], [rad/s].
    fault : ndarray, shape (N, n)
        Confirmed faults [rad].
    drift : ndarray, shape (n,)
        Error of the rates that are derived from the readings [rad/s].
    limits : ndarray, shape (n,)
        Change of a reading that may be a jump [rad].
    tuning : tuple
        Rate at which a fault is faded in and out [rad/s]; sample time [s].
    result : ndarray, shape (N, 3, n)
        Receives corrected positions and rates, and what was removed.
    """
    for k in range(stamps.shape[0]):
        follows = work.stamp[0] != NEVER
        interval = (stamps[k] - work.stamp[0]) / NANOSECONDS if follows else 0.0
        follows = follows and interval < _LONGEST_STEP * tuning[1]
        for i in range(fault.shape[1]):
            step = (tuning[0] + abs(drift[i])) * interval
            change = fault[k, i] - work.applied[i]
            work.applied[i] += min(max(change, -step), step)
            position = measured[k, 0, i] - work.applied[i]
            velocity = measured[k, 1, i] - drift[i]
            limit = limits[i] + 2.0 * interval * abs(work.change[i])
            carried = work.position[i] + interval * work.velocity[i]
            if follows and work.bridged[i] < BRIDGED and abs(position - carried) > limit:
                position = carried
                if abs(velocity - work.velocity[i]) * interval > limit:
                    velocity = work.velocity[i]
                work.bridged[i] += 1
            elif abs(position - carried) <= limit:
                work.bridged[i] = 0
            work.change[i] = velocity - work.velocity[i] if follows else 0.0
            work.position[i], work.velocity[i] = position, velocity
            result[k, 0, i], result[k, 1, i], result[k, 2, i] = position, velocity, work.applied[i]
        work.stamp[0] = stamps[k]
