"""Tuning of the diagnosis."""

from dataclasses import dataclass

from lpv.core.control.estimate_check import FADING
from lpv.core.serial_arm.diagnosis.settings import MonitorSettings


@dataclass(frozen=True)
class DiagnosisParameters(MonitorSettings):
    """What a user asks of the decisions; every field is a parameter of the observer node."""

    # how fast a compensation without a known step is faded in and out [rad/s]
    compensation_rate: float = FADING
    # a confirmed fault that is removed with a wider bound stops the arm [rad]
    safe_stop_bound: float = 1.5
