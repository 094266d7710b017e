"""Answers of a monitor to all measurements of a block, regular and odd ones."""

from collections import Counter
from typing import Any

import numpy as np

from lpv_bag.run.measurements import Measurements
from lpv_core.monitoring.answers import Answer, Answers
from lpv_core.monitoring.factory import Monitor
from lpv_core.support.errors import SampleError

_ARRAYS = ('answered', 'has_fault', 'restarted', 'inconsistent', 'state', 'fault')


def take_all(
    monitor: Monitor, measured: Measurements, torque: np.ndarray | None, rejected: Counter[str]
) -> Answers:
    """Answers to the measurements of a block."""
    effort = measured.effort if torque is None else torque

    def regular(a: int, b: int) -> Answers:
        return monitor.take_many(
            measured.stamp[a:b], measured.position[a:b], measured.velocity[a:b], effort[a:b]
        )

    if not measured.odd:
        return regular(0, len(effort))
    parts, done = [], 0
    for row in sorted(measured.odd):
        parts += [regular(done, row)] if row > done else []
        parts.append(
            _take_one(
                monitor,
                int(measured.stamp[row]),
                measured.odd[row],
                None if torque is None else torque[row],
                rejected,
            )
        )
        done = row + 1
    if done < len(effort):
        parts.append(regular(done, len(effort)))
    return _join(parts)


def _take_one(
    monitor: Monitor, stamp: int, message: Any, torque: np.ndarray | None, rejected: Counter[str]
) -> Answers:
    try:
        answer = monitor.take(stamp, message, None if torque is None else list(torque))
    except SampleError as error:
        rejected[str(error)] += 1
        answer = None
    return _as_row(answer, monitor.answer_type)


def _as_row(answer: Answer | None, kind: np.dtype) -> Answers:
    """One answer, or None, as arrays of one row."""
    row = np.zeros(1, kind).view(np.recarray)
    arrays: dict[str, Any] = {name: row[name] for name in _ARRAYS}
    result = Answers(**arrays, events=[], reports=[])
    if answer is None:
        return result
    row[0] = answer.record
    if answer.fault is None:
        row.fault = np.zeros(1, kind['fault'])
    result.events = [(0, event) for event in answer.events]
    result.reports = [(0, answer.status)] if answer.status is not None else []
    return result


def _join(parts: list[Answers]) -> Answers:
    starts = np.cumsum([0] + [len(p.answered) for p in parts])
    joined: dict[str, Any] = {}
    for name in _ARRAYS:
        array = np.concatenate([np.asarray(getattr(p, name)) for p in parts])
        joined[name] = array.view(np.recarray) if array.dtype.names else array
    for name in ('events', 'reports'):
        joined[name] = [
            (int(start) + row, what)
            for start, p in zip(starts, parts)
            for row, what in getattr(p, name)
        ]
    return Answers(**joined)
