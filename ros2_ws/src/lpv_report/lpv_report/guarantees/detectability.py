"""How large a lasting fault must be to be detected for certain, along the path of a run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_bag.run.streams import RunRecord
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import SensorState
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_design.guarantee import at_rest, vertical
from lpv_report.history.phases import starting

_ALONG, _ACROSS = 400, 41
_MARGIN = np.radians(8.0)
_WIDEST = 2.0 * np.pi
_SOURCES = (('ground_truth', 'true'), ('state_estimate', 'estimated'), ('joint_states', 'measured'))


@dataclass(frozen=True)
class Grid:
    """Detectability over configurations."""

    one: np.ndarray  # angles of link 1 from the vertical of the region, shape (n,) [rad]
    two: np.ndarray  # angles of link 2 from the vertical of the region, shape (m,) [rad]
    # smallest lasting fault of each sensor that is detected for certain at rest [rad]; None without
    # gains; shape (n, m, 2)
    detectable: np.ndarray | None
    # where a sensor is not diagnosable: a link that it sees is outside the certified region; shape
    # (n, m, 2)
    lost: np.ndarray


@dataclass(frozen=True)
class Detectability:
    """What could be detected during a run."""

    source: str  # whose angles they are: true, estimated or measured
    time: np.ndarray  # of each measurement [s]; shape (n,)
    # angles of the links from the vertical of the region [rad]; NaN where unknown; shape (n, 2)
    deviation: np.ndarray
    # threshold plus bound as recorded [rad]: they know motion and past; shape (n, 2)
    moving: np.ndarray | None
    not_diagnosable: np.ndarray  # as recorded; shape (n, 2)
    places: np.ndarray  # rows for which the following was computed; empty without gains; shape (k,)
    # threshold plus bound of the design at rest in the configuration [rad]; infinite where gravity
    # cannot bound the error; shape (k, 2)
    resting: np.ndarray
    gains: Gains | None  # what `configurations` needs


def detectability(
    record: RunRecord, arm: ArmParameters, gains: Gains | None = None
) -> Detectability | None:
    """Detectability of a run.

    Parameters
    ----------
    record : RunRecord
        The run.
    arm : ArmParameters
        Its arm.
    gains : Gains, optional
        Gains whose certificate holds; without, what was recorded is all that is known.

    Returns
    -------
    Detectability or None
        None if there are neither gains nor recorded thresholds.
    """
    estimate = [record.aligned('fault_estimate', name) for name in ('threshold', 'bound', 'state')]
    if gains is None and estimate[0] is None:
        return None
    source, angles = _angles(record, arm)
    deviation = _near_zero(angles - vertical(arm))
    moving, lost = None, np.zeros(deviation.shape, bool)
    if estimate[0] is not None:
        moving = estimate[0] + estimate[1]
        lost = (estimate[2] == SensorState.NOT_DIAGNOSABLE) & ~starting(
            record, record.stamps['joint_states']
        )[:, None]
    places, resting = np.zeros(0, int), np.zeros((0, 2))
    if gains is not None:
        known = np.flatnonzero(np.isfinite(deviation).all(axis=1))
        places = (
            known[np.unique(np.linspace(0, len(known) - 1, _ALONG).astype(int))]
            if len(known)
            else known
        )
        resting = np.add(*at_rest(arm, gains, deviation[places] + vertical(arm)))
    return Detectability(source, record.time, deviation, moving, lost, places, resting, gains)


def _angles(record: RunRecord, arm: ArmParameters) -> tuple[str, np.ndarray]:
    for stream, text in _SOURCES:
        position = record.aligned(stream, 'position')
        if position is not None:
            return text, JointMap(arm).absolute_position(position)
    raise AssertionError('a run has measurements')


def _near_zero(angles: np.ndarray) -> np.ndarray:
    """Angles without whole turns, so that the path is near the vertical and has no jumps."""
    result = np.array(angles)
    for column in result.T:
        known = np.isfinite(column)
        if known.any():
            smooth = np.unwrap(column[known])
            column[known] = smooth - 2.0 * np.pi * np.round(np.median(smooth) / (2.0 * np.pi))
            if np.ptp(column[known]) > _WIDEST:  # a map of many turns shows nothing
                column[known] = (column[known] + np.pi) % (2.0 * np.pi) - np.pi
    return result


def configurations(found: Detectability, arm: ArmParameters) -> Grid:
    """Detectability at rest over all configurations around the path."""
    deviation, gains, limits = found.deviation, found.gains, np.arccos(arm.cos_min)
    axes = []
    for i in range(2):
        known = deviation[np.isfinite(deviation[:, i]), i]
        low, high = min([-limits[i], *known]), max([limits[i], *known])
        axes.append(np.linspace(low - _MARGIN, high + _MARGIN, _ACROSS))
    both = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
    outside = np.cos(both) < np.asarray(arm.cos_min)
    seen = np.abs(JointMap(arm).sensor_matrix) > 0.0
    lost = np.stack([(outside & row).any(axis=-1) for row in seen], axis=-1)
    able = None if gains is None else np.add(*at_rest(arm, gains, both + vertical(arm)))
    return Grid(axes[0], axes[1], able, lost)


@dataclass(frozen=True)
class DetectabilityRow:
    """Summary for one sensor; None where a figure is not known."""

    sensor: str  # its name
    # recorded threshold plus bound while it was diagnosable [rad]
    smallest: float | None = None  # least
    middle: float | None = None  # median
    largest: float | None = None  # greatest
    # at rest in the configurations of the path, as far as gravity bounds the error [rad]
    rest_smallest: float | None = None  # least
    rest_largest: float | None = None  # greatest
    # share of the path in which gravity does not bound the error at rest
    unbounded: float | None = None
    lost: float | None = None  # share of the time in which the sensor was not diagnosable


def summary(found: Detectability, sensor_names: Sequence[str]) -> list[DetectabilityRow]:
    """Summary for all sensors."""
    return [
        DetectabilityRow(name, **_recorded(found, i), **_resting(found, i))
        for i, name in enumerate(sensor_names)
    ]


def _recorded(found: Detectability, i: int) -> dict[str, float]:
    if found.moving is None:
        return {}
    lost = found.not_diagnosable[:, i]
    values = found.moving[~lost, i]
    values = values[np.isfinite(values)]
    share = {'lost': float(lost.mean())}
    if not values.size:
        return share
    return {
        **share,
        'smallest': float(values.min()),
        'middle': float(np.median(values)),
        'largest': float(values.max()),
    }


def _resting(found: Detectability, i: int) -> dict[str, float]:
    values = found.resting[:, i]
    if not values.size:
        return {}
    finite = values[np.isfinite(values)]
    ends = (
        {'rest_smallest': float(finite.min()), 'rest_largest': float(finite.max())}
        if finite.size
        else {}
    )
    return {**ends, 'unbounded': float(1.0 - finite.size / values.size)}
