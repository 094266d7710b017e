"""Pictures of detection probability and delay against the size of the fault."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from lpv_campaign.report.pictures.axes import plain_decades
from lpv_report.style import SENSOR, SETTINGS, SOFT

_COLUMNS = 5
_BOTH = '#009e73'
_LEAST_DELAY = 1e-3


def draw_detection(entries: list[dict[str, Any]]) -> Figure | None:
    """Probability above delay, one column per kind of fault that has a size.

    Returns None without sizes.
    """
    entries = [e for e in entries if len(e['classes']) > 1]
    kinds = list(dict.fromkeys(e['kind'] for e in entries))[:_COLUMNS]
    if not kinds:
        return None
    sensors = list(dict.fromkeys(e['sensor'] for e in entries))
    colours = dict(zip([s for s in sensors if s != 'both'], SENSOR), both=_BOTH)
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(
            2,
            len(kinds),
            figsize=(max(2.1 * len(kinds) + 0.8, 4.5), 5.0),
            sharex='col',
            sharey='row',
            squeeze=False,
        )
        for (top, bottom), kind in zip(axes.T, kinds):
            mine = [e for e in entries if e['kind'] == kind]
            for entry in mine:
                _probability(top, entry, colours[entry['sensor']])
                _delay(bottom, entry, colours[entry['sensor']])
            unit = mine[0]['unit']
            top.set(title=kind, ylim=(-0.02, 1.02))
            top.yaxis.set_major_formatter(PercentFormatter(1.0))
            bottom.set(
                xscale='log',
                yscale='log',
                xlabel=mine[0]['dose'] + (f' [{unit}]' if unit != '1' else ''),
            )
            sizes = [size for entry in mine for size in entry['cases']['size']]
            plain_decades(bottom.xaxis, min(sizes), max(sizes))
        axes[0, 0].set_ylabel('detected')
        axes[1, 0].set_ylabel('delay [s]')
        plain_decades(axes[1, 0].yaxis, *axes[1, 0].get_ylim())
        figure.legend(
            handles=_handles(colours, sensors),
            loc='outside upper center',
            ncols=5 if len(kinds) > 2 else 2,
        )
    return figure


def _handles(colours: dict[str, str], sensors: Sequence[str]) -> list[Any]:
    handles = [plt.Line2D([], [], color=colours[s], label=s) for s in sensors]
    return [
        *handles,
        plt.Line2D(
            [],
            [],
            color=SOFT,
            marker='o',
            markersize=3.5,
            linestyle='',
            label='class of runs, 95 % interval',
        ),
        plt.Line2D([], [], color=SOFT, linewidth=6, alpha=0.3, label='5 to 95 % of delays'),
    ]


def _probability(axis: Axes, entry: dict[str, Any], colour: str) -> None:
    classes = entry['classes']
    middle = np.array([c['middle'] for c in classes])
    rate, low, high = (
        np.array([c['detected'][k] for c in classes]) for k in ('rate', 'low', 'high')
    )
    fitted = entry['curve']
    axis.errorbar(
        middle,
        rate,
        [rate - low, high - rate],
        fmt='o',
        color=colour,
        markersize=3.5,
        elinewidth=0.9,
        alpha=0.85,
    )
    if fitted is None:
        return
    size = np.geomspace(min(entry['cases']['size']), max(entry['cases']['size']), 100)
    value = fitted['intercept'] + fitted['slope'] * np.log(size)
    axis.plot(size, 1.0 / (1.0 + np.exp(-np.clip(value, -500.0, 500.0))), color=colour)


def _delay(axis: Axes, entry: dict[str, Any], colour: str) -> None:
    cases = [
        (s, d) for s, d in zip(entry['cases']['size'], entry['cases']['delay']) if d is not None
    ]
    if cases:
        size, delay = np.maximum(np.array(cases).T, _LEAST_DELAY)
        axis.scatter(size, delay, s=3, color=colour, alpha=0.35, linewidths=0, rasterized=True)
    classes = [c for c in entry['classes'] if c['delay']['count']]
    middle = [c['middle'] for c in classes]
    low, median, high = (
        [max(c['delay'][k], _LEAST_DELAY) for c in classes] for k in ('low', 'median', 'high')
    )
    axis.fill_between(middle, low, high, color=colour, alpha=0.18, linewidth=0.0)
    axis.plot(middle, median, color=colour, marker='o', markersize=2.5)
