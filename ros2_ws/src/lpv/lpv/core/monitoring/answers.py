"""What a measurement leads to, for any number of joints."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from lpv.core.control.watchdog import TrackerLimits
from lpv.core.monitoring import message_fields
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
        ('restarted', '?'),  # the clock was set: estimates begin anew
        ('inconsistent', '?'),  # rates, torques and model contradict each other
        ('state', state),
        ('fault', fault),
    )


@dataclass
class Answer:
    """What one measurement leads to: a record, and what there is to say now and then.

    Fields of messages are made of the record where they are asked for: a node has messages of its
    own, which it copies the record into.

    Attributes
    ----------
    stamp : int
        Of the measurement [ns]; of every message, too.
    record : numpy.void
        Of `answer_type`.
    arm : SerialArm
        Names of joints and sensors.
    status : list of dict or None
        diagnostic_msgs/DiagnosticArray's statuses where a report is due.
    events : list of Alarm
        Alarm events.
    warnings : list of str
        What contradicts the arm file and was not said before.
    """

    stamp: int
    record: np.void
    arm: Any
    status: list[dict[str, Any]] | None = None
    events: list[Alarm] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @cached_property
    def state(self) -> dict[str, Any]:
        """Fields of lpv_msgs/StateEstimate."""
        return message_fields.state_fields(self.record['state'])

    @cached_property
    def fault(self) -> dict[str, Any] | None:
        """Fields of lpv_msgs/FaultEstimate, if there is one."""
        if not self.record['has_fault']:
            return None
        return message_fields.fault_fields(self.record['fault'], self.arm.sensor_names)

    @property
    def corrected(self) -> dict[str, Any] | None:
        """Fields of sensor_msgs/JointState with confirmed faults removed, if there is one."""
        return message_fields.corrected_fields(self.record['state'], self.arm.joint_names)

    @property
    def alarms(self) -> list[dict[str, Any]]:
        """Fields of lpv_msgs/FaultAlarm, one for each event."""
        return [message_fields.alarm_fields(event) for event in self.events]

    @property
    def restarted(self) -> bool:
        """The clock was set back: observer and alarms restarted."""
        return bool(self.record['restarted'])

    @property
    def inconsistent(self) -> bool:
        """Rates, torques and model contradict each other."""
        return bool(self.record['inconsistent'])


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
