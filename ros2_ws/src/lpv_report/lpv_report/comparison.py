"""What two runs of one recording have in common, and where they differ."""

import math
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from lpv_bag.run.streams import RunRecord
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.support.errors import LpvError
from lpv_report.history.episodes import Episode, episodes
from lpv_report.run.table import make_table

SIGNALS = {
    'state_estimate': ('position', 'velocity', 'compensated_position'),
    'fault_estimate': ('estimate', 'bound', 'threshold'),
}
"""Vectors of answers that are compared sample by sample."""
_FLAGS = {'state_estimate': ('mode',), 'fault_estimate': ('state', 'alarm')}
_LABELS = {
    'compensated_position': 'compensated position',
    'estimate': 'fault estimate',
    'mode': 'observer mode',
    'state': 'sensor states',
    'alarm': 'alarm flags',
}
_SMALLEST = 1e-7
"""Mean squared errors below are numerical noise: their ratio says nothing."""


@dataclass(frozen=True)
class Tolerances:
    """What still counts as the same; at zero, every bit must agree."""

    mise: float = 0.05  # relative change of a figure of the table
    delay: float = 0.02  # change of the time of an alarm event [s]
    signal: float = 1e-3  # largest difference of estimates, bounds and thresholds [rad], [rad/s]
    flags: float = 0.002  # share of samples whose mode, state or alarm differs
    missing: float = 0.0  # share of answers that only one of the runs has

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0.0 <= value < math.inf:
                raise LpvError(f'tolerance of {name}: must be a number from 0, got {value}')


@dataclass(frozen=True)
class Figure:
    """One figure of both runs."""

    name: str  # what is compared
    unit: str  # of both values
    first: float | None  # value of the first run; None where it has none
    second: float | None  # value of the second run, likewise
    same: bool  # within the tolerance


@dataclass(frozen=True)
class AlarmPair:
    """An alarm of one run and that of the other which corresponds to it, or None."""

    first: Episode | None
    second: Episode | None
    same: bool


