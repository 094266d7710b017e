"""What two runs of one recording have in common, and where they differ."""

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from lpv.bag.errors import BagError
from lpv.bag.run.record import RunRecord, load_run
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.core.support.errors import LpvError
from lpv.report.history import Episode, episodes
from lpv.report.page import finite
from lpv.report.style import INK, PALE, SENSOR, legend_above, picture, thin
from lpv.report.table import make_table

# Stream, field, what it is called, unit by that of the joint; flags are compared by the share that
# differs.
_SIGNALS = (
    ('state_estimate', 'position', 'position', '{}'),
    ('state_estimate', 'velocity', 'velocity', '{}/s'),
    ('state_estimate', 'compensated_position', 'compensated position', '{}'),
    ('fault_estimate', 'estimate', 'fault estimate', '{}'),
    ('fault_estimate', 'bound', 'bound', '{}'),
    ('fault_estimate', 'threshold', 'threshold', '{}'),
    ('state_estimate', 'mode', 'observer mode', 'share'),
    ('fault_estimate', 'state', 'sensor states', 'share'),
    ('fault_estimate', 'alarm', 'alarm flags', 'share'),
)
_SMALLEST = 1e-7
"""Mean squared errors below are numerical noise: their ratio says nothing."""


@dataclass(frozen=True)
class Tolerances:
    """What still counts as the same; at zero, every bit must agree."""

    mise: float = 0.05  # relative change of a figure of the table
    delay: float = 0.02  # change of the time of an alarm event [s]
    # largest difference of estimates, bounds, thresholds [rad], [rad/s] and confidences
    signal: float = 1e-3
    flags: float = 0.002  # share of samples whose mode, state or alarm differs
    missing: float = 0.0  # share of answers that only one of the runs has


@dataclass(frozen=True)
class Figure:
    """One figure of both runs, or a difference (``second``) against its tolerance (``first``)."""

    name: str  # what is compared
    unit: str  # of both values
    first: float | None  # None where the run has none
    second: float | None
    same: bool  # within the tolerance


@dataclass(frozen=True)
class AlarmPair:
    """An alarm of one run and that of the other which corresponds to it, or None."""

    first: Episode | None
    second: Episode | None
    same: bool
    unit: str  # of sizes

    @property
    def sensor(self) -> str:
        return next(episode.sensor for episode in (self.first, self.second) if episode)


