"""What is kept of one run: figures of detection, isolation, estimates, tracking."""

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from lpv_campaign.plan.spec import BOTH, NO_FAULT
from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.joints import JointMap
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.faults import Fault

DIVERGED = 1.0
"""True tracking error that counts as lost control [rad]."""
BINS = np.linspace(0.0, 1.0, 21)
"""Edges of the classes of abs(cos(theta_i)) by which errors of fault estimates are summed."""
_SETTLED = 1.0
"""The first second is the approach; errors count from then on [s]."""
_EARLY = 0.1
"""An onset estimate may be so much earlier than the fault [s]."""


class Columns(NamedTuple):
    """Names of the figures by type; meaning and units in docs/campaign.md."""

    floats: tuple[str, ...]
    texts: tuple[str, ...]
    counts: tuple[str, ...]
    flags: tuple[str, ...]
    lists: tuple[str, ...]


def columns_of(sensors: int) -> Columns:
    """Names of the figures of an arm with so many sensors."""

    def each(*names: str) -> tuple[str, ...]:
        return tuple(f'{name}_{i + 1}' for name in names for i in range(sensors))

    return Columns(
        (
            *_FLOATS,
            *each('score_before', 'score_during', 'mean_threshold', 'error_rms', 'least_cos'),
        ),
        ('said_kind', 'said_sensor'),
        ('false_alarms', 'wrong_alarms', 'safe_stops', *each('alarms_before')),
        ('detected', 'isolated', 'stable', *each('found')),
        each('error_squares', 'error_counts'),
    )


_FLOATS = (
    'detection_delay',
    'onset_error',
    'size_at_detection',
    'size_error',
    'fault_rms_before',
    'fault_rms_during',
    'angle_rms',
    'tracking_rms',
    'tracking_rms_during',
    'tracking_ratio',
    'tracking_max',
    'braked_time',
    'inconsistent_time',
)
FLOATS, TEXTS, COUNTS, FLAGS, LISTS = columns_of(2)
"""Those of the two-link arm."""


def figures(plan: Any, run: Any, twin: Any = None) -> dict[str, Any]:
    """Figures of one run.

    Parameters
    ----------
    plan : RunPlan
        What was simulated.
    run : Run or SerialLoopRun
        What came out.
    twin : Run or SerialLoopRun, optional
        The same run without faults.

    Returns
    -------
    dict
        By the names above; NaN where there is nothing to be measured.
    """
    faults = [f for f in plan.scenario.faults if f.kind != 'rate_bias']
    begin, end = _interval(plan.scenario)
    before, during = run.time < begin, (run.time >= begin) & (run.time < end)
    names = plan.arm.sensor_names
    result = {
        'seed': plan.scenario.seed,
        'kind': plan.scenario.faults[0].kind if plan.scenario.faults else NO_FAULT,
        'sensor': _named({f.sensor for f in plan.scenario.faults}, names),
    }
    result.update(_alarm_figures(run, faults, names, begin, end))
    result.update(_sensor_figures(plan.arm, run, faults, begin, end))
    result.update(_estimate_figures(plan.arm, run, before, during))
    result.update(_tracking_figures(plan, run, twin, during))
    return result


def _interval(scenario: Any) -> tuple[float, float]:
    """From the first onset to the last end of all faults [s]."""
    begin = min((f.onset for f in scenario.faults), default=math.inf)
    end = max(
        (f.onset + f.duration if f.duration > 0.0 else math.inf for f in scenario.faults),
        default=math.inf,
    )
    return begin, end


def _named(sensors: Collection[str], names: Sequence[str]) -> str:
    """Sensors as one text: a name, both of two, names joined by +."""
    if len(sensors) == len(names) == 2:
        return BOTH
    return '+'.join(name for name in names if name in sensors) or NO_FAULT


def _angles(arm: Arm, position: np.ndarray) -> np.ndarray:
    """Angles in which errors count: absolute ones of two links, those of a serial arm's joints."""
    return position if isinstance(arm, SerialArm) else JointMap(arm).absolute_position(position)


def _own_alarms(
    run: Any, faulty: Collection[str], begin: float, end: float
) -> dict[str, list[Any]]:
    """Alarms that count for each faulty sensor."""
    own: dict[str, list[Any]] = {}
    for alarm in run.alarms:
        if (
            alarm.event != AlarmEvent.CLEARED
            and alarm.sensor in faulty
            and begin <= alarm.detected / 1e9 < end
            and alarm.onset / 1e9 >= begin - _EARLY
        ):
            own.setdefault(alarm.sensor, []).append(alarm)
    return own


