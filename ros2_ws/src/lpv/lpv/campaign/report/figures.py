"""Pictures of a campaign, each from numbers of its report."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, PercentFormatter

from lpv.report.style import SENSOR

_LEAST_DELAY = 1e-3
"""Least number on logarithmic axes, which have no zero."""
_MOST_TRENDS = 6
"""Trends that are drawn, clearest first."""


def detection(numbers: dict[str, Any]) -> Figure | None:
    """Probability of detection above delay, one column per kind of fault that has a size."""
    entries = [entry for entry in numbers['detection'] if len(entry['classes']) > 1]
    kinds = list(dict.fromkeys(entry['kind'] for entry in entries))[:6]
    if not kinds:
        return None
    names = list(dict.fromkeys(entry['sensor'] for entry in entries))
    colours = dict(zip(names, SENSOR))
    late = any(delay is not None for entry in entries for delay in entry['delays'])
    scale = 'log' if late else 'linear'  # an axis without data has no logarithms
    figure, axes = plt.subplots(
        *(2, len(kinds)),
        figsize=(max(2.1 * len(kinds) + 0.8, 4.5), 5.0),
        sharex='col',
        sharey='row',
        squeeze=False,
    )
    for (top, bottom), kind in zip(axes.T, kinds):
        mine = [entry for entry in entries if entry['kind'] == kind]
        for entry in mine:
            middle = [c['middle'] for c in entry['classes']]
            rate, low, high = (
                np.array([c['detected'][k] for c in entry['classes']])
                for k in ('rate', 'low', 'high')
            )
            error, colour = np.maximum([rate - low, high - rate], 0.0), colours[entry['sensor']]
            top.errorbar(middle, rate, error, fmt='o', color=colour, markersize=3.5, elinewidth=0.9)
            _delay(bottom, entry, colours[entry['sensor']])
        unit = ' or '.join(dict.fromkeys(entry['unit'] for entry in mine))
        top.set(title=kind, ylim=(-0.02, 1.02))
        top.yaxis.set_major_formatter(PercentFormatter(1.0))
        label = mine[0]['dose'] + (f' [{unit}]' if unit != '1' else '')
        bottom.set(xscale='log', yscale=scale, xlabel=label)
        bottom.xaxis.set_minor_locator(LogLocator(subs=(3.0,)))  # more labels would overlap
    axes[0, 0].set_ylabel('detected')
    axes[1, 0].set_ylabel('delay [s]')
    handles = [plt.Line2D([], [], color=colours[name], label=name) for name in names]
    figure.legend(handles=handles, loc='outside upper center', ncols=min(len(names), 4))
    return figure


def _delay(axis: Axes, entry: dict[str, Any], colour: str) -> None:
    pairs = [(s, d) for s, d in zip(entry['sizes'], entry['delays']) if d is not None]
    if pairs:
        size, delay = np.maximum(np.array(pairs).T, _LEAST_DELAY)
        axis.scatter(size, delay, s=3, color=colour, alpha=0.35, linewidths=0, rasterized=True)
    classes = [c for c in entry['classes'] if c['delay']['count']]
    middle = [c['middle'] for c in classes]
    low, median, high = (
        [max(c['delay'][k], _LEAST_DELAY) for c in classes] for k in ('low', 'median', 'high')
    )
    axis.fill_between(middle, low, high, color=colour, alpha=0.18, linewidth=0.0)
    axis.plot(middle, median, color=colour, marker='o', markersize=2.5)


def trends(numbers: dict[str, Any]) -> Figure | None:
    """Mean fault estimates of the arms that change most clearly, over time."""
    chosen = [trend for trend in numbers['trends'] if trend['clear']][:_MOST_TRENDS]
    if not chosen:
        return None
    rows = (len(chosen) + 1) // 2
    figure, axes = plt.subplots(rows, min(2, len(chosen)), figsize=(8.6, 2.5 * rows), squeeze=False)
    for axis, trend in zip(axes.flat, chosen):
        days, means = np.array(trend['days']), np.array(trend['means'])
        line = np.median(means) + trend['slope'] * (days - np.median(days))
        axis.plot(days, 1e3 * means, 'o', color=SENSOR[0], markersize=3.5)
        axis.plot(days, 1e3 * line, color=SENSOR[1])
        axis.set(title=f'{trend["unit"] or "-"}, {trend["sensor"]}', xlabel='days')
        axis.set_ylabel(f'mean estimate [m{trend["position_unit"]}]')
    for axis in list(axes.flat)[len(chosen) :]:
        axis.set_axis_off()
    return figure
