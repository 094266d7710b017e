"""Figures of a run, most of them counterparts of the paper's figures 4 to 8."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from lpv.bag.run.record import RunRecord
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.report import history, style
from lpv.report.history import Run, spans, starting, tip_positions, true_faults

if TYPE_CHECKING:
    from lpv.core.serial_arm.two_links import ArmParameters
    from lpv_design.guarantee import Guarantee

ALARM = '#c8102e'
STATES: tuple[tuple[SensorState, str, dict[str, Any]], ...] = (
    (SensorState.OK, 'watched, no fault', {'facecolor': '#e4e9ee'}),
    (SensorState.WARN, 'suspected', {'facecolor': '#f0c05a'}),
    (SensorState.ERROR, 'alarm', {'facecolor': ALARM}),
    (SensorState.NOT_DIAGNOSABLE, 'not diagnosable',
     {**style.HATCHED, 'facecolor': style.PAPER, 'linewidth': 0}),
    (SensorState.STALE, 'no data', {'facecolor': style.BAND}),
)  # fmt: skip
"""States of a sensor, their names and looks: bars and legend are drawn from the same entry."""
_LINES = {
    history.INCONSISTENT: style.SOFT,
    history.UNSAFE: '#a5456f',
    history.SAFE_STOP: style.INK,
    history.BRAKED: '#7a5c2e',
    history.NO_COMMAND: style.BAND,
    history.TOO_FAST: '#d01c3b',
}
_WIDTH, _HALF = 8.6, 0.32
"""Width of a figure [inch]; half the height of a bar, whose rows are 1 apart."""


def warm_up() -> None:
    """Draw nothing: fonts, layout and coding of pictures are loaded by the first figure."""
    style.picture(lambda: _axes(1)[0])


def _wide(color: str, label: str) -> dict[str, Any]:
    return {'label': label, 'color': color, 'linewidth': 3.4}


def _fine(color: str, label: str) -> dict[str, Any]:
    return {'label': label, 'color': color, 'linewidth': 1.1}


def _axes(rows: int, columns: int = 1, height: float = 2.15) -> tuple[Figure, np.ndarray]:
    look: Any = {'sharex': True, 'squeeze': False, 'figsize': (_WIDTH, height * rows + 0.3)}
    figure, axes = plt.subplots(rows, columns, **look)
    for axis in axes[-1]:
        axis.set_xlabel('time [s]')
    return figure, axes


def _column(record: RunRecord, stream: str, name: str, index: int) -> np.ndarray | None:
    values = record.aligned(stream, name)
    return None if values is None else values[:, index]


def _draw(axis: Axes, record: RunRecord, source: tuple[str, str, int], **look: Any) -> bool:
    """A column of a field of a stream, if it is there: returns whether it was drawn."""
    values = _column(record, *source)
    if values is None or not np.isfinite(values).any():
        return False
    axis.plot(*style.thin(record.time, values), **look)
    return True


def _finish(axis: Axes, record: RunRecord, title: str) -> None:
    """Title on the left, legend on the right, both above the data."""
    axis.set_title(title, pad=7)
    style.legend_above(axis)
    axis.set_xlim(0.0, record.time[-1])
    axis.margins(y=0.08)


def _legend(figure: Figure, axes: Any) -> None:
    """One legend above a figure, with each label once."""
    found: dict[str, Any] = {}
    for axis in np.atleast_1d(axes):
        for handle, label in zip(*axis.get_legend_handles_labels()):
            found.setdefault(label, handle)
    handles, labels = list(found.values()), list(found)
    figure.legend(handles, labels, loc='outside upper right', ncols=len(found), **style.SPARSE)


def timeline(run: Run) -> Figure | None:
    """States of the sensors over time, stops and contradictions, as bars."""
    record, names = run.record, run.arm.sensor_names
    state = record.get('fault_estimate', 'state')
    if state is None:
        return None
    lines = [what for what in _LINES if any(p.what == what for p in run.phases)]
    count = len(names) + len(lines)
    figure, axis = plt.subplots(figsize=(_WIDTH, 0.95 + 0.36 * count))
    stamps = record.stamps['fault_estimate']
    time, first = record.seconds(stamps), starting(record, stamps)
    for i in range(len(names)):
        shown = np.where(first, SensorState.OK, state[:, i])
        for which, label, look in STATES:
            if parts := [(start, end - start) for start, end in spans(shown == which, time)]:
                axis.broken_barh(parts, (i - _HALF, 2 * _HALF), label=label, **look)
    for fault in true_faults(record) or ():
        height = [fault.sensor_index + _HALF + 0.1] * 2
        look = {'color': style.INK, 'lw': 2.0, 'solid_capstyle': 'butt', 'label': 'true fault'}
        axis.plot([fault.start, fault.end], height, **look)
    for row, what in enumerate(lines, len(names)):
        parts = [(p.start, p.duration) for p in run.phases if p.what == what]
        axis.broken_barh(parts, (row - _HALF, 2 * _HALF), facecolor=_LINES[what])
    axis.set_yticks(range(count), [*names, *lines])
    axis.set(ylim=(count - 0.4, -0.6), xlim=(0.0, record.time[-1]), xlabel='time [s]')
    axis.grid(visible=False, axis='y')
    axis.tick_params(axis='y', length=0)
    axis.spines['left'].set_visible(False)
    _legend(figure, axis)
    return figure


def path(run: Run) -> Figure:
    """Fig. 4: the tip's path, seen from the side, and from above if it leaves the plane."""
    record, other = run.record, 'state_estimate'
    actual = 'ground_truth' if 'ground_truth' in record.streams else other
    tips = {s: _tips(run, s) for s in ('joint_states', 'reference', actual)}
    planned = run.path
    if tips['reference'] is None and planned is not None:
        tips['reference'] = planned.sample(np.linspace(planned.start, planned.end, 1000)).tip
    flat = all(np.ptp(points[:, 1]) < 1e-6 for points in tips.values() if points is not None)
    views = [('z, up [m]', 2)] if flat else [('z, up [m]', 2), ('y [m]', 1)]
    figure, axes = plt.subplots(1, len(views), squeeze=False, figsize=(_WIDTH, 4.6))
    curves = (
        ('joint_states', 'tip as measured, with faults', style.SENSOR[1], 0.8),
        ('reference', 'reference path', style.BAND, 6.0),
        (actual, 'tip as estimated' if actual == other else 'true tip', style.SENSOR[0], 1.4),
    )
    for axis, (label, row) in zip(axes[0], views):
        for stream, text, color, width in curves:
            if (points := tips[stream]) is not None:
                # Without those that are closer than a line's width, 0.5 mm, to the one before.
                shown = points[:, [0, row]]
                way = np.append(0.0, np.cumsum(np.hypot(*np.diff(shown, axis=0).T)))
                shown = shown[np.unique(np.floor(way / 0.5e-3), return_index=True)[1]]
                axis.plot(*shown.T, label=text, color=color, linewidth=width)
        marked = tips[actual] if tips[actual] is not None else tips['joint_states']
        if marked is not None:
            for name, end, sign, below in (('start', 0, 'o', 7), ('end', -1, 's', -13)):
                point = marked[end, [0, row]]
                axis.plot(*point, sign, color=style.INK, markersize=4.5, zorder=5)
                offset: Any = {'textcoords': 'offset points', 'xytext': (8, below)}
                axis.annotate(name, point, color=style.INK, **offset)
        obstacle = planned.obstacle if planned is not None else None
        if obstacle is not None:
            circle = plt.Circle(obstacle.center, obstacle.radius, label='obstacle', **style.HATCHED)
            axis.add_patch(circle)
        axis.set(xlabel='x [m]', ylabel=label)
        axis.set_aspect('equal', adjustable='datalim')
        axis.margins(0.05)
    _legend(figure, axes[0])
    return figure


