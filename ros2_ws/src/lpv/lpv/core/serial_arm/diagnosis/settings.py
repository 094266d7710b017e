"""What decisions are asked for."""

import math
from dataclasses import dataclass

from lpv.core.serial_arm.description import SIGMAS
from lpv.core.support.limits import SMALL


@dataclass(frozen=True)
class MonitorSettings:
    """What a user asks of the decisions; of prismatic joints, times `SerialJoint.scale` [m]."""

    hours_between_false_alarms: float = 1000.0  # mean, of a healthy arm [h]
    probability_of_wrong_name: float = 0.01  # that a named cause is another one
    minimum_threshold: float = SMALL  # smaller lasting offsets are no faults [rad]
    smallest_step: float = 0.005  # smaller jumps of a reading are no faults [rad]
    clear_dwell: float = 0.5  # for which a fault must be over before its alarm ends [s]
    latch: bool = False  # alarms stay until they are reset, even if the fault is over
    sigmas: float = SIGMAS  # standard deviations in a bound

    @property
    def smallest_jump(self) -> float:
        """Smallest jump that is looked for [rad]; those that are no faults are known, too."""
        return min(self.smallest_step, MonitorSettings.smallest_step)

    def threshold(self, interval: float) -> float:
        """Logarithm of A: decisions between false alarms, one every interval [s]."""
        return math.log(self.hours_between_false_alarms * 3600.0 / interval)
