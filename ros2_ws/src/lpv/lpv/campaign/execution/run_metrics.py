"""What is kept of one run: figures of detection, isolation, estimates, tracking.

Columns of ``runs.parquet`` beside the factors of a run; NaN: there is nothing to measure.  ``_i``
counts sensors from 1, "during" is from the first onset of a fault to the last end, "before" what
precedes it; units are s and rad.

number, seed
    Of the run.
kind, sensor, fault_size
    What was injected: its kind; its sensor, ``both`` of two, else ``a+b``; its size, of a drift its
    rate.
observed, early_time, healthy_time
    Length of the run; time before the first onset; time without a fault.
detected, isolated, found_i
    Every faulty sensor has an alarm while a fault acts; no other has; this one has.
detection_delay, onset_error
    Of the sensor found last; error of the stated onset.
size_at_detection, size_error
    By the first alarm; its error, of biases.
said_kind, said_sensor
    Last word of the diagnosis.
alarms, false_alarms, alarms_before_i, wrong_alarms
    All; while no fault acted; before any; of healthy sensors during one.  An alarm that began
    before the end of its fault counts for it for 1 s more; that of a reading that jumps back then
    is not false.
score_before_i, score_during_i, mean_threshold_i
    Largest abs(estimate) / threshold; mean threshold after 1 s.
fault_rms_before, fault_rms_during, error_rms_i
    RMS errors of the fault estimates; the first second counts in the second one alone.
angle_rms
    RMS error of the estimated positions after 1 s.
tracking_rms, tracking_rms_during, tracking_max, tracking_ratio
    Tracking error: RMS after 1 s and during faults; largest; over that of the healthy twin.
stable
    All is finite, and the tracking error below 1 rad.
safe_stops, stop_reasons, braked_time
    How often the drives braked, why, and for how long.
inconsistent_time
    Time with suspects.
"""

import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from lpv.campaign.plan.spec import BOTH, NO_FAULT
from lpv.core.control.path_follower import APPROACH
from lpv.core.control.watchdog import TrackerLimits
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv.core.simulation.faults import Fault, tells_of

DIVERGED = 2.0 * TrackerLimits.tracking_error
"""True tracking error that counts as lost control: the tracker should have stopped [rad]."""
_EARLY = 0.1
"""An onset estimate may be so much earlier than the fault [s]."""


def figures(arm: SerialArm, scenario: Any, run: Any, twin: Any = None) -> dict[str, Any]:
    """Columns of a run and its healthy twin, as above."""
    names, period = arm.sensor_names, arm.sample_time
    observed = len(run.time) * period
    scheduled = [f for f in scenario.faults if f.onset < observed]  # others were not injected
    begin = min((f.onset for f in scheduled), default=math.inf)  # of the first one to the last end
    end = max((f.end for f in scheduled), default=math.inf)
    before, during = run.time < begin, (run.time >= begin) & (run.time < end)
    sizes = {abs(f.rate if f.kind == 'drift' else f.size) for f in scheduled}
    result = {
        'seed': scenario.seed,
        'kind': scheduled[0].kind if scheduled else NO_FAULT,
        'sensor': _named({f.sensor for f in scheduled}, names),
        'fault_size': sizes.pop() or math.nan if len(sizes) == 1 else math.nan,
        'observed': observed,
        'early_time': float(before.sum() * period),
        'healthy_time': float((~during).sum() * period),
    }
    result.update(_alarm_figures(run, scheduled, names, begin, end))
    result.update(_estimate_figures(run, before, during))
    result.update(_tracking_figures(run, twin, during, period))
    return result


def _named(sensors: Collection[str], names: Sequence[str]) -> str:
    """Sensors as one text: a name, both of two, names joined by +."""
    if len(sensors) == len(names) == 2:
        return BOTH
    return '+'.join(name for name in names if name in sensors) or NO_FAULT