def _tips(run: Run, stream: str) -> np.ndarray | None:
    position = run.record.aligned(stream, 'position')
    tips = None if position is None else tip_positions(run.arm, position)[0]
    return None if tips is None or not len(tips) else tips


def faults(run: Run) -> Figure | None:
    """Fig. 5: sensor faults and their estimates with bounds, thresholds and alarms."""
    record, names = run.record, run.arm.sensor_names
    if 'fault_estimate' not in record.streams:
        return None
    figure, axes = _axes(len(names), height=2.5)
    for i, axis in enumerate(axes[:, 0]):
        estimate, bound, state, threshold = (
            _column(record, 'fault_estimate', name, i)
            for name in ('estimate', 'bound', 'state', 'threshold')
        )
        assert estimate is not None and bound is not None
        assert state is not None and threshold is not None
        at, high = style.thin(record.time, threshold)
        look: dict[str, Any] = {'color': style.BAND, 'alpha': 0.45, 'linewidth': 0}
        axis.fill_between(at, -high, high, label='below threshold', **look)
        known = np.where(state != SensorState.NOT_DIAGNOSABLE, bound, np.nan)
        at, low, high = style.thin(record.time, estimate - known, estimate + known)
        look = {'color': style.PALE[i], 'alpha': 0.5, 'linewidth': 0}
        axis.fill_between(at, low, high, label='bound', **look)
        _draw(axis, record, ('ground_truth', 'fault', i), **_wide(style.PALE[i], 'fault'))
        _draw(axis, record, ('fault_estimate', 'estimate', i), **_fine(style.SENSOR[i], 'estimate'))
        mine = [e for e in run.alarms if e.sensor_index == i]
        end = float(record.time[-1])
        active = [(e.raised, end if e.cleared is None else e.cleared) for e in mine]
        style.shade(axis, active, 'alarm', color=ALARM, alpha=0.14)
        lost = spans(state == SensorState.NOT_DIAGNOSABLE, record.time)
        style.shade(axis, lost, 'not diagnosable', **style.HATCHED)
        # What is certain sets the scale: a bound that grows without end would hide the rest.
        shown = np.abs(np.concatenate([estimate, (np.abs(estimate) + known)[np.isfinite(known)]]))
        highest = np.nanpercentile(shown, 99.0) if np.isfinite(shown).any() else 1.0
        truth = _column(record, 'ground_truth', 'fault', i)
        if truth is not None and np.isfinite(truth).any():
            highest = max(highest, np.nanmax(np.abs(truth)))
        axis.set_ylabel(f'fault [{run.arm.position_units[i]}]')
        _finish(axis, record, f'Sensor {i + 1}: {names[i]}')
        axis.set_ylim(-1.1 * highest - 1e-6, 1.1 * highest + 1e-6)
    return figure


