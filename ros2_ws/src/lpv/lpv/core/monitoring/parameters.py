"""Tuning of the diagnosis."""

from dataclasses import dataclass

from lpv.core.control.estimate_check import FADING
from lpv.core.serial_arm.description import SIGMAS
from lpv.core.support.limits import SMALL


@dataclass(frozen=True)
class DiagnosisParameters:
    """What a user asks of the decisions; every field is a parameter of the observer node."""

    hours_between_false_alarms: float = 1000.0  # mean, of a healthy arm [h]
    probability_of_wrong_name: float = 0.01  # that a named cause is another one
    minimum_threshold: float = SMALL  # smaller lasting offsets are no faults [rad]
    smallest_step: float = 0.005  # smaller jumps of a reading are no faults [rad]
    clear_dwell: float = 0.5  # for which a fault must be over before its alarm ends [s]
    latch: bool = False  # alarms stay until they are reset, even if the fault is over
    sigmas: float = SIGMAS  # standard deviations in a bound
    # how fast a compensation without a known step is faded in and out [rad/s]
    compensation_rate: float = FADING
    # a confirmed fault that is removed with a wider bound stops the arm [rad]
    safe_stop_bound: float = 1.5
