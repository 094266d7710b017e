"""Figures of what could be detected: over time, and over configurations with the path."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from lpv_bag.run.streams import RunRecord
from lpv_core.model.arm import ArmParameters
from lpv_report.guarantees.detectability import Detectability, Grid, configurations
from lpv_report.history.episodes import intervals
from lpv_report.style import BAND, HATCHED, INK, PALE, SENSOR, SOFT, legend_above, shade, thin

_WIDTH = 8.6
_LEVELS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
_NORM = LogNorm(_LEVELS[0], _LEVELS[-1])
_COLORS = plt.get_cmap('viridis').with_extremes(over=BAND)
_ALERT = '#d01c3b'


def over_time(found: Detectability, record: RunRecord, sensor_names: Sequence[str]) -> Figure:
    """Smallest lasting fault that is detected for certain, by time."""
    figure, axes = plt.subplots(2, sharex=True, figsize=(_WIDTH, 3.9))
    truth = record.aligned('ground_truth', 'fault')
    for i, axis in enumerate(axes):
        axis.set_yscale('log')
        _unbounded(axis, found, i)
        resting = np.where(np.isfinite(found.resting[:, i]), found.resting[:, i], np.nan)
        if np.isfinite(resting).any():
            axis.plot(
                found.time[found.places],
                resting,
                color=PALE[i],
                linewidth=3.4,
                label='at rest in this configuration',
            )
        if found.moving is not None:
            axis.plot(
                *thin(found.time, found.moving[:, i]),
                color=SENSOR[i],
                linewidth=1.1,
                label='as recorded, in motion',
            )
        if truth is not None:
            size = np.abs(truth[:, i])
            axis.plot(
                *thin(found.time, np.where(size > 1e-6, size, np.nan)),
                color=INK,
                linewidth=1.1,
                linestyle=(0, (4, 2.5)),
                label='true fault',
            )
        _scale(axis, found, i)
        _hatch(axis, found, i)
        axis.set_ylabel('fault [rad]')
        axis.set_title(sensor_names[i], pad=7)
        legend_above(axis)
        axis.set_xlim(0.0, found.time[-1])
    axes[-1].set_xlabel('time [s]')
    return figure


def _scale(axis: Axes, found: Detectability, i: int) -> None:
    """Limits by what could be detected; true faults start from nothing."""
    parts = [found.resting[:, i]] + ([] if found.moving is None else [found.moving[:, i]])
    values = np.concatenate(parts)
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = (values.min(), values.max()) if values.size else (0.1, 1.0)
    axis.set_ylim(low / 1.6, high * 1.6)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter('{x:g}')
    axis.minorticks_off()


def _unbounded(axis: Axes, found: Detectability, i: int) -> None:
    time = found.time[found.places]
    parts = intervals(~np.isfinite(found.resting[:, i]), time) if len(time) else []
    shade(axis, [(p.start, p.end) for p in parts], 'no bound at rest', color=BAND, alpha=0.45)


def _hatch(axis: Axes, found: Detectability, i: int) -> None:
    parts = intervals(found.not_diagnosable[:, i], found.time)
    shade(axis, [(p.start, p.end) for p in parts], 'not diagnosable', **HATCHED)


def over_configurations(found: Detectability, arm: ArmParameters) -> Figure:
    """The same over the configurations of the arm, with the path of the run."""
    grid = configurations(found, arm)
    figure, axes = plt.subplots(1, 2, figsize=(_WIDTH, 4.15), sharex=True, sharey=True)
    for i, axis in enumerate(axes):
        axis.grid(False)
        if grid.detectable is None:
            _colored_path(axis, found, i)
        else:
            _background(axis, grid, grid.detectable, i)
            _path(axis, found, i)
        _region(axis, grid, i)
        axis.set_title(f'Sensor {i + 1}: {arm.sensor_names[i]}', pad=7)
        axis.set_xlabel('link 1 from the vertical [°]')
        axis.set_aspect('equal')
    axes[0].set_ylabel('link 2 from the vertical [°]')
    shades = plt.cm.ScalarMappable(_NORM, _COLORS)
    bar = figure.colorbar(shades, ax=axes, ticks=_LEVELS, shrink=0.85, extend='min', pad=0.015)
    bar.set_label('smallest certain fault [rad]')
    bar.ax.set_yticklabels([f'{level:g}' for level in _LEVELS])
    bar.ax.minorticks_off()
    handles = {
        label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels())
    }
    figure.legend(
        handles.values(),
        handles.keys(),
        loc='outside lower left',
        ncols=len(handles),
        handlelength=1.7,
        columnspacing=1.3,
    )
    return figure


def _background(axis: Axes, grid: Grid, detectable: np.ndarray, i: int) -> None:
    one, two = np.degrees(grid.one), np.degrees(grid.two)
    values = detectable[:, :, i].T
    finite = values <= _LEVELS[-1]
    axis.contourf(
        one,
        two,
        np.where(finite, values, 2.0 * _LEVELS[-1]),
        levels=np.geomspace(_LEVELS[0], _LEVELS[-1], 41),
        norm=_NORM,
        cmap=_COLORS,
        extend='both',
    )
    if not finite.all():
        axis.fill([], [], facecolor=BAND, label='no bound at rest')
    if finite.any():
        # Only where there is a bound: at its border all lines would coincide.
        lines = axis.contour(
            one,
            two,
            np.ma.array(values, mask=~finite),
            levels=_LEVELS,
            colors='white',
            linewidths=0.7,
        )
        axis.clabel(lines, fontsize=7.5, fmt='%g')


def _region(axis: Axes, grid: Grid, i: int) -> None:
    """Hatch what lies outside the region that this sensor needs."""
    one, two, lost = np.degrees(grid.one), np.degrees(grid.two), grid.lost[:, :, i].T
    axis.set(xlim=one[[0, -1]], ylim=two[[0, -1]])
    if not lost.any():
        return
    for look in ({'colors': ['#ffffff'], 'alpha': 0.55}, {'colors': 'none', 'hatches': ['////']}):
        axis.contourf(one, two, lost.astype(float), levels=[0.5, 1.5], zorder=1, **look)
    axis.fill(
        [],
        [],
        facecolor='white',
        edgecolor=SOFT,
        hatch='////',
        linewidth=0,
        label='not diagnosable',
    )


def _path(axis: Axes, found: Detectability, i: int) -> None:
    known = np.degrees(found.deviation[_spread(found.deviation)])
    lost = found.not_diagnosable[_spread(found.deviation), i]
    axis.plot(*known.T, color='white', linewidth=3.2, solid_capstyle='round')
    axis.plot(*known.T, color=INK, linewidth=1.4, label=f'path of the run ({found.source})')
    if lost.any():
        marked = np.where(lost[:, None], known, np.nan)
        axis.plot(*marked.T, color=_ALERT, linewidth=2.6, label='reported as not diagnosable')
    ends = known[np.isfinite(known).all(axis=1)]
    if len(ends):
        axis.plot(
            *ends[0],
            'o',
            color=INK,
            markeredgecolor='white',
            markersize=6.5,
            label='start',
            linestyle='none',
        )
        axis.plot(
            *ends[-1],
            's',
            color=INK,
            markeredgecolor='white',
            markersize=6.0,
            label='end',
            linestyle='none',
        )


def _colored_path(axis: Axes, found: Detectability, i: int) -> None:
    """Without gains, what is known is known on the path alone."""
    rows = _spread(found.deviation)
    at, lost = np.degrees(found.deviation[rows]), found.not_diagnosable[rows, i]
    look: dict[str, Any] = {'s': 9.0, 'linewidths': 0}
    if found.moving is not None:
        shades = found.moving[rows, i][~lost]
        axis.scatter(at[~lost, 0], at[~lost, 1], c=shades, norm=_NORM, cmap=_COLORS, **look)
    if lost.any():
        label = 'reported as not diagnosable'
        axis.scatter(at[lost, 0], at[lost, 1], color=_ALERT, label=label, **look)


def _spread(deviation: np.ndarray, most: int = 3000) -> np.ndarray:
    return np.unique(np.linspace(0, len(deviation) - 1, most).astype(int))
