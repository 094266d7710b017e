"""Counterparts of the paper's figures 4 to 8; one function per figure.

Every function returns a Matplotlib figure, or None where the run has nothing to show in it.
Each joint or sensor has one colour throughout; wide pale lines are the truth or the
reference, thin lines what is measured or estimated.
"""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpv_bag.run.streams import RunRecord
from lpv_core.control.path import CartesianPath
from lpv_core.decision.diagnosis import SensorState
from lpv_core.model.arm import ArmParameters
from lpv_core.model.kinematics import forward
from lpv_report.history.episodes import Episode, episodes, intervals
from lpv_report.style import BAND, HATCHED, INK, PALE, SENSOR, SOFT, legend_above, shade, thin

_WIDTH = 8.6
_DASHED = (0, (4, 2.5))


def _wide(color: str, label: str) -> dict[str, Any]:
    return {'label': label, 'color': color, 'linewidth': 3.4}


def _fine(color: str, label: str) -> dict[str, Any]:
    return {'label': label, 'color': color, 'linewidth': 1.1}


def _axes(
    rows: int, columns: int = 1, height: float = 2.15, **options: Any
) -> tuple[Figure, np.ndarray]:
    figure, axes = plt.subplots(
        rows, columns, sharex=True, squeeze=False, figsize=(_WIDTH, height * rows + 0.3), **options
    )
    for axis in axes[-1]:
        axis.set_xlabel('time [s]')
    return figure, axes


def _draw(axis: Axes, record: RunRecord, source: tuple[str, str, int], **look: Any) -> bool:
    """A column of a field of a stream, if it is there: returns whether it was drawn."""
    values = _column(record, *source)
    if values is None or not np.isfinite(values).any():
        return False
    axis.plot(*thin(record.time, values), **look)
    return True


def _finish(axis: Axes, record: RunRecord, title: str) -> None:
    """Title on the left, legend on the right, both above the data."""
    axis.set_title(title, pad=7)
    legend_above(axis)
    axis.set_xlim(0.0, record.time[-1])
    axis.margins(y=0.08)


def _column(record: RunRecord, stream: str, name: str, index: int) -> np.ndarray | None:
    values = record.aligned(stream, name)
    return None if values is None else values[:, index]


def _tip(
    record: RunRecord, arm: ArmParameters, stream: str, name: str = 'position'
) -> np.ndarray | None:
    q = record.aligned(stream, name)
    if q is None:
        return None
    # Kinematics count q1 from the x-axis; joint zeros differ between arms.
    return forward(q + np.array([arm.zero_angle + np.pi / 2, 0.0]), arm.lengths)


def cartesian(record: RunRecord, arm: ArmParameters, path: CartesianPath | None = None) -> Figure:
    """Fig. 4: reference path, true path, and the path according to the measurements."""
    figure, axis = plt.subplots(figsize=(_WIDTH, 4.6))
    reference = record.aligned('reference', 'tip_position')
    if reference is None and path is not None:
        reference = path.sample(np.linspace(path.start, path.end, 1000)).tip
    actual, label = _tip(record, arm, 'ground_truth'), 'true tip'
    if actual is None:
        actual, label = _tip(record, arm, 'state_estimate'), 'tip as estimated'
    tip = _tip(record, arm, 'joint_states')
    curves = (
        (tip, 'tip as measured, with faults', SENSOR[1], 0.8),
        (reference, 'reference path', BAND, 6.0),
        (actual, label, SENSOR[0], 1.4),
    )
    for points, text, color, width in curves:
        if points is not None:
            axis.plot(*_thin_path(points), label=text, color=color, linewidth=width)
    if path is not None and path.obstacle is not None:
        axis.add_patch(
            plt.Circle(
                path.obstacle.center,
                path.obstacle.radius,
                facecolor='none',
                edgecolor=SOFT,
                hatch='////',
                label='obstacle',
            )
        )
    marked = actual if actual is not None else tip
    if marked is not None:
        _mark_ends(axis, marked)
    axis.set(xlabel='x [m]', ylabel='y [m]')
    axis.set_aspect('equal', adjustable='datalim')
    axis.margins(0.05)
    figure.legend(
        *axis.get_legend_handles_labels(),
        loc='outside upper right',
        ncols=4,
        handlelength=1.7,
        columnspacing=1.3,
    )
    return figure


def _thin_path(points: np.ndarray, step: float = 0.5e-3) -> np.ndarray:
    """x and y without samples that are closer than a line's width to the one before [m]."""
    points = points[np.isfinite(points).all(axis=1)]
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    _, index = np.unique(np.floor(travelled / step), return_index=True)
    return points[index].T


def _mark_ends(axis: Axes, points: np.ndarray) -> None:
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return
    for point, marker, text in ((points[0], 'o', 'start'), (points[-1], 's', 'end')):
        axis.plot(*point, marker, color=INK, markersize=4.5, zorder=5)
        axis.annotate(
            text,
            point,
            textcoords='offset points',
            xytext=(8, 7) if text == 'start' else (8, -13),
            color=INK,
        )