def _alarm_figures(
    run: Any, faults: list[Fault], names: Sequence[str], begin: float, end: float
) -> dict[str, Any]:
    """Alarms while a fault acts count for it; all others are false."""
    raised = [a for a in run.alarms if a.event == AlarmEvent.RAISED]
    faulty = {f.sensor: f for f in faults}
    own = _own_alarms(run, faulty, begin, end)
    inside = [a for a in raised if begin <= a.detected / 1e9 < end]
    said = {a.sensor for a in inside}
    found = bool(own) and set(own) == set(faulty)
    first = {sensor: alarms[0] for sensor, alarms in own.items()}
    return {
        'false_alarms': len(raised) - len(inside) + (0 if faulty else len(inside)),
        'wrong_alarms': sum(a.sensor not in faulty for a in inside) if faulty else 0,
        'detected': found,
        'isolated': found and said == set(faulty),
        'said_sensor': _named(said, names),
        'said_kind': _last_kind(own, inside),
        'detection_delay': max(first[s].detected / 1e9 - f.onset for s, f in faulty.items())
        if found
        else math.nan,
        'onset_error': max(abs(first[s].onset / 1e9 - f.onset) for s, f in faulty.items())
        if found
        else math.nan,
        'size_at_detection': max(abs(a.size) for a in first.values()) if found else math.nan,
        'size_error': max(abs(first[s].size - f.size) for s, f in faulty.items())
        if found and all(f.kind == 'bias' for f in faults)
        else math.nan,
    }


def _sensor_figures(
    arm: Arm, run: Any, faults: list[Fault], begin: float, end: float
) -> dict[str, Any]:
    """What the curves of detection against false alarms need of each sensor."""
    own = _own_alarms(run, {f.sensor for f in faults}, begin, end)
    early = [
        a.sensor for a in run.alarms if a.event == AlarmEvent.RAISED and a.detected / 1e9 < begin
    ]
    result = {}
    for number, name in enumerate(arm.sensor_names, start=1):
        result[f'alarms_before_{number}'] = early.count(name)
        result[f'found_{number}'] = name in own
    return result


def _last_kind(own: dict[str, list[Any]], inside: list[Any]) -> str:
    """Kind in the last alarm of the faulty sensor, or else of any other."""
    alarms = [alarms[-1] for alarms in own.values()] or inside
    return alarms[-1].kind if alarms else NO_FAULT


def _estimate_figures(arm: Arm, run: Any, before: np.ndarray, during: np.ndarray) -> dict[str, Any]:
    settled = run.time >= _SETTLED
    error = run.fault_estimate - run.fault
    # A loop that runs away ends in infinities, and its last scores are none.
    with np.errstate(invalid='ignore'):
        score = np.abs(run.fault_estimate) / run.threshold
    angle = _angles(arm, run.position)
    result = {
        'fault_rms_before': _rms(error[before & settled]),
        'fault_rms_during': _rms(error[during]),
        'angle_rms': _rms((angle - _angles(arm, run.estimate))[settled]),
    }
    for i in range(error.shape[1]):
        number = i + 1
        result[f'score_before_{number}'] = _largest(score[before, i])
        result[f'score_during_{number}'] = _largest(score[during, i])
        result[f'mean_threshold_{number}'] = float(run.threshold[settled, i].mean())
        result[f'error_rms_{number}'] = _rms(error[settled, i])
    # What a joint's level can be told from is no function of its own angle on a serial arm.
    if not isinstance(arm, SerialArm):
        result.update(_errors_by_angle(angle, error, settled))
    return result


def _errors_by_angle(angle: np.ndarray, error: np.ndarray, settled: np.ndarray) -> dict[str, Any]:
    """Sums of squared errors over classes of the angles of both links."""
    cosine, result = np.abs(np.cos(angle)), {}
    places = np.clip(np.searchsorted(BINS, cosine, side='right') - 1, 0, len(BINS) - 2)
    known = np.isfinite(error) & settled[:, None]
    for i in range(2):
        number = i + 1
        result[f'least_cos_{number}'] = _least(cosine[:, i])
        here = places[known[:, i], i]
        result[f'error_squares_{number}'] = np.bincount(
            here, error[known[:, i], i] ** 2, len(BINS) - 1
        ).tolist()
        result[f'error_counts_{number}'] = (
            np.bincount(here, None, len(BINS) - 1).astype(float).tolist()
        )
    return result


def _tracking_figures(plan: Any, run: Any, twin: Any, during: np.ndarray) -> dict[str, Any]:
    error = _angles(plan.arm, run.position) - _angles(plan.arm, run.reference)
    largest = float(np.abs(error).max())
    finite = bool(np.isfinite(run.position).all() and np.isfinite(run.torque).all())
    braked, period = run.braked, plan.arm.sample_time
    result = {
        'tracking_rms': _rms(error[run.time >= _SETTLED]),
        'tracking_rms_during': _rms(error[during]),
        'tracking_max': largest,
        'tracking_ratio': math.nan,
        'stable': finite and largest < DIVERGED,
        'safe_stops': int(np.count_nonzero(braked[1:] & ~braked[:-1])),
        'braked_time': float(braked.sum() * period),
        'inconsistent_time': float(run.inconsistent.sum() * period),
    }
    if twin is not None and during.any():
        healthy = _angles(plan.arm, twin.position) - _angles(plan.arm, twin.reference)
        result['tracking_ratio'] = result['tracking_rms_during'] / _rms(healthy[during])
    return result


def _rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def _largest(values: np.ndarray) -> float:
    values = values[~np.isnan(values)]
    return float(values.max()) if values.size else math.nan


def _least(values: np.ndarray) -> float:
    return float(values.min()) if values.size else math.nan
