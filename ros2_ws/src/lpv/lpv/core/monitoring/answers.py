"""What a measurement leads to, for any number of joints."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lpv.core.control.watchdog import TrackerLimits
from lpv.core.serial_arm.diagnosis.alarms import Alarm
from lpv.core.support.records import record_type
from lpv.core.support.timestamps import NANOSECONDS

LONGEST_STALE = round(TrackerLimits.unusable * NANOSECONDS)
"""Time without a usable measurement after which the last estimate is not trustworthy [ns]."""


def answer_type(joints: int) -> np.dtype:
    """Record type of the answer to one measurement of an arm."""
    each = (joints,)
    state = record_type(  # lpv_msgs/StateEstimate
        ('position', 'f8', each),
        ('velocity', 'f8', each),
        ('compensated_position', 'f8', each),
        ('measured_position', 'f8', each),
        ('measured_velocity', 'f8', each),
        ('mode', 'u1'),
        ('trustworthy', '?'),
    )
    fault = record_type(  # lpv_msgs/FaultEstimate
        ('estimate', 'f8', each),
        ('bound', 'f8', each),
        ('threshold', 'f8', each),
        ('state', 'u1', each),
        ('alarm', 'u1', each),
    )
    return record_type(
        ('answered', '?'),  # False for a sample with an old stamp, which needs no answer
        ('has_fault', '?'),  # whether there is a fault estimate; a state there is always
        ('restarted', '?'),  # as `Answer.restarted`
        ('inconsistent', '?'),  # rates, torques and model contradict each other
        ('state', state),
        ('fault', fault),
    )


class Answer(NamedTuple):
    """What one measurement leads to."""

    stamp: int  # of the measurement, and of every message [ns]
    record: np.void  # of `answer_type`
    status: list[dict[str, Any]] | None  # of diagnostic_msgs/DiagnosticArray, where a report is due
    events: list[Alarm]
    warnings: list[str]  # what contradicts the arm file and was not said before

    @property
    def restarted(self) -> bool:
        """The clock was set, or no measurement came for more than 1 s: balances begin anew."""
        return bool(self.record['restarted'])


@dataclass
class Answers:
    """What many measurements lead to, one row per measurement."""

    answered: np.ndarray  # (n,) of bool, as in `answer_type`; so are the next three
    has_fault: np.ndarray
    restarted: np.ndarray
    inconsistent: np.ndarray
    state: np.recarray  # (n,) fields of lpv_msgs/StateEstimate as attributes
    fault: np.recarray  # (n,) fields of lpv_msgs/FaultEstimate as attributes
    events: list[tuple[int, Alarm]]  # row and alarm event
    # row and diagnostic_msgs/DiagnosticArray's statuses of each report that is due
    reports: list[tuple[int, list[dict[str, Any]]]]
    # row and text of what contradicts the arm file and was not said before
    warnings: list[tuple[int, str]]
