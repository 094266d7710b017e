"""The page of a recorded run."""

import math
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from lpv.bag.run.record import RunRecord
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import SensorState, blamed
from lpv.core.support.formatting import bound, decimals, sized
from lpv.core.support.resources import installed_version
from lpv.core.support.timestamps import NANOSECONDS
from lpv.report import figures, history
from lpv.report.history import Episode, Run, listed, starting
from lpv.report.page import Tile, write_page

_CALENDAR = 946684800 * NANOSECONDS
"""Stamps after the year 2000 are dates, others count from the start of something [ns]."""
_PACKAGES = ('lpv', 'numpy', 'numba', 'matplotlib', 'rosbags', 'mcap')
_CAPTIONS = {
    figures.timeline: 'What the diagnosis said of each sensor, and when.',
    figures.path: 'Path of the tip (cf. Fig. 4 of the paper).',
    figures.faults: 'Faults of the physical position sensors and their estimates (cf. Fig. 5). '
    'Grey: a healthy arm stays inside. Red: confirmed alarm. Hatched: not diagnosable.',
    figures.measured: 'Joint positions as measured, with faults, and their references '
    '(cf. Fig. 6).',
    figures.states: 'Joint positions and rates with their estimates (cf. Fig. 7).',
    figures.torques: 'Joint torques (cf. Fig. 8).',
}


def write(run: Run, out: str | Path) -> Path:
    """Write page and pictures of a run into a folder; the page."""
    return write_page(
        Path(out, 'report.html'), Path(__file__).parent, _CAPTIONS, run, content(run),
        number=_number, size=_size, bound=bound,
    )  # fmt: skip


def _number(value: float | None, form: str) -> str:
    return form % value if value is not None and math.isfinite(value) else '-'


def _size(value: float, unit: str, sign: str = '') -> str:
    return _number(value, f'%{sign}.{decimals(unit)}f')


