"""Figures of one bag: sums over the answers while it is replayed, and those against its truth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lpv.bag.replay.replay import ReplayResult
from lpv.bag.run.record import load_run
from lpv.campaign.execution.run_metrics import figures
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, SensorState, subject
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import MOST_SAMPLES
from lpv.core.support.timestamps import NANOSECONDS

STATES = tuple(state.name.lower() for state in SensorState)
"""Names of the states of a sensor, in the order of their numbers."""
_DIAGNOSED = (int(SensorState.OK), int(SensorState.WARN), int(SensorState.ERROR))
_STALE = int(SensorState.STALE)


class BagFigures:
    """Sums over a bag's answers; a sample counts until the next one, at most ``max_gap`` [s]."""

    def __init__(self, arm: Any, max_gap: float) -> None:
        self._arm, self._max_gap, self.warnings = arm, max_gap, list[str]()
        n = len(arm.sensor_names)
        self._state_time, self._doubtful = np.zeros((len(STATES), n)), np.zeros(2)
        self._score, self._largest, self._sums = np.zeros(n), np.zeros(n), np.zeros((4, n))
        self._pending = np.zeros((0, 3 + n), np.int64)  # stamp, doubts and states of the last one
        self._stamps: list[int] = []
        self._answers: list[dict[str, np.ndarray]] = []
        self._samples = 0

    def take(self, measured: Any, answers: Any) -> None:
        """Count a block, as `lpv.bag.replay.replay.Replay.watch` hands it on."""
        stamps = measured.stamp
        if len(stamps):
            self._stamps += [int(stamps.min()), int(stamps.max())]
            self._stamps = [min(self._stamps), max(self._stamps)]
        rows = np.flatnonzero(answers.answered)
        state = np.where(answers.has_fault[rows, None], answers.fault.state[rows], _STALE)
        doubtful = [answers.inconsistent[rows], ~answers.state.trustworthy[rows]]
        table = np.column_stack([stamps[rows], *doubtful, state]).astype(np.int64)
        table = np.vstack([self._pending, table])
        self._add_time(table[:-1], np.diff(table[:, 0]) / NANOSECONDS)
        self._pending = table[-1:]
        rows = np.flatnonzero(answers.answered & answers.has_fault)
        fault, state = answers.fault[rows], answers.state[rows]
        if len(rows):
            self._add_faults(fault.estimate, fault.threshold, fault.state)
        self._samples += len(rows)
        if self._samples > MOST_SAMPLES:
            self._answers.clear()
            return
        kept = {
            **{'stamp': stamps[rows], 'inconsistent': answers.inconsistent[rows]},
            **{'estimate': state.position, 'estimated_velocity': state.velocity},
            **{'fault_estimate': fault.estimate, 'threshold': fault.threshold},
        }
        self._answers.append({name: np.array(values) for name, values in kept.items()})

    def _add_time(self, table: np.ndarray, time: np.ndarray) -> None:
        time = np.clip(time, 0.0, self._max_gap)
        self._doubtful += time @ table[:, 1:3]
        for i, states in enumerate(table.T[3:]):
            self._state_time[:, i] += np.bincount(states, time, len(STATES))

    def _add_faults(self, estimate: np.ndarray, threshold: np.ndarray, state: np.ndarray) -> None:
        known = (state != _STALE) & (threshold > 0.0)
        score = np.divide(np.abs(estimate), threshold, out=np.zeros_like(estimate), where=known)
        self._score = np.maximum(self._score, score.max(axis=0))
        diagnosed = np.isin(state, _DIAGNOSED)
        sure = np.where(diagnosed, estimate, 0.0)
        self._largest = np.maximum(self._largest, np.abs(sure).max(axis=0))
        parts = (diagnosed, sure, sure**2, np.where(diagnosed, threshold, 0.0))
        self._sums += [part.sum(axis=0) for part in parts]

    def row(self, events: Sequence[Alarm], bag: Path, result: ReplayResult) -> dict[str, Any]:
        """Figures of the bag, by column; None where there is nothing to be measured."""
        self._add_time(self._pending, np.full(len(self._pending), self._arm.sample_time))
        self._pending = self._pending[:0]
        start, end = self._stamps or (0, 0)
        mean, square, threshold = self._sums[1:] / np.where(
            self._sums[0] > 0, self._sums[0], np.nan
        )
        row: dict[str, Any] = self._against_truth(events, bag, result)
        raised = [event.sensor for event in events if event.event == AlarmEvent.RAISED]
        row.update(
            start=start,
            duration=(end - start) / NANOSECONDS,
            observed=float(self._state_time[:, 0].sum()),
            inconsistent_time=float(self._doubtful[0]),
            untrusted_time=float(self._doubtful[1]),
            alarms=len(raised),
            alarm_list=alarm_rows(events, start),
        )
        columns = {f'time_{name}': times for name, times in zip(STATES, self._state_time)}
        columns |= {'score': self._score, 'fault_largest': self._largest, 'fault_mean': mean}
        columns |= {'fault_rms': np.sqrt(square), 'threshold_mean': threshold}
        for i, sensor in enumerate(self._arm.sensor_names):
            for name, values in columns.items():
                finite = np.isfinite(values[i])
                row[f'{name}_{i + 1}'] = float(values[i]) if finite else None
            row[f'alarms_{i + 1}'] = raised.count(sensor)
        return row

    def _against_truth(
        self, events: Sequence[Alarm], bag: Path, result: ReplayResult
    ) -> dict[str, Any]:
        """What `figures` finds of a run, where the truth is there."""
        if 'ground_truth' not in result.streams or not self._samples:
            return {}
        if self._samples > MOST_SAMPLES:
            self.warnings = ['too long to be compared with its ground truth']
            return {}
        record = load_run(bag, result.topic, self._arm.joint_names, answers_only=True)
        stamps = record.stamps['ground_truth']
        seen = (stamps >= self._stamps[0]) & (stamps <= self._stamps[1])
        truth = {name: values[seen] for name, values in record.streams['ground_truth'].items()}
        stamps = stamps[seen]
        answers = {
            name: np.concatenate([p[name] for p in self._answers]) for name in self._answers[0]
        }
        # Of several answers with one stamp the last one counts.
        known, last = np.unique(answers.pop('stamp')[::-1], return_index=True)
        answers = {name: values[::-1][last] for name, values in answers.items()}
        run = SimpleNamespace(
            time=(stamps - stamps[0]) / NANOSECONDS, **truth, **_held(known, answers, stamps)
        )
        held = {
            name: _held(record.stamps[name], record.streams[name], stamps)
            for name in {'reference', 'torque_command'} & set(record.streams)
        }
        unknown = {'position': np.full_like(run.position, np.nan)}
        run.reference = held.get('reference', unknown)['position']
        stop = held.get('torque_command', {}).get('safe_stop', np.zeros(len(stamps)))
        run.braked = stop.astype(bool)
        start = int(stamps[0])
        run.alarms = [
            replace(event, onset=event.onset - start, detected=event.detected - start)
            for event in events
        ]
        scenario = self._scenario(run, bag / 'scenario.yaml')
        with np.errstate(invalid='ignore', divide='ignore'):
            found = figures(self._arm, scenario, run)
        if 'reference' not in held:
            found['stable'] = None
        return found

    def _scenario(self, run: Any, file: Path) -> Any:
        """The scenario in the bag, or one of faults ``unknown`` by the truth."""
        names = self._arm.sensor_names
        try:
            stored = load_scenario(file)
            if {fault.sensor for fault in stored.faults} <= set(names):
                return stored
        except (LpvError, OSError):
            pass
        faults = []
        for i, sensor in enumerate(names):
            rows = np.flatnonzero(run.fault[:, i] != 0.0)  # a dropout is NaN, which is not zero
            if len(rows):
                onset, last = float(run.time[rows[0]]), rows[-1] == len(run.time) - 1
                length = 0.0 if last else float(run.time[rows[-1] + 1]) - onset
                size = float(np.nan_to_num(np.abs(run.fault[rows, i])).max())
                faults.append(Fault(sensor, 'unknown', onset, length, size))
        return SimpleNamespace(faults=faults, seed=-1)


