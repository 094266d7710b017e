"""Pictures of the ROC curves and of the sweep of the threshold factor."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, PercentFormatter

from lpv_campaign.report.pictures.axes import plain_decades
from lpv_campaign.report.sections.roc import ALL
from lpv_report.style import INK, SENSOR, SETTINGS, SOFT

KIND = {
    'bias': '#0072b2',
    'drift': '#d55e00',
    'scale': '#009e73',
    'stuck': '#cc79a7',
    'noise': '#e69f00',
    'spike': '#56b4e9',
    'dropout': '#5b6774',
    'rate_bias': '#a6761d',
    ALL: INK,
}
"""Colour of each kind of fault."""
_COLUMNS, _WIDE = 4, 6.0
_LINEAR = 0.01
"""Below this rate the axis of false alarms is linear, so that it begins at 0."""


def draw_roc(data: dict[str, Any]) -> Figure | None:
    """ROC curves, one panel per kind of fault.

    Returns None without curves.
    """
    kinds = list(dict.fromkeys(c['kind'] for c in data['curves'] if c['points']['factor']))
    if not kinds:
        return None
    columns = min(_COLUMNS, len(kinds))
    rows = -(-len(kinds) // columns)
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(
            rows,
            columns,
            figsize=(2.35 * columns + 0.6, 2.4 * rows + 0.5),
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        sensors = list(dict.fromkeys(c['sensor'] for c in data['curves']))
        for axis, kind in zip(axes.flat, kinds):
            for curve in data['curves']:
                if curve['kind'] == kind and curve['points']['factor']:
                    _curve(axis, curve, SENSOR[sensors.index(curve['sensor'])])
            axis.set_title('all kinds' if kind == ALL else kind)
            _rates(axis)
        for axis in axes.flat[len(kinds) :]:
            axis.set_visible(False)
        for axis in axes[-1]:
            axis.set_xlabel('false alarms')
        for axis in axes[:, 0]:
            axis.set_ylabel('detected')
        _legend(figure, sensors)
    return figure


def _curve(axis: Axes, curve: dict[str, Any], colour: str) -> None:
    points = curve['points']
    false = points['false_alarm']
    axis.plot(false, points['detection'], color=colour, drawstyle='steps-post', zorder=3)
    axis.fill_between(
        false,
        points['detection_low'],
        points['detection_high'],
        color=colour,
        alpha=0.15,
        linewidth=0.0,
        step='post',
    )
    score = curve['score']
    axis.plot(
        score['false_alarm']['rate'],
        score['detection']['rate'],
        'o',
        color=colour,
        markerfacecolor='white',
        markersize=5,
        zorder=5,
        clip_on=False,
    )
    shipped = curve['shipped']
    if shipped['detection']['rate'] is None or shipped['false_alarm']['rate'] is None:
        return
    x, y = shipped['false_alarm'], shipped['detection']
    axis.errorbar(
        x['rate'],
        y['rate'],
        [[y['rate'] - y['low']], [y['high'] - y['rate']]],
        [[x['rate'] - x['low']], [x['high'] - x['rate']]],
        fmt='D',
        color=colour,
        markersize=4.5,
        elinewidth=0.9,
        capsize=2,
        zorder=4,
        clip_on=False,
    )


def _rates(axis: Axes) -> None:
    axis.set_xscale('symlog', linthresh=_LINEAR, linscale=0.6)
    axis.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    axis.xaxis.set_major_locator(FixedLocator([0.0, 0.01, 0.1, 1.0]))
    axis.xaxis.set_minor_locator(FixedLocator([]))
    axis.set_xticklabels(['0', '1%', '10%', '100%'])
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))


def _legend(figure: Figure, sensors: Sequence[str]) -> None:
    handles = [plt.Line2D([], [], color=SENSOR[i], label=s) for i, s in enumerate(sensors)]
    handles += [
        plt.Line2D(
            [],
            [],
            color=SOFT,
            marker='o',
            markerfacecolor='white',
            linestyle='',
            label='score, factor 1',
        ),
        plt.Line2D(
            [], [], color=SOFT, marker='D', linestyle='', markersize=4.5, label='shipped decision'
        ),
    ]
    columns = len(handles) if figure.get_figwidth() > _WIDE else 2
    figure.legend(handles=handles, loc='outside upper center', ncols=columns)


def draw_sweep(data: dict[str, Any]) -> Figure | None:
    """Rates against the factor on the threshold.

    Returns None without curves.
    """
    curves = [c for c in data['curves'] if c['points']['factor']]
    if not curves:
        return None
    sensors = list(dict.fromkeys(c['sensor'] for c in curves))
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(
            1, len(sensors), figsize=(4.9 * len(sensors), 3.4), sharey=True, squeeze=False
        )
        for axis, sensor in zip(axes.flat, sensors):
            mine = [c for c in curves if c['sensor'] == sensor]
            for curve in mine:
                if curve['kind'] != ALL:
                    _against_factor(
                        axis,
                        curve,
                        'detection',
                        color=KIND.get(curve['kind'], SOFT),
                        label=curve['kind'],
                    )
            # Healthy windows are the same for all kinds.
            _against_factor(
                axis,
                mine[-1],
                'false_alarm',
                color=INK,
                linewidth=1.6,
                linestyle=(0, (4, 2)),
                label='false alarms',
            )
            axis.axvline(1.0, color=SOFT, linewidth=0.9)
            axis.set(
                title=sensor,
                xscale='log',
                ylim=(0.0, 1.0),
                xlim=_factors(mine),
                xlabel='factor on the threshold (1: as shipped)',
            )
            plain_decades(axis.xaxis, *axis.get_xlim())
            axis.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes[0, 0].set_ylabel('runs above the threshold')
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside right center')
    return figure


def _factors(curves: list[dict[str, Any]]) -> tuple[float, float]:
    """From where nearly every healthy run is above to where few faults are."""
    factors = np.concatenate([c['points']['factor'] for c in curves])
    low, high = np.percentile(factors[factors > 0.0], (2.0, 98.0))
    return min(low, 0.5) * 0.9, max(high, 2.0) * 1.1


def _against_factor(axis: Axes, curve: dict[str, Any], key: str, **style: Any) -> None:
    points = curve['points']
    # The logarithm has no place for factor 0.
    shown = np.array(points['factor']) > 0.0
    axis.plot(
        np.array(points['factor'])[shown],
        np.array(points[key])[shown],
        drawstyle='steps-pre',
        **style,
    )
