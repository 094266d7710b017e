"""What decisions are asked for."""

import math
from dataclasses import dataclass

from lpv.core.serial_arm.description import SIGMAS
from lpv.core.support.limits import SMALL
from lpv.core.support.options import entries


@dataclass(frozen=True)
class DiagnosisParameters:
    """What a user asks of the decisions; of prismatic joints, times `SerialJoint.scale` [m]."""

    hours_between_false_alarms: float = 1000.0
    probability_of_wrong_name: float = 0.01
    minimum_threshold: float = SMALL
    smallest_step: float = 0.005
    clear_dwell: float = 0.5
    latch: bool = False
    sigmas: float = SIGMAS
    compensation_rate: float = 0.5
    safe_stop_bound: float = 1.5

    @property
    def smallest_jump(self) -> float:
        """Smallest jump that is looked for [rad]; those that are no faults are known, too."""
        return min(self.smallest_step, DiagnosisParameters.smallest_step)

    @property
    def beyond(self) -> float:
        """Probability that a normal error lies beyond a bound."""
        return math.erfc(self.sigmas / math.sqrt(2.0))

    def threshold(self, interval: float) -> float:
        """Logarithm of A: decisions between false alarms, one every interval [s]."""
        return math.log(self.hours_between_false_alarms * 3600.0 / interval)


DIAGNOSIS = tuple(
    one._replace(default=getattr(DiagnosisParameters, one.name))
    for one in entries("""
hours_between_false_alarms[0.01:1e6]  mean time between false alarms of a healthy arm [h]
probability_of_wrong_name[1e-6:0.5]  probability that a named cause is another one [1]
minimum_threshold[0:10]  smaller lasting offsets are no faults [rad]
smallest_step[0:10]      smaller jumps of a reading are no faults [rad]
clear_dwell[0:100]       for which a fault must be over before its alarm ends [s]
latch                    alarms stay until ~/reset, even if the fault is over
sigmas[1:10]             standard deviations in a bound [1]
compensation_rate[0.01:100]  how fast a compensation without a known step is faded in and out
                         [rad/s]
safe_stop_bound[0.01:100]  a confirmed fault that is removed with a wider bound stops the arm [rad]
""")
)
"""What the fields of `DiagnosisParameters`, which has their defaults, are for, and their limits."""
