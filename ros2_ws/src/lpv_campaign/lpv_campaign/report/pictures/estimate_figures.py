"""Picture of the error of the fault estimates against the configuration."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpv_campaign.report.pictures.axes import plain_decades
from lpv_report.style import BAND, INK, SENSOR, SETTINGS, SOFT

_MARKERS = 'os^Dv'


def draw_estimates(entries: list[dict[str, Any]]) -> Figure | None:
    """RMS error and guaranteed threshold over abs(cos(theta)), one panel per sensor.

    Returns None without errors.
    """
    entries = [e for e in entries if e['classes']]
    if not entries:
        return None
    sensors = list(dict.fromkeys(e['sensor'] for e in entries))
    designs = list(dict.fromkeys(e['design'] for e in entries))
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(
            1, len(sensors), figsize=(4.9 * len(sensors), 3.5), sharey=True, squeeze=False
        )
        for i, (axis, sensor) in enumerate(zip(axes.flat, sensors)):
            mine = [e for e in entries if e['sensor'] == sensor]
            _threshold(axis, mine[0])
            for k, entry in enumerate(mine):
                label = 'RMS error' + (f', {entry["design"]}' if len(designs) > 1 else '')
                _error(axis, entry, SENSOR[i % 2] if k == 0 else SOFT, _MARKERS[k % 5], label)
            axis.set(
                title=sensor,
                yscale='log',
                xlim=(0.0, 1.0),
                xlabel=f'|cos(angle of link {i + 1} from the vertical)|',
            )
            plain_decades(axis.yaxis, *axis.get_ylim())
            axis.legend(loc='lower left')
        axes[0, 0].set_ylabel('fault estimate [rad]')
    return figure


def _threshold(axis: Axes, entry: dict[str, Any]) -> None:
    lines = entry['threshold']
    if not lines:
        return
    cosine = [t['cosine'] for t in lines]
    least = np.array([t['least'] for t in lines])
    largest = np.array([np.nan if t['largest'] is None else t['largest'] for t in lines])
    # Where gravity cannot bound the error for some angle of the other link, the band is open.
    axis.fill_between(
        cosine,
        least,
        np.where(np.isnan(largest), 10.0, largest),
        color=BAND,
        alpha=0.45,
        linewidth=0.0,
    )
    axis.plot(
        cosine,
        least,
        color=INK,
        linewidth=0.9,
        linestyle=(0, (4, 2.5)),
        label='threshold at rest, by the design',
    )
    errors = [c['rms'] for c in entry['classes']]
    highest = [c['runs']['high'] or c['rms'] for c in entry['classes']]
    axis.set_ylim(min(errors) * 0.08, max(*highest, *least) * 1.6)


def _error(axis: Axes, entry: dict[str, Any], colour: str, marker: str, label: str) -> None:
    classes = [c for c in entry['classes'] if c['runs']['count']]
    if not classes:
        return
    middle = [0.5 * (c['low'] + c['high']) for c in classes]
    axis.fill_between(
        middle,
        [c['runs']['low'] for c in classes],
        [c['runs']['high'] for c in classes],
        color=colour,
        alpha=0.2,
        linewidth=0.0,
        label=f'5 to 95 % of the runs{label[9:]}',
    )
    axis.plot(
        middle,
        [c['rms'] for c in classes],
        color=colour,
        marker=marker,
        markersize=3.5,
        label=label,
    )