def _alarm_figures(
    run: Any, faults: Sequence[Fault], names: Sequence[str], begin: float, end: float
) -> dict[str, Any]:
    """Alarms while a fault acts count for it; all others are false."""
    raised = [a for a in run.alarms if a.event == AlarmEvent.RAISED]
    # The first one of each sensor: an alarm before it is none of it.
    faulty = {f.sensor: f for f in sorted(faults, key=lambda f: -f.onset)}
    onsets = {sensor: fault.onset for sensor, fault in faulty.items()}

    def told(alarm: Any) -> bool | None:
        if alarm.sensor not in onsets:
            return False
        times = alarm.onset / 1e9, alarm.detected / 1e9
        return tells_of(onsets[alarm.sensor], end, *times, alarm.kind)

    own: dict[str, list[Any]] = {}  # alarms that count for each faulty sensor
    for alarm in run.alarms:
        if alarm.event == AlarmEvent.CLEARED or not told(alarm):
            continue
        if alarm.onset / 1e9 >= onsets[alarm.sensor] - _EARLY:
            own.setdefault(alarm.sensor, []).append(alarm)
    inside = [a for a in raised if begin <= a.detected / 1e9 < end or told(a)]
    outside = [a for a in raised if a not in inside and told(a) is not None]
    wrong = [a for a in inside if a.detected / 1e9 < onsets.get(a.sensor, math.inf)]
    said, nan = {a.sensor for a in inside}, math.nan
    found = bool(own) and set(own) == set(faulty)
    pairs = [(own[sensor][0], f) for sensor, f in faulty.items()] if found else []
    biased = all(f.kind == 'bias' for f in faults)
    last = [alarms[-1] for alarms in own.values()] or inside
    early = [a.sensor for a in raised if a.detected / 1e9 < begin]
    each = {}
    for i, name in enumerate(names, start=1):
        each[f'alarms_before_{i}'], each[f'found_{i}'] = early.count(name), name in own
    return {
        **each,
        'alarms': len(raised),
        'false_alarms': len(outside),
        'wrong_alarms': len(wrong),
        'detected': found,
        'isolated': found and said == set(faulty) and not wrong,
        'said_sensor': _named(said, names),
        'said_kind': last[-1].kind if last else NO_FAULT,
        'detection_delay': max((a.detected / 1e9 - f.onset for a, f in pairs), default=nan),
        'onset_error': max((abs(a.onset / 1e9 - f.onset) for a, f in pairs), default=nan),
        'size_at_detection': max((abs(a.size) for a, _ in pairs), default=nan),
        'size_error': max((abs(a.size - f.size) for a, f in pairs if biased), default=nan),
    }


def _estimate_figures(run: Any, before: np.ndarray, during: np.ndarray) -> dict[str, Any]:
    settled = run.time >= APPROACH
    error = run.fault_estimate - run.fault
    # A loop that runs away ends in infinities, and its last scores are none.
    with np.errstate(invalid='ignore'):
        score = np.abs(run.fault_estimate) / run.threshold
    result = {
        'fault_rms_before': _rms(error[before & settled]),
        'fault_rms_during': _rms(error[during]),
        'angle_rms': _rms((run.position - run.estimate)[settled]),
    }
    for i in range(error.shape[1]):
        number = i + 1
        result[f'score_before_{number}'] = _largest(score[before, i])
        result[f'score_during_{number}'] = _largest(score[during, i])
        result[f'mean_threshold_{number}'] = _mean(run.threshold[settled, i])
        result[f'error_rms_{number}'] = _rms(error[settled, i])
    return result


def _tracking_figures(run: Any, twin: Any, during: np.ndarray, period: float) -> dict[str, Any]:
    error = run.position - run.reference
    largest = float(np.abs(error).max())
    finite = bool(np.isfinite(run.position).all() and np.isfinite(run.torque).all())
    braked = run.braked
    result = {
        'tracking_rms': _rms(error[run.time >= APPROACH]),
        'tracking_rms_during': _rms(error[during]),
        'tracking_max': largest,
        'tracking_ratio': math.nan,
        'stable': finite and largest < DIVERGED,
        'safe_stops': int(np.count_nonzero(braked[1:] & ~braked[:-1])),
        'braked_time': float(braked.sum() * period),
        'inconsistent_time': float(run.inconsistent.sum() * period),
    }
    if twin is not None and during.any():
        healthy = twin.position - twin.reference
        result['tracking_ratio'] = result['tracking_rms_during'] / _rms(healthy[during])
    return result


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else math.nan


def _rms(values: np.ndarray) -> float:
    return math.sqrt(_mean(values[np.isfinite(values)] ** 2))


def _largest(values: np.ndarray) -> float:
    values = values[~np.isnan(values)]
    return float(values.max()) if values.size else math.nan
