"""What a measurement leads to, for any number of joints."""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lpv.core.monitoring.compensation import answer_rows
from lpv.core.monitoring.message_fields import Report
from lpv.core.serial_arm.diagnosis.alarms import Alarm
from lpv.core.support.records import record_type


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


class Answers:
    """What many measurements lead to, one row per measurement.

    Parameters
    ----------
    kind : numpy.dtype
        `answer_type`.
    count : int
        Measurements.

    Attributes
    ----------
    plain : ndarray, shape (n,)
        Of `answer_type`; ``bytes``, shape (n, size), is its memory.
    answered, has_fault, restarted, inconsistent : ndarray, shape (n,)
        Fields of ``plain``.
    rows : AnswerRows
        For compiled functions.
    stamps, samples : ndarray, shapes (n,), (n, 3, joints)
        Of the measurements.
    events, due, warnings : list of tuple
        Row and alarm event; row and report that is due; row and text of what contradicts the arm
        file and was not said before.
    """

    def __init__(self, kind: np.dtype, count: int) -> None:
        # A single row would be contiguous, another type to compiled functions.
        memory = np.zeros(count + 1, kind)
        self.plain, self.rows = memory[:count], answer_rows(memory)
        self.bytes = memory.view('u1').reshape(-1, kind.itemsize)[:count]
        self.answered, self.has_fault = self.plain['answered'], self.plain['has_fault']
        self.restarted, self.inconsistent = self.plain['restarted'], self.plain['inconsistent']
        self.stamps = np.empty(count, np.int64)
        self.samples = np.empty((count, 3, self.rows.position.shape[1]))
        self.events: list[tuple[int, Alarm]] = []
        self.due: list[tuple[int, Report]] = []
        self.warnings: list[tuple[int, str]] = []

    @cached_property
    def state(self) -> np.recarray:
        """Field of ``plain``; made if somebody asks, as that takes longer than all the rest."""
        return self.plain['state'].view(np.recarray)

    @cached_property
    def fault(self) -> np.recarray:
        """As ``state``."""
        return self.plain['fault'].view(np.recarray)

    @property
    def reports(self) -> list[tuple[int, list[dict[str, Any]]]]:
        """Row and diagnostic_msgs/DiagnosticArray's statuses of each report, made anew."""
        return [(row, report.statuses()) for row, report in self.due]

    def record(self, row: int) -> np.ndarray:
        """A copy of one answer, shape (1,), in a fifth of the time that a copy of fields takes."""
        return self.bytes[row].copy().view(self.plain.dtype)
