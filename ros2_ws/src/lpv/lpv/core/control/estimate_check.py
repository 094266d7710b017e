"""Whether the values of an estimate can be an arm's, and how fast a correction of it may change.

A correction, the measured position less the one that is fed back, may be wrong, and so may its end.
`limit_correction` keeps it from moving the arm: what no joint can do is not followed at once but
faded in.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.settings import DiagnosisParameters
from lpv.core.support.jit import Entries
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.timestamps import NANOSECONDS, NEVER

ROWS = ('position', 'compensated_position', 'measured_position', 'velocity', 'measured_velocity')
"""Fields of lpv_msgs/StateEstimate in the order in which `check_values` takes them."""
_LARGEST = 1e6
"""Positions [rad] and rates [rad/s] that no arm has: a joint without end takes days to turn so far;
rates above the velocity limit are judged by the watchdog."""


NOT_FINITE, IMPOSSIBLE = 1, 2
"""What is wrong with the values of an estimate, or 0."""


@njit
def check_values(values: np.ndarray) -> int:
    """What is wrong with positions and rates, shape (5, n), in the order of `ROWS`; 0: nothing."""
    found = 0
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            if not math.isfinite(values[k, i]):
                return NOT_FINITE
            if abs(values[k, i]) > _LARGEST:
                found = IMPOSSIBLE
    return found


CHANGE_SHARE = 0.25
"""Rate at which a position may leave what the rates say: share of the velocity limit."""
FADING = DiagnosisParameters.compensation_rate
"""Fastest rate at which the rest of such a change reaches the loop [rad/s]."""
REST_SHARE = 0.1
"""Share of the velocity limit: slower is rest, and smaller changes of a rate pass at once."""
_RATE_FADING = 1.0 / MAX_GAP
"""Rate at which the rest of it does: of the velocity limit [1/s]."""
_SIGMAS = 6.0 * math.sqrt(2.0)
"""Change of a reading by noise: six deviations of a difference, once in six days at 1 kHz."""


class Correction(NamedTuple):
    """What `limit_correction` works on; positions and rates are the rows of arrays (2, n)."""

    noise: FloatArray  # change by noise and quantization, at most [rad], [rad/s]
    change: FloatArray  # limit of unexplained changes, by time [rad/s], [rad/s2]
    fading: FloatArray  # [rad/s], [rad/s2]
    stamp: IntArray  # of the sample before [ns], or NEVER, shape (1,)
    before: FloatArray  # the sample before, as estimated
    surplus: FloatArray  # what is not fed back yet
    feedback: FloatArray  # what is to be fed back


def position_noise(arm: SerialArm) -> np.ndarray:
    """Largest change of each joint's measured position at rest, by noise and quantization [rad]."""
    sensors = arm.sensors()
    noise = _SIGMAS * sensors.position_noise + 2.0 * sensors.quantization
    # A joint's position is a combination of readings.
    return np.abs(arm.sensors_to_joints()) @ noise


@njit
def limit_correction(
    record: Correction, stamp: int, position: np.ndarray, velocity: np.ndarray
) -> None:
    """Position and rate to feed back, the rows of ``record.feedback``.

    A joint moves as its rate says, and its rate changes smoothly.  What else a position or a rate
    changes, by more than noise and ``record.change``, is a change of its correction: the loop gets
    it faded in, so that torques do not jump.  A start, with ``record.stamp`` NEVER, takes both as
    they are.  Positions and rates are in [rad] and [rad/s], ``stamp`` in [ns].
    """
    starts = record.stamp[0] == NEVER
    interval = 0.0 if starts else (stamp - record.stamp[0]) / NANOSECONDS
    for i in range(position.shape[0]):
        moved = 0.5 * interval * (velocity[i] + record.before[1, i])
        for row in range(2):
            value = velocity[i] if row else position[i]
            surplus = 0.0
            if not starts:
                change = value - record.before[row, i] - (0.0 if row else moved)
                most = record.noise[row, i] + interval * record.change[row, i]
                surplus = record.surplus[row, i] + change - min(max(change, -most), most)
                fading = interval * record.fading[row, i]
                surplus -= min(max(surplus, -fading), fading)
            record.before[row, i], record.surplus[row, i] = value, surplus
            record.feedback[row, i] = value - surplus
    record.stamp[0] = stamp


class CorrectionLimit:
    """`limit_correction` for Python, sample by sample.

    ``position`` and ``velocity`` are what is to be fed back, shape (n,) [rad], [rad/s].  Not
    ``limited``, it passes all on.
    """

    def __init__(self, arm: SerialArm, limited: bool = True) -> None:
        limit = np.array(arm.velocity_limit)
        position = position_noise(arm)
        rate = np.abs(arm.sensors_to_joints()) @ (_SIGMAS * arm.sensors().velocity_noise)
        rate, scale = np.maximum(rate, position / arm.sample_time), arm.scales()
        rate = np.maximum(rate, REST_SHARE * limit)
        change = np.array([CHANGE_SHARE * limit, _RATE_FADING * limit])
        fading = np.array([np.minimum(change[0], FADING * scale), change[1]])
        if not limited:
            change[:] = np.inf
        noise, rest = np.array([position + 0.0 * limit, rate]), np.zeros((3, 2, len(limit)))
        self.parts = Correction(noise, change, fading, np.array([NEVER]), *rest)
        self._change, self._call = change.copy(), Entries()
        self.position, self.velocity = self.parts.feedback

    def take(self, stamp: int, position: np.ndarray, velocity: np.ndarray) -> None:
        """As the function `limit_correction`."""
        self._call(limit_correction, self.parts, stamp, position, velocity)

    def turn_to(self, position: np.ndarray, limited: bool) -> None:
        """Feed another position back, fading to it from the last one; it is ``position`` now.

        Not ``limited``, there is no correction: the position is fed back as measured.
        """
        self.parts.change[:] = self._change if limited else np.inf
        self.parts.before[0] = position
        self.parts.surplus[0] = position - self.position

    def restart(self) -> None:
        """The next sample is a start."""
        self.parts.stamp[0] = NEVER