@dataclass
class Comparison:
    """Result."""

    # MISE or, without ground truth, sizes of the fault estimates
    figures: list[Figure] = field(default_factory=list)
    # by signal the largest difference (``second``) against its tolerance (``first``)
    differences: list[Figure] = field(default_factory=list)
    alarms: list[AlarmPair] = field(default_factory=list)  # in the order of time
    common: int = 0  # answers with the same stamp in both runs
    only_first: int = 0  # answers of the first run alone
    only_second: int = 0  # answers of the second run alone
    missing_allowed: float = 0.0  # share of all answers that only one run may have

    @property
    def complete(self) -> bool:
        """Whether the runs have the same answers, as far as is asked for."""
        total = self.common + self.only_first + self.only_second
        return self.common > 0 and (
            self.only_first + self.only_second <= self.missing_allowed * total
        )

    @property
    def same(self) -> bool:
        """Whether nothing differs beyond the tolerances."""
        parts = (*self.figures, *self.differences)
        return (
            self.complete and all(part.same for part in parts) and all(a.same for a in self.alarms)
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; what is not a number is None."""

        def plain(value: Any) -> Any:
            if isinstance(value, dict):
                return {k: plain(v) for k, v in value.items()}
            if isinstance(value, list):
                return [plain(v) for v in value]
            return None if isinstance(value, float) and not math.isfinite(value) else value

        return plain(
            {
                'same': self.same,
                'answers': {
                    'common': self.common,
                    'only_first': self.only_first,
                    'only_second': self.only_second,
                    'complete': self.complete,
                },
                'figures': [asdict(f) for f in self.figures],
                'differences': [asdict(f) for f in self.differences],
                'alarms': [
                    {'same': p.same, 'first': _alarm(p.first), 'second': _alarm(p.second)}
                    for p in self.alarms
                ],
            }
        )


def _alarm(episode: Episode | None) -> dict[str, Any] | None:
    return None if episode is None else {**asdict(episode), 'delay': episode.delay}


def compare_runs(
    first: RunRecord, second: RunRecord, arm: Arm, tolerances: Tolerances | None = None
) -> Comparison:
    """Compare the answers of two runs of one recording.

    Parameters
    ----------
    first, second : RunRecord
        The runs.
    arm : ArmParameters or SerialArm
        Their arm.
    tolerances : Tolerances, optional
        What still counts as the same.

    Returns
    -------
    Comparison
        What was found.

    Raises
    ------
    LpvError
        If the answers have no sample in common.
    """
    tolerances = tolerances or Tolerances()
    result = Comparison(missing_allowed=tolerances.missing)
    stamps = [answer_stamps(record) for record in (first, second)]
    common = np.intersect1d(stamps[0], stamps[1])
    result.common = len(common)
    result.only_first, result.only_second = (len(s) - len(common) for s in stamps)
    if not len(common):
        raise LpvError('the bags have no answer with the same stamp: they are not of one recording')
    result.alarms = _pairs(first, second, tolerances.delay)
    first, second = _restricted(first, common), _restricted(second, common)
    result.figures = _figures(first, second, arm, tolerances.mise)
    result.differences = [
        *_differences(first, second, tolerances),
        *_flag_changes(first, second, tolerances),
    ]
    return result


def answer_stamps(record: RunRecord) -> np.ndarray:
    """Stamps of the answers of a run [ns]."""
    return record.stamps[
        'fault_estimate' if 'fault_estimate' in record.stamps else 'state_estimate'
    ]


def _restricted(record: RunRecord, common: np.ndarray) -> RunRecord:
    """The record with answers at common stamps alone: others must not count for one run only."""
    result = copy(record)
    result.stamps, result.streams = dict(record.stamps), dict(record.streams)
    for stream in SIGNALS:
        if stream in record.stamps:
            kept = np.isin(record.stamps[stream], common)
            result.stamps[stream] = record.stamps[stream][kept]
            result.streams[stream] = {k: v[kept] for k, v in record.streams[stream].items()}
    return result


def _figures(first: RunRecord, second: RunRecord, arm: Arm, tolerance: float) -> list[Figure]:
    tables = [
        {(row.signal, row.meaning): row for row in make_table(record, arm)}
        for record in (first, second)
    ]
    found = []
    units = {key: row.unit for table in tables for key, row in table.items()}
    for key, unit in units.items():
        a, b = (float(table[key].value) if key in table else None for table in tables)
        found.append(Figure(': '.join(key), unit, a, b, _close(a, b, tolerance)))
    return found


def _close(first: float | None, second: float | None, tolerance: float) -> bool:
    if first is None or second is None:
        return False
    if first == second or (math.isnan(first) and math.isnan(second)):
        return True
    allowed = tolerance * max(abs(first), abs(second))
    return abs(first - second) <= (max(allowed, _SMALLEST) if tolerance else 0.0)


def _differences(first: RunRecord, second: RunRecord, tolerances: Tolerances) -> list[Figure]:
    found = []
    for name, a, b in _aligned(first, second, SIGNALS):
        for i in range(a.shape[1]):
            with np.errstate(invalid='ignore'):
                gap = np.abs(a[:, i] - b[:, i])
            gap[(a[:, i] == b[:, i]) | (np.isnan(a[:, i]) & np.isnan(b[:, i]))] = 0.0
            largest = float(np.nan_to_num(gap, nan=math.inf).max(initial=0.0))
            unit = 'rad/s' if name == 'velocity' else 'rad'
            found.append(
                Figure(
                    f'{_LABELS.get(name, name)} {i + 1}',
                    unit,
                    tolerances.signal,
                    largest,
                    largest <= tolerances.signal,
                )
            )
    return found


def _flag_changes(first: RunRecord, second: RunRecord, tolerances: Tolerances) -> list[Figure]:
    found = []
    for name, a, b in _aligned(first, second, _FLAGS):
        share = float(np.mean((a != b).any(axis=1))) if len(a) else 0.0
        found.append(
            Figure(
                _LABELS.get(name, name), 'share', tolerances.flags, share, share <= tolerances.flags
            )
        )
    return found


def _aligned(
    first: RunRecord, second: RunRecord, names: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    for stream, fields in names.items():
        if stream not in first.stamps or stream not in second.stamps:
            continue
        _, i, j = np.intersect1d(first.stamps[stream], second.stamps[stream], return_indices=True)
        for name in fields:
            a, b = first.streams[stream][name][i], second.streams[stream][name][j]
            yield name, a.reshape(len(a), -1), b.reshape(len(b), -1)


def _pairs(first: RunRecord, second: RunRecord, tolerance: float) -> list[AlarmPair]:
    """Alarms of one sensor that are nearest in time belong together."""
    left, pairs = list(episodes(second)), []
    shift = (second.stamps['joint_states'][0] - first.stamps['joint_states'][0]) / 1e9
    for alarm in episodes(first):
        near = [other for other in left if other.sensor_index == alarm.sensor_index]
        other = min(near, key=lambda o: abs(o.raised + shift - alarm.raised), default=None)
        if other is not None and _overlap(alarm, other, shift):
            left.remove(other)
        else:
            other = None
        pairs.append(AlarmPair(alarm, other, _same_alarm(alarm, other, shift, tolerance)))
    pairs += [AlarmPair(None, other, False) for other in left]
    return sorted(pairs, key=_begin)


def _begin(pair: AlarmPair) -> float:
    alarm = pair.first or pair.second
    assert alarm is not None
    return alarm.raised


def _overlap(one: Episode, other: Episode, shift: float) -> bool:
    ends = [math.inf if e.cleared is None else e.cleared for e in (one, other)]
    return one.raised <= ends[1] + shift + 0.5 and other.raised + shift <= ends[0] + 0.5


def _same_alarm(one: Episode, other: Episode | None, shift: float, tolerance: float) -> bool:
    if other is None or one.kind != other.kind:
        return False
    if (one.cleared is None) != (other.cleared is None):
        return False
    times = [(one.raised, other.raised)]
    if one.cleared is not None and other.cleared is not None:
        times.append((one.cleared, other.cleared))
    # Differences of seconds as floats have nanoseconds of rounding.
    return all(abs(a - b - shift) <= tolerance + 1e-9 for a, b in times)
