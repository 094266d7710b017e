"""What is kept of one run: figures of detection, isolation, estimates, tracking."""

import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from lpv_campaign.plan.spec import BOTH, NO_FAULT
from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.simulation.faults import Fault

DIVERGED = 1.0
"""True tracking error that counts as lost control [rad]."""
BINS = np.linspace(0.0, 1.0, 21)
"""Edges of the classes of abs(cos(theta_i)) by which errors of fault estimates are summed."""
_SETTLED = 1.0
"""The first second is the approach; errors count from then on [s]."""
_EARLY = 0.1
"""An onset estimate may be so much earlier than the fault [s]."""
FLOATS = (
    'detection_delay',
    'onset_error',
    'size_at_detection',
    'size_error',
    'score_before_1',
    'score_before_2',
    'score_during_1',
    'score_during_2',
    'fault_rms_before',
    'fault_rms_during',
    'angle_rms',
    'tracking_rms',
    'tracking_rms_during',
    'tracking_ratio',
    'tracking_max',
    'least_cos_1',
    'least_cos_2',
    'braked_time',
    'inconsistent_time',
    'mean_threshold_1',
    'mean_threshold_2',
)
TEXTS = ('said_kind', 'said_sensor')
COUNTS = ('false_alarms', 'wrong_alarms', 'safe_stops', 'alarms_before_1', 'alarms_before_2')
FLAGS = ('detected', 'isolated', 'stable', 'found_1', 'found_2')
LISTS = ('error_squares_1', 'error_squares_2', 'error_counts_1', 'error_counts_2')
"""Names of the figures by type; meaning and units in docs/campaign.md."""


def figures(plan: Any, run: Any, twin: Any = None) -> dict[str, Any]:
    """Figures of one run.

    Parameters
    ----------
    plan : RunPlan
        What was simulated.
    run : lpv_core.simulation.closed_loop.Run
        What came out.
    twin : lpv_core.simulation.closed_loop.Run, optional
        The same run without faults.

    Returns
    -------
    dict
        By the names above; NaN where there is nothing to be measured.
    """
    faults = [f for f in plan.scenario.faults if f.kind != 'rate_bias']
    begin, end = _interval(plan.scenario)
    before, during = run.time < begin, (run.time >= begin) & (run.time < end)
    joints = JointMap(plan.arm)
    result = {
        'seed': plan.scenario.seed,
        'kind': plan.scenario.faults[0].kind if plan.scenario.faults else NO_FAULT,
        'sensor': _named([f.sensor for f in plan.scenario.faults]),
    }
    result.update(_alarm_figures(run, faults, begin, end))
    result.update(_sensor_figures(plan.arm, run, faults, begin, end))
    result.update(_estimate_figures(run, joints, before, during))
    result.update(_tracking_figures(plan, run, twin, joints, during))
    return result


def _interval(scenario: Any) -> tuple[float, float]:
    """From the first onset to the last end of all faults [s]."""
    begin = min((f.onset for f in scenario.faults), default=math.inf)
    end = max(
        (f.onset + f.duration if f.duration > 0.0 else math.inf for f in scenario.faults),
        default=math.inf,
    )
    return begin, end


def _named(sensors: Sequence[str]) -> str:
    return (sensors[0] if len(sensors) == 1 else BOTH) if sensors else NO_FAULT


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


def _alarm_figures(run: Any, faults: list[Fault], begin: float, end: float) -> dict[str, Any]:
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
        'said_sensor': _named(sorted(said)),
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
    arm: ArmParameters, run: Any, faults: list[Fault], begin: float, end: float
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


def _estimate_figures(
    run: Any, joints: JointMap, before: np.ndarray, during: np.ndarray
) -> dict[str, Any]:
    settled = run.time >= _SETTLED
    error = run.fault_estimate - run.fault
    # A loop that runs away ends in infinities, and its last scores are none.
    with np.errstate(invalid='ignore'):
        score = np.abs(run.fault_estimate) / run.threshold
    angle = joints.absolute_position(run.position)
    cosine = np.abs(np.cos(angle))
    result = {
        'fault_rms_before': _rms(error[before & settled]),
        'fault_rms_during': _rms(error[during]),
        'angle_rms': _rms((angle - joints.absolute_position(run.estimate))[settled]),
    }
    places = np.clip(np.searchsorted(BINS, cosine, side='right') - 1, 0, len(BINS) - 2)
    known = np.isfinite(error) & settled[:, None]
    for i in range(2):
        number = i + 1
        result[f'score_before_{number}'] = _largest(score[before, i])
        result[f'score_during_{number}'] = _largest(score[during, i])
        result[f'mean_threshold_{number}'] = float(run.threshold[settled, i].mean())
        result[f'least_cos_{number}'] = _least(cosine[:, i])
        here = places[known[:, i], i]
        result[f'error_squares_{number}'] = np.bincount(
            here, error[known[:, i], i] ** 2, len(BINS) - 1
        ).tolist()
        result[f'error_counts_{number}'] = (
            np.bincount(here, None, len(BINS) - 1).astype(float).tolist()
        )
    return result


def _tracking_figures(
    plan: Any, run: Any, twin: Any, joints: JointMap, during: np.ndarray
) -> dict[str, Any]:
    error = joints.absolute_position(run.position) - joints.absolute_position(run.reference)
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
        healthy = joints.absolute_position(twin.position) - joints.absolute_position(twin.reference)
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
