"""One picture of what happened when: states of the sensors, stops, contradictions."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpv_bag.run.streams import RunRecord
from lpv_core.decision.diagnosis import SensorState
from lpv_report.history.episodes import Interval, intervals
from lpv_report.history.phases import (
    BRAKED,
    INCONSISTENT,
    NO_COMMAND,
    SAFE_STOP,
    TOO_FAST,
    UNSAFE,
    Phase,
    starting,
)
from lpv_report.style import BAND, INK, PALE, SENSOR, SOFT

_HALF = 0.32
_LINES = (
    (INCONSISTENT, 'inconsistent', SOFT),
    (UNSAFE, 'not trustworthy', '#a5456f'),
    (SAFE_STOP, 'safe stop', INK),
    (BRAKED, 'drives braked', '#7a5c2e'),
    (NO_COMMAND, 'no command', BAND),
    (TOO_FAST, 'above speed limit', '#d01c3b'),
)


def timeline(
    record: RunRecord,
    found: Sequence[Phase],
    faults: Sequence[Interval] | None,
    sensor_names: Sequence[str],
) -> Figure | None:
    """States over time as bars."""
    states = record.get('fault_estimate', 'state')
    if states is None:
        return None
    lines = [line for line in _LINES if any(p.what == line[0] for p in found)]
    count = len(sensor_names) + len(lines)
    figure, axis = plt.subplots(figsize=(8.6, 0.95 + 0.36 * count))
    stamps = record.stamps['fault_estimate']
    time, first = record.seconds(stamps), starting(record, stamps)
    for i in range(len(sensor_names)):
        _sensor(axis, time, np.where(first, SensorState.OK, states[:, i]), i)
        for fault in faults or ():
            if fault.sensor_index == i:
                axis.plot(
                    [fault.start, fault.end],
                    [i + _HALF + 0.1] * 2,
                    color=INK,
                    linewidth=2.0,
                    solid_capstyle='butt',
                    label='true fault',
                )
    for row, (what, _, color) in enumerate(lines, len(sensor_names)):
        axis.broken_barh(
            [(p.start, p.duration) for p in found if p.what == what],
            (row - _HALF, 2 * _HALF),
            facecolor=color,
        )
    axis.set_yticks(range(count), [*sensor_names, *(text for _, text, _ in lines)])
    axis.set_ylim(count - 0.4, -0.6)
    axis.set_xlim(0.0, record.time[-1])
    axis.grid(visible=False, axis='y')
    axis.tick_params(axis='y', length=0)
    axis.spines['left'].set_visible(False)
    axis.set_xlabel('time [s]')
    _legend(figure, axis)
    return figure


def _sensor(axis: Axes, time: np.ndarray, state: np.ndarray, i: int) -> None:
    looks = (
        (SensorState.OK, 'watched, no fault', {'facecolor': '#e4e9ee'}),
        (SensorState.WARN, 'suspected', {'facecolor': PALE[i]}),
        (SensorState.ERROR, 'alarm', {'facecolor': SENSOR[i]}),
        (
            SensorState.NOT_DIAGNOSABLE,
            'not diagnosable',
            {'facecolor': '#ffffff', 'edgecolor': SOFT, 'hatch': '////', 'linewidth': 0},
        ),
        (SensorState.STALE, 'no data', {'facecolor': BAND}),
    )
    for which, label, look in looks:
        parts = [(p.start, p.end - p.start) for p in intervals(state == which, time)]
        if parts:
            axis.broken_barh(parts, (i - _HALF, 2 * _HALF), label=label, **look)


def _legend(figure: Figure, axis: Axes) -> None:
    found: dict[str, Any] = {}
    for handle, label in zip(*axis.get_legend_handles_labels()):
        found.setdefault(label, handle)
    figure.legend(
        list(found.values()),
        list(found),
        loc='outside upper right',
        ncols=len(found),
        handlelength=1.4,
        columnspacing=1.3,
        handletextpad=0.5,
    )