def _held(
    known: np.ndarray, table: dict[str, np.ndarray], stamps: np.ndarray
) -> dict[str, np.ndarray]:
    """Values held at other stamps; before the first, the drives brake, all else is zero."""
    last = np.searchsorted(known, stamps, side='right') - 1
    held = {name: array[np.maximum(last, 0)] for name, array in table.items()}
    for name, values in held.items():
        if name == 'safe_stop' or 'threshold' in held:
            values[last < 0] = name == 'safe_stop'
    return held


def alarm_rows(events: Sequence[Alarm], start: int) -> list[dict[str, Any]]:
    """Alarms by sensor and last said kind: number, and onset [s], size [rad] of the first."""
    raised: list[tuple[Alarm, str]] = []
    for event in events:
        if event.event == AlarmEvent.RAISED:
            raised.append((event, event.kind))
            continue
        same = event.sensor, subject(event.kind)
        own = [k for k, (one, kind) in enumerate(raised) if (one.sensor, subject(kind)) == same]
        if own:
            raised[own[-1]] = raised[own[-1]][0], event.kind
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for first, kind in raised:
        found = {
            name: (getattr(first, name) - start) / NANOSECONDS for name in ('onset', 'detected')
        }
        new = {**found, 'size': float(first.size), 'bound': float(first.bound), 'count': 0}
        rows.setdefault((first.sensor, kind), {'sensor': first.sensor, 'kind': kind, **new})
        rows[first.sensor, kind]['count'] += 1
    return list(rows.values())
