"""How large a lasting fault must be to be detected for certain, along the path of a run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_core.decision.diagnosis import SensorState
from lpv_core.model.joints import JointMap
from lpv_design.guarantee import at_rest, vertical
from lpv_report.history.phases import starting

_ALONG, _ACROSS = 400, 41
_MARGIN = np.radians(8.0)
_WIDEST = 2.0 * np.pi
_SOURCES = (('ground_truth', 'true'), ('state_estimate', 'estimated'), ('joint_states', 'measured'))


@dataclass(frozen=True)
class Grid:
    """Detectability over configurations.

    Attributes
    ----------
    one, two : ndarray, shapes (n,) and (m,)
        Angles of link 1 and 2 from the vertical of the region [rad].
    detectable : ndarray or None, shape (n, m, 2)
        Smallest lasting fault of each sensor that is detected for certain at rest [rad]; None
        without gains.
    lost : ndarray of bool, shape (n, m, 2)
        Where a sensor is not diagnosable: a link that it sees is outside the certified region.
    """

    one: np.ndarray
    two: np.ndarray
    detectable: np.ndarray
    lost: np.ndarray


@dataclass(frozen=True)
class Detectability:
    """What could be detected during a run.

    Attributes
    ----------
    source : str
        Whose angles they are: true, estimated or measured.
    time : ndarray, shape (n,)
        Of each measurement [s].
    deviation : ndarray, shape (n, 2)
        Angles of the links from the vertical of the region [rad]; NaN where unknown.
    moving : ndarray or None, shape (n, 2)
        Threshold plus bound as recorded [rad]: they know motion and past.
    not_diagnosable : ndarray of bool, shape (n, 2)
        As recorded.
    places : ndarray of int, shape (k,)
        Rows for which the following was computed; empty without gains.
    resting : ndarray, shape (k, 2)
        Threshold plus bound of the design at rest in the configuration [rad]; infinite where
        gravity cannot bound the error.
    gains : Gains or None
        What `configurations` needs.
    """

    source: str
    time: np.ndarray
    deviation: np.ndarray
    moving: np.ndarray
    not_diagnosable: np.ndarray
    places: np.ndarray
    resting: np.ndarray
    gains: object


def detectability(record, arm, gains=None) -> Detectability | None:
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
        resting = sum(at_rest(arm, gains, deviation[places] + vertical(arm)))
    return Detectability(source, record.time, deviation, moving, lost, places, resting, gains)


def _angles(record, arm):
    for stream, text in _SOURCES:
        position = record.aligned(stream, 'position')
        if position is not None:
            return text, JointMap(arm).absolute_position(position)
    raise AssertionError('a run has measurements')


def _near_zero(angles):
    """Whole turns taken off, so that the path lies around the vertical without jumps."""
    result = np.array(angles)
    for column in result.T:
        known = np.isfinite(column)
        if known.any():
            smooth = np.unwrap(column[known])
            column[known] = smooth - 2.0 * np.pi * np.round(np.median(smooth) / (2.0 * np.pi))
            if np.ptp(column[known]) > _WIDEST:  # a map of many turns shows nothing
                column[known] = (column[known] + np.pi) % (2.0 * np.pi) - np.pi
    return result


def configurations(found: Detectability, arm) -> Grid:
    """Detectability at rest over all configurations around the path.

    Parameters
    ----------
    found : Detectability
        Path, and gains if they are known.
    arm : ArmParameters
        The arm.

    Returns
    -------
    Grid
        Covers path and certified region.
    """
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
    able = None if gains is None else sum(at_rest(arm, gains, both + vertical(arm)))
    return Grid(*axes, able, lost)


@dataclass(frozen=True)
class DetectabilityRow:
    """Summary for one sensor; None where there is nothing to tell.

    Attributes
    ----------
    sensor : str
        Its name.
    smallest, middle, largest : float or None
        Recorded threshold plus bound while it was diagnosable: least, median, greatest [rad].
    rest_smallest, rest_largest : float or None
        At rest in the configurations of the path, as far as gravity bounds the error [rad].
    unbounded : float or None
        Share of the path in which gravity does not bound the error at rest.
    lost : float or None
        Share of the time in which the sensor was not diagnosable.
    """

    sensor: str
    smallest: float = None
    middle: float = None
    largest: float = None
    rest_smallest: float = None
    rest_largest: float = None
    unbounded: float = None
    lost: float = None


def summary(found: Detectability, sensor_names: Sequence[str]) -> list[DetectabilityRow]:
    """Summary for all sensors.

    Parameters
    ----------
    found : Detectability
        Of `detectability`.
    sensor_names : sequence of str
        Names of the sensors.

    Returns
    -------
    list of DetectabilityRow
        One a sensor.
    """
    return [
        DetectabilityRow(name, **_recorded(found, i), **_resting(found, i))
        for i, name in enumerate(sensor_names)
    ]


def _recorded(found, i):
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


def _resting(found, i):
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
