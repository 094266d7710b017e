"""An archive of bags as a campaign: which bags there are, and one row of figures each."""

import contextlib
import hashlib
import json
import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lpv.bag.replay.replay import Replay, ReplayOptions, ReplayResult
from lpv.bag.rosbag.metadata import FILE_NAME, read_metadata
from lpv.bag.run.record import alarms_of, load_run
from lpv.campaign.execution.run_metrics import figures
from lpv.campaign.plan.campaign import software
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import parse_arm, to_mapping
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, SensorState
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.config import sha256_of
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.limits import MAX_GAP, MOST_SAMPLES, MOST_TEXT
from lpv.core.support.timestamps import NANOSECONDS
from lpv.core.uio.certificate.gains import Gains

_STORAGE = ('.mcap', '.db3', '.bag')
"""Files of bags; the last are of ROS 1, and an error says how to convert them."""
_UNIT = ('serial', 'unit')
"""Keys of a bag's custom data that name the arm, as ``ros2 bag record --custom-data`` sets them."""
STATES = tuple(state.name.lower() for state in SensorState)
"""Names of the states of a sensor, in the order of their numbers."""
_DIAGNOSED = (int(SensorState.OK), int(SensorState.WARN), int(SensorState.ERROR))
_STALE = int(SensorState.STALE)


def archive_text(
    root: str | Path,
    arm: SerialArm,
    gains: Gains | None,
    diagnosis: DiagnosisParameters | None = None,
    options: ReplayOptions | None = None,
    **sampling: Any,
) -> str:
    """Text of an `Archive`; ``sampling`` as of `SerialSensorMonitor`."""
    content = {
        'root': str(Path(root).resolve()),
        'arm': to_mapping(arm),
        'gains': gains and gains.mapping(),
        'diagnosis': asdict(diagnosis or DiagnosisParameters()),
        'options': asdict(options or ReplayOptions()),
        'sampling': sampling,
        'software': software(),
    }
    return json.dumps(content, sort_keys=True)