def _of_joints(
    run: Run, columns: tuple[tuple[str, str, tuple[tuple[Any, ...], ...]], ...], height: float
) -> Figure | None:
    """A row a joint: for each column the field's name, its unit, and curves of it.

    In units, {0} stands for that of the joint's position, {1} for that of its torque.
    """
    record, count, drawn = run.record, len(columns), False
    figure, axes = _axes(len(record.joint_names), count, height)
    for i, row in enumerate(axes):
        title = record.joint_names[i]
        for axis, (name, unit, curves) in zip(row, columns):
            for stream, field, look, colours, label in curves:
                drawn |= _draw(axis, record, (stream, field, i), **look(colours[i], label))
            axis.set_ylabel(f'{name} [{unit.format(*run.arm.joints[i].units)}]')
            _finish(axis, record, title if count > 1 else f'Joint {i + 1}: {title}')
    if drawn:
        return figure
    plt.close(figure)
    return None


def measured(run: Run) -> Figure | None:
    """Fig. 6: measured joint positions, with faults, and their references."""

    def dashed(color: str, label: str) -> dict[str, Any]:
        return {**_fine(color, label), 'linestyle': (0, (4, 2.5))}

    curves = (
        ('reference', 'position', _wide, style.PALE, 'reference'),
        ('joint_states', 'position', _fine, style.SENSOR, 'measured'),
        ('ground_truth', 'position', dashed, [style.INK] * len(style.PALE), 'true'),
    )
    return _of_joints(run, (('position', '{0}', curves),), 2.4)


def states(run: Run) -> Figure | None:
    """Fig. 7: joint positions and rates with their estimates."""
    record = run.record
    if 'state_estimate' not in record.streams:
        return None
    has_truth = 'ground_truth' in record.streams
    truth, label = ('ground_truth', 'true') if has_truth else ('joint_states', 'measured')
    columns = tuple(
        (field, unit, ((truth, field, _wide, style.PALE, label),
                       ('state_estimate', field, _fine, style.SENSOR, 'estimate')))
        for field, unit in (('position', '{0}'), ('velocity', '{0}/s'))
    )  # fmt: skip
    return _of_joints(run, columns, 2.0)


def torques(run: Run) -> Figure | None:
    """Fig. 8: torques of all joints."""
    curves = (
        ('joint_states', 'effort', _wide, style.PALE, 'measured effort'),
        ('torque_command', 'torque', _fine, style.SENSOR, 'command'),
    )
    return _of_joints(run, (('torque', '{1}', curves),), 2.2)


def draw_region(found: 'Guarantee', arm: 'ArmParameters', file: str | Path) -> None:
    """Write a map of the smallest fault that is always detected at rest."""
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_bytes(style.picture(_region, found, arm))


def _region(found: 'Guarantee', arm: 'ArmParameters') -> Figure:
    """What is hatched has no limit from gravity."""
    degrees, levels = np.degrees(found.deviation), (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
    colors = LinearSegmentedColormap.from_list('', ['#e8f1f8', '#9fcbe6', '#4a94c4', '#0b4a75'])
    look: dict[str, Any] = {'cmap': colors, 'norm': LogNorm(levels[0], 3.0), 'shading': 'nearest'}
    figure, axes = plt.subplots(1, 2, figsize=(_WIDTH, 4.1), sharey=True)
    for i, axis in enumerate(axes):
        axis.grid(visible=False)
        values = found.detectable[:, :, i].T
        values = np.where(np.isfinite(values), values, np.nan)
        shades = axis.pcolormesh(degrees, degrees, values, **look)
        axis.patch.set(facecolor=style.PAPER, hatch='////', edgecolor=style.SOFT, linewidth=0.0)
        lines = axis.contour(degrees, degrees, values, levels, colors=style.INK, linewidths=0.8)
        axis.clabel(lines, fmt='%g rad', fontsize=7.5)
        axis.set(title=arm.sensor_names[i], xlabel='link 1 from the vertical [deg]')
        axis.set_aspect('equal')
    axes[0].set_ylabel('link 2 from the vertical [deg]')
    bar = figure.colorbar(shades, ax=axes, ticks=levels, shrink=0.85, pad=0.02, format='%g')
    bar.set_label('smallest lasting fault that is\nalways detected at rest [rad]')
    return figure