def faults(
    record: RunRecord, sensor_names: Sequence[str] | None = None, banded: bool = False
) -> Figure | None:
    """Fig. 5: sensor faults and their estimates, thresholds and alarms; with the bounds' band."""
    if 'fault_estimate' not in record.streams:
        return None
    names = sensor_names or record.sensor_names
    time, alarms = record.time, episodes(record)
    figure, axes = _axes(len(names), height=2.5)
    for i, axis in enumerate(axes[:, 0]):
        threshold = _column(record, 'fault_estimate', 'threshold', i)
        if threshold is not None:
            at, high = thin(time, threshold)
            look: dict[str, Any] = {'color': BAND, 'alpha': 0.45, 'linewidth': 0}
            axis.fill_between(at, -high, high, label='below threshold', **look)
        _draw(axis, record, ('ground_truth', 'fault', i), **_wide(PALE[i], 'fault'))
        _draw(axis, record, ('fault_estimate', 'estimate', i), **_fine(SENSOR[i], 'estimate'))
        if banded:
            _band(axis, record, i)
        _shade(axis, record, i, alarms)
        axis.set_ylabel('fault [rad]')
        _finish(axis, record, f'Sensor {i + 1}: {names[i]}')
    return figure


def _band(axis: Axes, record: RunRecord, i: int) -> None:
    """Estimate with its bound, where the sensor is diagnosable; the axis shows that alone."""
    estimate, bound, state, threshold = (
        _column(record, 'fault_estimate', name, i)
        for name in ('estimate', 'bound', 'state', 'threshold')
    )
    if estimate is None or bound is None or state is None or threshold is None:
        return
    known = state != SensorState.NOT_DIAGNOSABLE
    width = np.where(known, bound, np.nan)
    at, low = thin(record.time, estimate - width)
    axis.fill_between(
        at, low, thin(record.time, estimate + width)[1], color=PALE[i], alpha=0.5, linewidth=0,
        label='bound',
    )  # fmt: skip
    shown = np.abs(np.concatenate([estimate, threshold[known], (np.abs(estimate) + bound)[known]]))
    highest = np.nanpercentile(shown, 99.0) if np.isfinite(shown).any() else 1.0
    axis.set_ylim(-1.1 * highest - 1e-6, 1.1 * highest + 1e-6)


def _shade(axis: Axes, record: RunRecord, sensor: int, alarms: list[Episode]) -> None:
    """Alarms as shaded, intervals without diagnosis as hatched intervals."""
    end = float(record.time[-1])
    mine = [e for e in alarms if e.sensor_index == sensor]
    spans = [(e.raised, end if e.cleared is None else e.cleared) for e in mine]
    shade(axis, spans, 'alarm', color=SENSOR[sensor], alpha=0.12)
    state = _column(record, 'fault_estimate', 'state', sensor)
    if state is not None:
        lost = intervals(state == SensorState.NOT_DIAGNOSABLE, record.time)
        shade(axis, [(part.start, part.end) for part in lost], 'not diagnosable', **HATCHED)


def measured(record: RunRecord) -> Figure:
    """Fig. 6: measured joint positions, with faults, and their references."""
    figure, axes = _axes(len(record.joint_names), height=2.4)
    for i, axis in enumerate(axes[:, 0]):
        _draw(axis, record, ('reference', 'position', i), **_wide(PALE[i], 'reference'))
        _draw(axis, record, ('joint_states', 'position', i), **_fine(SENSOR[i], 'measured'))
        dashed = {**_fine(INK, 'true'), 'linestyle': _DASHED}
        _draw(axis, record, ('ground_truth', 'position', i), **dashed)
        axis.set_ylabel('position [rad]')
        _finish(axis, record, f'Joint {i + 1}: {record.joint_names[i]}')
    return figure


def states(record: RunRecord) -> Figure | None:
    """Fig. 7: joint positions and rates with their estimates."""
    if 'state_estimate' not in record.streams:
        return None
    truth = 'ground_truth' if 'ground_truth' in record.streams else 'joint_states'
    label = 'true' if truth == 'ground_truth' else 'measured'
    joints = len(record.joint_names)
    if joints <= 2:
        figure, axes = _axes(2, joints, height=2.35)
    else:
        figure, axes = _axes(joints, 2, height=2.0)
        axes = axes.T
    for row, field, unit in zip(axes, ('position', 'velocity'), ('rad', 'rad/s')):
        for i, axis in enumerate(row):
            _draw(axis, record, (truth, field, i), **_wide(PALE[i], label))
            _draw(axis, record, ('state_estimate', field, i), **_fine(SENSOR[i], 'estimate'))
            axis.set_ylabel(f'{field} [{unit}]')
            _finish(axis, record, record.joint_names[i])
    return figure


def torques(record: RunRecord) -> Figure | None:
    """Fig. 8: torques of all joints."""
    figure, axes = _axes(len(record.joint_names), height=2.2)
    drawn = False
    for i, axis in enumerate(axes[:, 0]):
        effort = _wide(PALE[i], 'measured effort')
        drawn |= _draw(axis, record, ('joint_states', 'effort', i), **effort)
        command = _fine(SENSOR[i], 'command')
        drawn |= _draw(axis, record, ('torque_command', 'torque', i), **command)
        axis.set_ylabel('torque [N m]')
        _finish(axis, record, f'Joint {i + 1}: {record.joint_names[i]}')
    if not drawn:
        plt.close(figure)
        return None
    return figure
