"""Answers of a monitor to all measurements of a block, regular and odd ones."""

from collections import Counter
from typing import Any

import numpy as np

from lpv_bag.run.measurements import Measurements
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.factory import Monitor
from lpv_core.support.errors import SampleError

_ARRAYS = ('answered', 'has_fault', 'restarted', 'inconsistent', 'state', 'fault')


def take_all(
    monitor: Monitor, measured: Measurements, torque: np.ndarray | None, rejected: Counter[str]
) -> Answers:
    """Answers to the measurements of a block."""
    effort = measured.effort if torque is None else torque
    parts, done = [], 0
    for row in (*sorted(measured.odd), len(effort)):
        if row > done or not len(effort):
            parts.append(
                monitor.take_many(
                    measured.stamp[done:row],
                    measured.position[done:row],
                    measured.velocity[done:row],
                    effort[done:row],
                )
            )
        if row in measured.odd:
            given = None if torque is None else list(torque[row])
            parts.append(_take_one(monitor, measured, row, given, rejected))
        done = row + 1
    return parts[0] if len(parts) == 1 else _joined(parts)


def _take_one(
    monitor: Monitor,
    measured: Measurements,
    row: int,
    torque: list[float] | None,
    rejected: Counter[str],
) -> Answers:
    """One answer, or none, as arrays of one row."""
    answer = None
    try:
        answer = monitor.take(int(measured.stamp[row]), measured.odd[row], torque)
    except SampleError as error:
        rejected[str(error)] += 1
    record = np.zeros(1, monitor.answer_type).view(np.recarray)
    arrays: dict[str, Any] = {name: record[name] for name in _ARRAYS}
    result = Answers(**arrays, events=[], reports=[])
    if answer is not None:
        record[0] = answer.record
        if answer.fault is None:
            record.fault = np.zeros(1, monitor.answer_type['fault'])
        result.events = [(0, event) for event in answer.events]
        result.reports = [(0, answer.status)] if answer.status is not None else []
    return result


def _joined(parts: list[Answers]) -> Answers:
    starts = np.cumsum([0] + [len(p.answered) for p in parts]).tolist()
    joined: dict[str, Any] = {}
    for name in _ARRAYS:
        array = np.concatenate([np.asarray(getattr(p, name)) for p in parts])
        joined[name] = array.view(np.recarray) if array.dtype.names else array
    for name in ('events', 'reports'):
        joined[name] = [
            (start + row, what) for start, p in zip(starts, parts) for row, what in getattr(p, name)
        ]
    return Answers(**joined)