class Archive:
    """Bags of one arm below ``root``, observed with the same settings; from `archive_text`."""

    def __init__(self, text: str) -> None:
        self.text, data = text, json.loads(text)
        self.root, self.arm = Path(data['root']), parse_arm(data['arm'])
        self.software: str = data.get('software', 'unknown')
        self._gains = data['gains'] and Gains.parse(data['gains'])
        self._diagnosis = DiagnosisParameters(**data['diagnosis'])
        self._options, self._sampling = ReplayOptions(**data['options']), data['sampling']

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the bags and the software."""
        data = json.loads(self.text)
        return sha256_of({name: data[name] for name in data if name not in ('root', 'software')})

    def monitor(self) -> SerialSensorMonitor:
        return SerialSensorMonitor('/uio', self.arm, self._diagnosis, self._gains, **self._sampling)

    def row(self, name: str) -> dict[str, Any]:
        """Replay a bag and measure it; ``error`` says why it could not be read."""
        path = self.root / name
        row = {'bag': name, 'unit': '', 'error': ''}
        try:
            row['unit'] = unit_of(self.root, name)
            row.update(self._figures(path))
        except LpvError as error:
            row['error'] = _line(str(error).replace(f'{path}: ', ''))
        except Exception as error:  # one bag must not end all others
            row['error'] = _line(f'{type(error).__name__}: {error}')
        return row

    def _figures(self, path: Path) -> dict[str, Any]:
        monitor = self.monitor()
        found = BagFigures(self.arm, self._sampling.get('max_gap', MAX_GAP))
        with _quiet():
            result = Replay(monitor, self._options).watch(path, found.take)
            row = found.row(path, result)
        notes = [text for _, text in result.notes]
        return {
            'topic': result.topic,
            'measurements': result.measurements,
            'rejected': sum(result.rejected.values()),
            'recorder_lost': result.lost,
            **vars(monitor.counters),
            'warnings': _line('; '.join([*found.warnings, *notes, *result.warnings])),
            'has_truth': 'ground_truth' in result.streams,
            'has_reference': 'reference' in result.streams,
            **row,
        }


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
        """Count a block, as `Replay.watch` hands it on."""
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
            known = (fault.state != _STALE) & (fault.threshold > 0.0)
            score = np.zeros_like(fault.estimate)
            np.divide(np.abs(fault.estimate), fault.threshold, out=score, where=known)
            self._score = np.maximum(self._score, score.max(axis=0))
            diagnosed = np.isin(fault.state, _DIAGNOSED)
            known = fault.estimate, fault.threshold
            sure, threshold = (np.where(diagnosed, values, 0.0) for values in known)
            self._largest = np.maximum(self._largest, np.abs(sure).max(axis=0))
            self._sums += [part.sum(axis=0) for part in (diagnosed, sure, sure**2, threshold)]
        self._samples += len(rows)
        if self._samples > MOST_SAMPLES:
            self._answers.clear()
            return
        kept = {'stamp': stamps[rows], 'inconsistent': answers.inconsistent[rows]}
        kept |= {'estimate': state.position, 'fault_estimate': fault.estimate}
        kept['threshold'] = fault.threshold
        self._answers.append({name: np.array(values) for name, values in kept.items()})

    def _add_time(self, table: np.ndarray, time: np.ndarray) -> None:
        time = np.clip(time, 0.0, self._max_gap)
        self._doubtful += time @ table[:, 1:3]
        for i, states in enumerate(table.T[3:]):
            self._state_time[:, i] += np.bincount(states, time, len(STATES))

    def row(self, bag: Path, result: ReplayResult) -> dict[str, Any]:
        """Figures of the bag, by column; None where there is nothing to be measured."""
        self._add_time(self._pending, np.full(len(self._pending), self._arm.sample_time))
        self._pending = self._pending[:0]
        start, end = self._stamps or (0, 0)
        counts = np.where(self._sums[0] > 0, self._sums[0], np.nan)
        mean, square, threshold = self._sums[1:] / counts
        row: dict[str, Any] = self._against_truth(bag, result)
        raised = [event.sensor for event in result.events if event.event == AlarmEvent.RAISED]
        row.update(
            start=start,
            duration=(end - start) / NANOSECONDS,
            observed=float(self._state_time[:, 0].sum()),
            inconsistent_time=float(self._doubtful[0]),
            untrusted_time=float(self._doubtful[1]),
            alarms=len(raised),
            alarm_list=alarm_rows(result.events, start),
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

    def _against_truth(self, bag: Path, result: ReplayResult) -> dict[str, Any]:
        """What `figures` finds of a run, where the truth is there."""
        if 'ground_truth' not in result.streams or not self._samples:
            return {}
        if self._samples > MOST_SAMPLES:
            self.warnings = ['too long to be compared with its ground truth']
            return {}
        record = load_run(bag, result.topic, self._arm.joint_names, answers_only=True)
        stamps = record.stamps.get('ground_truth', np.zeros(0, np.int64))
        seen = (stamps >= self._stamps[0]) & (stamps <= self._stamps[1])
        if not seen.any():  # its topic alone is there, or other times are replayed
            return {}
        truth = {name: values[seen] for name, values in record.streams['ground_truth'].items()}
        stamps = stamps[seen]
        names = self._answers[0]
        answers = {name: np.concatenate([p[name] for p in self._answers]) for name in names}
        # Of several answers with one stamp the last one counts.
        known, last = np.unique(answers.pop('stamp')[::-1], return_index=True)
        answers = {name: values[::-1][last] for name, values in answers.items()}
        held = {name: _held(known, values, stamps, 0) for name, values in answers.items()}
        run = SimpleNamespace(time=(stamps - stamps[0]) / NANOSECONDS, **truth, **held)
        run.braked, run.reference = np.zeros(len(stamps), bool), np.full_like(run.position, np.nan)
        if (stop := record.get('torque_command', 'safe_stop')) is not None:
            # Before the first command the drives brake.
            run.braked = _held(record.stamps['torque_command'], stop, stamps, 1) != 0
        if (reference := record.get('reference', 'position')) is not None:
            run.reference = _held(record.stamps['reference'], reference, stamps)
        start = int(stamps[0])
        run.alarms = [
            replace(event, onset=event.onset - start, detected=event.detected - start)
            for event in result.events
        ]
        scenario, arm = self._scenario(run, bag / 'scenario.yaml'), self._arm
        if len(stamps) > 1:  # recorded at any rate
            arm = replace(arm, sample_time=float(np.median(np.diff(stamps))) / NANOSECONDS)
        with np.errstate(invalid='ignore', divide='ignore'):
            found = figures(arm, scenario, run)
        if reference is None:
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
    known: np.ndarray, values: np.ndarray, stamps: np.ndarray, before: int | None = None
) -> np.ndarray:
    """Values held at other stamps; what is ``before`` the first one, itself if not given."""
    last = np.searchsorted(known, stamps, side='right') - 1
    held = values[np.maximum(last, 0)]
    if before is not None:
        held[last < 0] = before
    return held


def alarm_rows(events: Sequence[Alarm], start: int) -> list[dict[str, Any]]:
    """Alarms by sensor and last said kind: number, and onset [s], size [rad] of the first."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for first, *others in alarms_of(events):
        if first.event == AlarmEvent.RAISED:
            key = {'sensor': first.sensor, 'kind': (others or [first])[-1].kind}
            times = {n: (getattr(first, n) - start) / NANOSECONDS for n in ('onset', 'detected')}
            new = {**times, 'size': float(first.size), 'bound': float(first.bound), 'count': 0}
            rows.setdefault(tuple(key.values()), {**key, **new})['count'] += 1
    return list(rows.values())


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the log of what is wrong with a bag, which is in its row."""
    logger = logging.getLogger('lpv.bag')
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _line(text: str) -> str:
    text = ' '.join(text.split())
    return text if len(text) <= MOST_TEXT else text[: MOST_TEXT - 3] + '...'


def find_bags(root: str | Path, leave_out: Sequence[Path] = ()) -> dict[str, list[str]]:
    """All bags below a folder, as chunks of a campaign: relative path by a hash of its files."""
    root = Path(root)
    if not root.is_dir():
        raise ConfigError('DIR', 'is not a folder', str(root))
    skipped, found = {Path(path).resolve() for path in leave_out}, {}
    for name, folders, files in os.walk(root):
        folder = Path(name)
        shown = (name for name in folders if not name.startswith('.'))
        folders[:] = [name for name in shown if (folder / name).resolve() not in skipped]
        for path, parts in _bags_in(folder, sorted(files)):
            bag = path.relative_to(root).as_posix()
            found[bag] = _fingerprint(bag, parts)
    return {found[name]: [name] for name in sorted(found)}


def _bags_in(folder: Path, files: list[str]) -> list[tuple[Path, list[Path]]]:
    """Bags of one folder, each with the files that make it."""
    # An unfinished recording leaves MCAP files with the folder's name, and no metadata.
    storage = [folder / name for name in files if Path(name).suffix in _STORAGE]
    named = FILE_NAME in files and bool(storage)
    if FILE_NAME in files and not storage:  # that of a bag, whose files are then missing?
        with contextlib.suppress(OSError), open(folder / FILE_NAME, 'rb') as file:
            named = b'rosbag2_bagfile_information' in file.read(4096)
    if named:
        return [(folder, [folder / FILE_NAME, *storage])]
    mcap = [path for path in storage if path.suffix == '.mcap']
    own = [p for p in mcap if folder.name in (p.stem, p.stem.rstrip('0123456789').rstrip('_'))]
    if not own and _is_split(storage):  # and its folder was renamed
        own = storage
    return [(folder, own)] * bool(own) + [(path, [path]) for path in storage if path not in own]


def _is_split(files: Sequence[Path]) -> bool:
    """Whether files are numbered as rosbag2 numbers those of one bag: from NAME_0 on."""
    name, suffix = files[0].stem.rpartition('_')[0] if files else '', {one.suffix for one in files}
    numbered = {f'{name}_{k}' for k in range(len(files))}
    return len(files) > 1 == len(suffix) and numbered == {one.stem for one in files}


def _fingerprint(name: str, paths: Iterable[Path]) -> str:
    found = hashlib.sha256(f'{name}\n'.encode(errors='surrogateescape'))
    for path in paths:
        try:
            status = path.stat()
            text = f'{path.name} {status.st_size} {status.st_mtime_ns}\n'
        except OSError as error:
            text = f'{path.name} {error.errno}\n'
        found.update(text.encode(errors='surrogateescape'))
    return found.hexdigest()[:24]


def unit_of(root: Path, name: str) -> str:
    """Which arm a bag is of: ``serial`` or ``unit`` of its custom data, or its first folder."""
    with contextlib.suppress(LpvError, OSError):
        custom = read_metadata(root / name).custom
        if said := next(filter(None, map(custom.get, _UNIT)), ''):
            return said[:200]
    parts = Path(name).parts
    return parts[0] if len(parts) > 1 else ''
