"""What a measurement leads to, for any number of joints."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lpv_core.decision.diagnosis import Alarm
from lpv_core.support.records import record_type

LONGEST_STALE = 50_000_000
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
        ('restarted', '?'),  # the clock was set back: observer and alarms restarted
        ('has_events', '?'),  # alarms changed
        ('due', '?'),  # a diagnostics report is due
        ('inconsistent', '?'),  # rates, torques and model contradict each other
        ('state', state),
        ('fault', fault),
    )


@dataclass
class Answer:
    """What one measurement leads to; each entry holds the fields of one message.

    Attributes
    ----------
    stamp : int
        Of the measurement [ns]; of every message, too.
    state : dict
        lpv_msgs/StateEstimate.
    corrected : dict or None
        sensor_msgs/JointState with confirmed faults removed; None where nothing was estimated.
    fault : dict or None
        lpv_msgs/FaultEstimate.
    alarms : list of dict
        lpv_msgs/FaultAlarm.
    status : list of dict or None
        diagnostic_msgs/DiagnosticArray's statuses where a report is due.
    events : list of Alarm
        The alarm events themselves.
    warnings : list of str
        What contradicts the arm file and was not said before.
    restarted : bool
        The clock was set back: observer and alarms restarted.
    inconsistent : bool
        Rates, torques and model contradict each other.
    """

    stamp: int
    state: dict[str, Any]
    corrected: dict[str, Any] | None = None
    fault: dict[str, Any] | None = None
    alarms: list[dict[str, Any]] = field(default_factory=list)
    status: list[dict[str, Any]] | None = None
    events: list[Alarm] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    restarted: bool = False
    inconsistent: bool = False


@dataclass
class Answers:
    """What many measurements lead to, one row per measurement.

    Attributes
    ----------
    answered, has_fault, restarted, inconsistent : ndarray of bool, shape (n,)
        As in `answer_type`.
    state, fault : numpy.recarray, shape (n,)
        Fields of lpv_msgs/StateEstimate and lpv_msgs/FaultEstimate as attributes, one row each.
    events : list of tuple
        Row and `Alarm` of each alarm event.
    reports : list of tuple
        Row and diagnostic_msgs/DiagnosticArray's statuses of each report that is due.
    """

    answered: np.ndarray
    has_fault: np.ndarray
    restarted: np.ndarray
    inconsistent: np.ndarray
    state: np.recarray
    fault: np.recarray
    events: list[tuple[int, Alarm]]
    reports: list[tuple[int, list[dict[str, Any]]]]