@dataclass
class Comparison:
    """Result."""

    # MISE or, without ground truth, sizes of the fault estimates
    figures: list[Figure] = field(default_factory=list)
    differences: list[Figure] = field(default_factory=list)  # the largest of each signal
    alarms: list[AlarmPair] = field(default_factory=list)  # in the order of time
    common: int = 0  # answers with the same stamp in both runs
    only_first: int = 0  # answers of the first run alone
    only_second: int = 0  # answers of the second run alone
    missing_allowed: float = 0.0  # share of all answers that only one run may have

    @property
    def complete(self) -> bool:
        """Whether the runs have the same answers, as far as is asked for."""
        alone = self.only_first + self.only_second
        return self.common > 0 and alone <= self.missing_allowed * (self.common + alone)

    @property
    def same(self) -> bool:
        """Whether nothing differs beyond the tolerances."""
        parts = [*self.figures, *self.differences]
        alarms = all(pair.same for pair in self.alarms)
        return self.complete and alarms and all(part.same for part in parts)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; what is not a number is None."""
        names, found = ('common', 'only_first', 'only_second', 'complete'), asdict(self)
        for pair, plain in zip(self.alarms, found['alarms']):
            for name, alarm in (('first', pair.first), ('second', pair.second)):
                if alarm is not None:
                    plain[name]['delay'] = alarm.delay
        parts = {name: found[name] for name in ('figures', 'differences', 'alarms')}
        answers = {name: getattr(self, name) for name in names}
        return finite({'same': self.same, 'answers': answers, **parts})


def load_pair(
    bag: str | Path, other: str | Path, arm: SerialArm, topic: str | None = None
) -> tuple[RunRecord, RunRecord]:
    """Two runs of one recording; what one bag does not hold is taken from the other."""
    bags = (bag, other)
    first, second = (load_run(path, topic, arm.joint_names, answers_only=True) for path in bags)
    for one, another in ((first, second), (second, first)):
        for name in ('joint_states', 'ground_truth', 'reference', 'torque_command'):
            if name in one.streams and name not in another.streams:
                another.streams[name], another.stamps[name] = one.streams[name], one.stamps[name]
        another.joint_names = another.joint_names or one.joint_names
    for path, record in ((bag, first), (other, second)):
        if not {'state_estimate', 'fault_estimate'} & set(record.streams):
            raise BagError(f'{path}: holds no answers of the diagnosis; run lpv replay first')
        # Without measurements, times count from the first answer.
        record.stamps.setdefault('joint_states', _answer_stamps(record))
    return first, second


def compare_runs(
    first: RunRecord, second: RunRecord, arm: SerialArm, tolerances: Tolerances | None = None
) -> Comparison:
    """Compare the answers of two runs of one recording; LpvError without a sample in common."""
    tolerances = tolerances or Tolerances()
    stamps = [_answer_stamps(record) for record in (first, second)]
    common = np.intersect1d(stamps[0], stamps[1])
    if not len(common):
        raise LpvError('the bags have no answer with the same stamp: they are not of one recording')
    pairs = _pairs(first, second, arm, tolerances)
    first, second = _restricted(first, common), _restricted(second, common)
    figures = _figures(first, second, arm, tolerances.mise)
    differences = list(_differences(first, second, arm, tolerances))
    one, two = (len(s) - len(common) for s in stamps)
    counts = len(common), one, two
    return Comparison(figures, differences, pairs, *counts, tolerances.missing)


def _answer_stamps(record: RunRecord) -> np.ndarray:
    """Of answers to measurements: an estimate that is repeated in silence, as stale, is none."""
    if 'fault_estimate' not in record.stamps:
        return record.stamps['state_estimate']
    stamps = record.stamps['fault_estimate']
    stale = (record.streams['fault_estimate']['state'] == SensorState.STALE).all(axis=1)
    return stamps[~stale | np.isin(stamps, record.stamps.get('joint_states', stamps))]


def _restricted(record: RunRecord, common: np.ndarray) -> RunRecord:
    """The record with answers at common stamps alone: others must not count for one run only."""
    result = copy(record)
    result.stamps, result.streams = dict(record.stamps), dict(record.streams)
    for stream in {'state_estimate', 'fault_estimate'} & set(record.stamps):
        kept = np.isin(record.stamps[stream], common)
        result.stamps[stream] = record.stamps[stream][kept]
        result.streams[stream] = {k: v[kept] for k, v in record.streams[stream].items()}
    return result


def _figures(first: RunRecord, second: RunRecord, arm: SerialArm, tolerance: float) -> list[Figure]:
    tables = make_table(first, arm), make_table(second, arm)
    one, two = ({(row.signal, row.meaning): row for row in table} for table in tables)
    found = []
    for key, row in {**one, **two}.items():
        a, b = (table[key].value if key in table else None for table in (one, two))
        found.append(Figure(': '.join(key), row.unit, a, b, _close(a, b, tolerance)))
    return found


def _close(first: float | None, second: float | None, tolerance: float) -> bool:
    if first is None or second is None:
        return False
    if first == second or (math.isnan(first) and math.isnan(second)):
        return True
    allowed = max(tolerance * max(abs(first), abs(second)), _SMALLEST) if tolerance else 0.0
    return abs(first - second) <= allowed


def _differences(
    first: RunRecord, second: RunRecord, arm: SerialArm, allowed: Tolerances
) -> Iterator[Figure]:
    for stream, name, label, unit in _SIGNALS:
        if stream not in first.stamps or stream not in second.stamps:
            continue
        _, i, j = np.intersect1d(first.stamps[stream], second.stamps[stream], return_indices=True)
        a, b = first.streams[stream][name][i], second.streams[stream][name][j]
        if unit == 'share':
            differ = (a != b).reshape(len(a), -1).any(axis=1)
            share = float(np.mean(differ)) if len(a) else 0.0
            yield Figure(label, unit, allowed.flags, share, share <= allowed.flags)
            continue
        with np.errstate(invalid='ignore'):
            gap = np.abs(a - b)
        gap[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
        for k, column in enumerate(np.nan_to_num(gap, nan=math.inf).T):
            largest, own = float(column.max(initial=0.0)), unit.format(arm.position_units[k])
            same = largest <= allowed.signal
            yield Figure(f'{label} {k + 1}', own, allowed.signal, largest, same)


def _pairs(
    first: RunRecord, second: RunRecord, arm: SerialArm, allowed: Tolerances
) -> list[AlarmPair]:
    """Alarms of one sensor that are nearest in time belong together."""
    left, pairs = list(episodes(second)), []
    shift = (second.stamps['joint_states'][0] - first.stamps['joint_states'][0]) / 1e9
    for alarm in episodes(first):
        near = [
            other for other in left
            if other.about == alarm.about
            and alarm.raised <= _end(other) + shift + DiagnosisParameters.clear_dwell
            and other.raised + shift <= _end(alarm) + DiagnosisParameters.clear_dwell
        ]  # fmt: skip
        other = min(near, key=lambda o: abs(o.raised + shift - alarm.raised), default=None)
        same = other is not None and alarm.kind == other.kind
        if other is not None:
            left.remove(other)
            times = [(alarm.raised, other.raised), (_end(alarm), _end(other))]
            times.append((alarm.onset, other.onset))
            # Differences of seconds as floats have nanoseconds of rounding.
            gaps = (0.0 if a == b + shift else abs(a - (b + shift)) for a, b in times)
            same &= max(gaps) <= allowed.delay + 1e-9
            same &= abs(alarm.confidence - other.confidence) <= allowed.signal
        pairs.append(AlarmPair(alarm, other, same, alarm.unit(arm)))
    pairs += [AlarmPair(None, other, False, other.unit(arm)) for other in left]
    return sorted(pairs, key=lambda pair: (pair.first or pair.second).raised)  # type: ignore[union-attr]


def _end(episode: Episode) -> float:
    return math.inf if episode.cleared is None else episode.cleared


def draw_comparison(first: RunRecord, second: RunRecord, arm: SerialArm, out: Path) -> None:
    """Write pictures of the fault estimates of both runs, and of how far they are apart."""
    if 'fault_estimate' not in first.streams or 'fault_estimate' not in second.streams:
        return
    times = [first.seconds(record.stamps['fault_estimate']) for record in (first, second)]
    common, i, j = np.intersect1d(*times, return_indices=True)
    one, two = (record.streams['fault_estimate'] for record in (first, second))
    truth = first.get('ground_truth', 'fault')

    def curves(name: str, k: int) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
        if name == 'differences':
            for what, color in (('estimate', SENSOR[k]), ('threshold', PALE[k])):
                gap = two[what][j, k] - one[what][i, k]
                yield common, gap, {'color': color, 'label': f'{what}, second - first'}
            return
        yield times[0], one['estimate'][:, k], {'color': PALE[k], 'lw': 3.4, 'label': 'first'}
        yield times[1], two['estimate'][:, k], {'color': SENSOR[k], 'lw': 1.1, 'label': 'second'}
        if truth is not None:
            at = first.seconds(first.stamps['ground_truth'])
            yield at, truth[:, k], {'color': INK, 'lw': 0.9, 'ls': '--', 'label': 'fault'}

    def draw(name: str, label: str) -> plt.Figure:
        count = len(arm.sensor_names)
        figure, axes = plt.subplots(count, sharex=True, squeeze=False, figsize=(8.6, 2.6 * count))
        for k, axis in enumerate(axes[:, 0]):
            for at, values, look in curves(name, k):
                axis.plot(*thin(at, values), **look)
            unit = arm.position_units[k]
            axis.set(title=f'Sensor {k + 1}: {arm.sensor_names[k]}', ylabel=f'{label} [{unit}]')
            legend_above(axis)
        axes[-1, 0].set_xlabel('time [s]')
        return figure

    for name, label in (('faults', 'fault'), ('differences', 'difference')):
        (out / f'{name}.png').write_bytes(picture(draw, name, label))