def content(run: Run) -> dict[str, Any]:
    record, arm = run.record, run.arm
    names = record.sensor_names or arm.sensor_names
    shown, rests = listed(run.phases)
    stamps = record.stamps['joint_states']
    versions = (installed_version(name, 'not installed as a package') for name in _PACKAGES)
    begin = time.gmtime(int(stamps[0]) // NANOSECONDS) if stamps[0] >= _CALENDAR else None
    return {
        'run': run,
        'title': run.title,
        'period': f'{np.median(np.diff(stamps)) / 1e6:.3g}' if len(stamps) > 1 else '',
        'begin': time.strftime('%Y-%m-%d %H:%M:%S', begin) if begin else '',
        'verdict': _verdict(run),
        'ran_away': run.motion.fastest > 1.0,
        'tiles': _tiles(run),
        'missed': [(names[m.sensor_index], m) for m in run.missed],
        'phases': shown,
        'rests': rests,
        'have_diagnostics': any(t.endswith('/diagnostics') for t in record.counts),
        'compare': any(row.paper is not None for row in run.table),
        'errors': any(row.is_error for row in run.table),
        'detectable': _detectable(record, arm),
        'versions': [*zip(_PACKAGES, versions), ('Python', platform.python_version())],
        'arm_facts': [
            ('name', arm.name),
            ('SHA-256', arm.sha256()),
            ('joints', ', '.join(arm.joint_names)),
            ('position sensors', ', '.join(arm.sensor_names)),
            ('sample time', f'{1000.0 * arm.sample_time:g} ms'),
        ],
    }


def _detectable(record: RunRecord, arm: SerialArm) -> list[dict[str, Any]]:
    """Threshold plus bound of each sensor while it was diagnosable, and how long it was not."""
    threshold, bound, state = (
        record.get('fault_estimate', name) for name in ('threshold', 'bound', 'state')
    )
    if threshold is None or bound is None or state is None:
        return []
    begun = ~starting(record, record.stamps['fault_estimate'])
    rows = []
    for i, (sensor, unit) in enumerate(zip(arm.sensor_names, arm.position_units)):
        lost = begun & (state[:, i] == SensorState.NOT_DIAGNOSABLE)
        values = (threshold + bound)[~lost, i]
        values = values[np.isfinite(values)] if np.isfinite(values).any() else np.array([np.nan])
        figures = {'smallest': values.min(), 'middle': np.median(values), 'largest': values.max()}
        rows.append({'sensor': sensor, 'unit': unit, **figures, 'lost': float(lost.mean())})
    return rows


def _count(number: int, one: str) -> str:
    return f'{number or "no"} {one if number == 1 else one + "s"}'


def _error(alarm: Episode, arm: SerialArm) -> str:
    sensor = blamed(alarm.sensor, alarm.kind)
    if alarm.kind == 'dropout':
        return f'{sensor} no readings'
    return f'{sensor} {sized(alarm.size, alarm.bound, alarm.unit(arm))}'


def _verdict(run: Run) -> str:
    """The answer in a sentence or two; a run that ran away is called that first."""
    record, arm, move = run.record, run.arm, run.motion
    recorded = 'fault_alarm' in record.topics
    sensors = sorted({alarm.sensor for alarm in run.alarms})
    text = _count(len(run.alarms), 'alarm') if recorded else 'alarms were not recorded'
    parts = [text[0].upper() + text[1:] + (f', of {" and ".join(sensors)}' if sensors else '')]
    if 'ground_truth' in record.streams and recorded:
        wrong = sum(alarm.false_alarm for alarm in run.alarms)
        missed = _count(len(run.missed), 'fault')
        parts.append(f'{_count(wrong, "false alarm")}, {missed} missed')
    lasting = (a for a in run.alarms if a.cleared is None)
    if now := [_error(alarm, arm) for alarm in lasting]:
        parts.append(f'error at the end of the run: {", ".join(now)}')
    if brakes := [phase for phase in run.phases if phase.what == history.BRAKED]:
        reasons = ', '.join(dict.fromkeys(phase.note for phase in brakes))
        parts.append(f'the drives braked {_count(len(brakes), "time")} ({reasons})')
    kinds = [phase.what for phase in run.phases]
    stops = _count(kinds.count(history.SAFE_STOP), 'safe stop')
    odd = _count(kinds.count(history.INCONSISTENT), 'inconsistent phase')
    words = '; '.join([*parts, f'{stops}, {odd}.'])
    if move.fastest <= 1.0:
        return words
    lasted = sum(phase.duration for phase in run.phases if phase.what == history.TOO_FAST)
    return (
        f'The arm exceeded its speed limit for {lasted:.3f} s ({move.joint}: '
        f'{move.speed:.3g} {move.unit} {move.source}, limit {move.limit:g} {move.unit}). {words}'
    )


def _tiles(run: Run) -> list[Tile]:
    record, move, alarms = run.record, run.motion, run.alarms
    active = sum(alarm.cleared is None for alarm in alarms)
    tiles = [Tile('alarms', str(len(alarms)), f'{active} to the end' if active else '')]
    if 'ground_truth' in record.streams:
        for name, number in (
            ('false alarms', sum(alarm.false_alarm for alarm in alarms)),
            ('missed faults', len(run.missed)),
        ):
            tiles.append(Tile(name, str(number), look='bad' if number else 'good'))
        if delays := [alarm.delay for alarm in alarms if alarm.delay is not None]:
            tiles.append(Tile('slowest alarm', f'{max(delays):.3f} s', 'after the fault'))
    if 'torque_command' in record.streams:
        stopped = sum(p.duration for p in run.phases if p.what == history.SAFE_STOP)
        tiles.append(Tile('stopped', f'{stopped:.1f} s', look='warn' if stopped else ''))
    limit = f'limit {move.limit:g}, {move.joint}, {move.source}'
    look = 'bad' if move.fastest > 1.0 else ''
    tiles.append(Tile('fastest joint', f'{move.speed:.3g} {move.unit}', limit, look))
    if move.path_error is not None:
        tiles.append(Tile('farthest from path', f'{move.path_error:.3g} m', 'true tip'))
    proof = run.certificate
    tiles.append(Tile('bounds', 'guaranteed' if proof.bounds_faults else 'statistical'))
    name = f'certificate of the {proof.what}'
    if proof.problem:
        return [*tiles, Tile(name, 'unknown', look='warn')]
    word, look = ('holds', 'good') if proof.holds else ('fails', 'bad')
    return [*tiles, Tile(name, word, f'{len(proof.checks)} checks', look)]
