"""Answers of a monitor to all measurements of a block."""

from collections import Counter
from typing import Any

import numpy as np

from lpv_bag.run.measurements import Measurements
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.support.errors import SampleError

_ARRAYS = ('answered', 'has_fault', 'restarted', 'inconsistent', 'state', 'fault')


def take_all(
    monitor: SerialSensorMonitor,
    measured: Measurements,
    torque: np.ndarray | None,
    rejected: Counter[str],
) -> Answers:
    """Answers to the measurements of a block; the monitor counts those without use in between."""
    effort = measured.effort if torque is None else torque
    arrays = measured.stamp, measured.position, measured.velocity, effort
    parts, done = [], 0
    for row in (*sorted(measured.unusable), len(effort)):
        parts.append(monitor.take_many(*(array[done:row] for array in arrays)))
        done = row
        if row in measured.unusable:
            try:
                monitor.take(int(measured.stamp[row]), measured.unusable[row])
            except SampleError as error:
                rejected[str(error)] += 1
            zeros = np.zeros(1, monitor.answer_type).view(np.recarray)
            arrays_of_one: dict[str, Any] = {name: zeros[name] for name in _ARRAYS}
            parts.append(Answers(**arrays_of_one, events=[], reports=[]))
            done = row + 1
    return parts[0] if len(parts) == 1 else _joined(parts)


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
