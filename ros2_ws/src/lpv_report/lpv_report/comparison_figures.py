"""Figures of two runs of one recording."""

from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpv_bag.run.streams import RunRecord
from lpv_core.serial_arm.any_arm import Arm
from lpv_report.history.episodes import episodes
from lpv_report.style import INK, PALE, SENSOR, SETTINGS, thin

_WIDTH, _HEIGHT = 8.6, 2.6


def draw_comparison(first: RunRecord, second: RunRecord, arm: Arm) -> Iterator[tuple[str, Figure]]:
    """Fault estimates of both runs, and how far they are apart."""
    if 'fault_estimate' not in first.streams or 'fault_estimate' not in second.streams:
        return
    for name, draw in (('faults', _faults), ('differences', _differences)):
        with plt.rc_context(SETTINGS):
            count = len(arm.sensor_names)
            figure, axes = plt.subplots(
                count, sharex=True, squeeze=False, figsize=(_WIDTH, _HEIGHT * count)
            )
            axes = axes[:, 0]
            for i, axis in enumerate(axes):
                draw(axis, first, second, i)
                axis.set_title(f'Sensor {i + 1}: {arm.sensor_names[i]}')
                if axis.get_legend_handles_labels()[0]:
                    axis.legend(
                        loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.25
                    )
            axes[-1].set_xlabel('time [s]')
            yield name, figure
            plt.close(figure)


def _seconds(record: RunRecord, stamps: np.ndarray, first: RunRecord) -> np.ndarray:
    return (stamps - first.stamps['joint_states'][0]) / 1e9


def _faults(axis: Axes, first: RunRecord, second: RunRecord, i: int) -> None:
    runs: tuple[tuple[RunRecord, str, dict[str, Any]], ...] = (
        (first, 'first', {'color': PALE[i], 'linewidth': 3.4}),
        (second, 'second', {'color': SENSOR[i], 'linewidth': 1.1}),
    )
    for record, label, style in runs:
        time = _seconds(record, record.stamps['fault_estimate'], first)
        axis.plot(
            *thin(time, record.streams['fault_estimate']['estimate'][:, i]), label=label, **style
        )
        for alarm in episodes(record):
            if alarm.sensor_index == i:
                start = float(_seconds(record, record.stamps['joint_states'][:1], first)[0])
                axis.axvline(
                    alarm.raised + start,
                    color=style['color'],
                    linewidth=1.0,
                    linestyle='-' if record is first else (0, (4, 2.5)),
                )
    truth = first.get('ground_truth', 'fault')
    if truth is not None:
        axis.plot(
            *thin(_seconds(first, first.stamps['ground_truth'], first), truth[:, i]),
            label='fault',
            color=INK,
            linewidth=0.9,
            linestyle=(0, (4, 2.5)),
        )
    axis.set_ylabel('fault [rad]')


def _differences(axis: Axes, first: RunRecord, second: RunRecord, i: int) -> None:
    stamps, a, b = np.intersect1d(
        first.stamps['fault_estimate'], second.stamps['fault_estimate'], return_indices=True
    )
    for name, color in (('estimate', SENSOR[i]), ('threshold', PALE[i])):
        gap = (
            second.streams['fault_estimate'][name][b, i]
            - first.streams['fault_estimate'][name][a, i]
        )
        axis.plot(
            *thin(_seconds(first, stamps, first), gap), label=f'{name}, second - first', color=color
        )
    axis.set_ylabel('difference [rad]')
