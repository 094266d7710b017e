"""Intervals of a run in which the diagnosis could not answer, or the arm was stopped."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv_bag.run.node_reports import NodeReport, node_reports
from lpv_bag.run.streams import RunRecord
from lpv_core.decision.diagnosis import AlarmEvent, SensorState
from lpv_core.observer.sampled_observer import Mode
from lpv_report.history.episodes import intervals

INCONSISTENT, SAFE_STOP, UNSAFE = 'inconsistent', 'safe stop', 'not trustworthy'
NOT_DIAGNOSABLE, NO_DATA = 'not diagnosable', 'no data'
TOO_FAST, NO_COMMAND, BRAKED = 'above speed limit', 'no command', 'drives braked'
_STATES = {SensorState.NOT_DIAGNOSABLE: NOT_DIAGNOSABLE, SensorState.STALE: NO_DATA}
_MEANING = {
    INCONSISTENT: 'rates, torques and model contradict each other; cause unknown',
    SAFE_STOP: 'the tracker commanded the drives to brake',
    TOO_FAST: 'a joint moved faster than the limit of the arm file',
    NO_COMMAND: 'measurements had no torque command: a watchdog of the drives brakes the arm',
    BRAKED: 'a watchdog of the drives, or the tracker, engaged the brakes',
    UNSAFE: 'a confirmed fault could not be compensated safely',
    NOT_DIAGNOSABLE: 'the level of the fault estimate says nothing in this configuration',
    NO_DATA: 'no usable reading',
}
_MOST = 8
"""Intervals of one kind that are listed individually."""


@dataclass(frozen=True)
class Phase:
    """One interval."""

    what: str  # one of the words of this module
    sensor: str  # of which sensor; empty for the whole arm
    start: float  # [s] since the first measurement
    end: float  # [s] since the first measurement
    note: str = ''  # why, where it is known

    @property
    def meaning(self) -> str:
        """What the word means."""
        return f'{_MEANING[self.what]}: {self.note}' if self.note else _MEANING[self.what]

    @property
    def duration(self) -> float:
        """[s]."""
        return self.end - self.start


@dataclass(frozen=True)
class Rest:
    """Intervals that are not listed individually."""

    what: str  # as in `Phase`
    sensor: str  # as in `Phase`
    count: int  # how many
    duration: float  # of all of them together [s]


def phases(record: RunRecord, bag: str | Path, sensor_names: Sequence[str]) -> list[Phase]:
    """All such intervals of a run.

    Parameters
    ----------
    record : RunRecord
        The run.
    bag : str or pathlib.Path
        Its bag, for what the observer said on /diagnostics.
    sensor_names : sequence of str
        Names of the sensors.

    Returns
    -------
    list of Phase
        In the order of their beginnings.
    """
    reports = _reports(record, bag)
    said = _of_observer(record, reports.get('observer', []))
    odd = [p for p in (*said, *_of_alarms(record)) if p.what == INCONSISTENT]
    found = [p for p in said if p.what != INCONSISTENT] + _united(odd)
    found += _of_commands(record, reports.get('tracking', []))
    found += _of_drives(record, reports.get('drives', []))
    states = record.get('fault_estimate', 'state')
    if states is not None:
        stamps = record.stamps['fault_estimate']
        time, begun = record.seconds(stamps), ~starting(record, stamps)
        found += [
            Phase(what, sensor_names[i], part.start, part.end)
            for state, what in _STATES.items()
            for i in range(states.shape[1])
            for part in intervals((states[:, i] == state) & begun, time)
        ]
    return sorted(found, key=lambda p: (p.start, p.what, p.sensor))


def starting(record: RunRecord, stamps: np.ndarray) -> np.ndarray:
    """Which samples are the first ones, when no answer is expected yet."""
    mode = record.get('state_estimate', 'mode')
    if mode is None:
        return np.zeros(len(stamps), bool)
    return np.isin(stamps, record.stamps['state_estimate'][mode == Mode.INITIALISING])


def _reports(record: RunRecord, bag: str | Path) -> dict[str, list[NodeReport]]:
    streams = ('fault_estimate', 'state_estimate', 'torque_command')
    topic = next((record.topics[name] for name in streams if name in record.topics), None)
    return {} if topic is None else node_reports(bag, topic.rpartition('/')[0])


def _of_observer(record: RunRecord, reports: list[NodeReport]) -> list[Phase]:
    """Reports come once a second and with every alarm: times are as exact as that."""
    if not reports:
        return []
    time = record.seconds(np.array([report.stamp for report in reports]))
    kinds = ((INCONSISTENT, 'inconsistent'), (UNSAFE, 'a confirmed fault cannot be compensated'))
    return [
        Phase(what, '', part.start, part.end)
        for what, begin in kinds
        for part in intervals(np.array([r.message.startswith(begin) for r in reports]), time)
    ]


def _of_drives(record: RunRecord, reports: list[NodeReport]) -> list[Phase]:
    """The drives report when they brake or release: each report holds until the next one."""
    found: list[Phase] = []
    ends = [float(record.seconds(report.stamp)) for report in reports[1:]] + [record.time[-1]]
    for report, end in zip(reports, ends):
        start = float(record.seconds(report.stamp))
        begin, _, reason = report.message.partition(': ')
        if begin != 'braked' or reason == 'no command yet':
            continue
        if found and found[-1].end == start and found[-1].note == reason:
            found[-1] = replace(found[-1], end=end)
        else:
            found.append(Phase(BRAKED, '', start, end, reason))
    return found


def _of_alarms(record: RunRecord) -> list[Phase]:
    """Alarms whose cause is unknown, until they are classified or cleared."""
    found: list[Phase] = []
    begun: dict[int, float] = {}
    for event in record.alarms:
        at = float(record.seconds(event.stamp))
        unknown = event.kind == INCONSISTENT and event.event != AlarmEvent.CLEARED
        if unknown:
            begun.setdefault(event.sensor_index, at)
        elif event.sensor_index in begun:
            found.append(Phase(INCONSISTENT, '', begun.pop(event.sensor_index), at))
    return found + [Phase(INCONSISTENT, '', at, record.time[-1]) for at in begun.values()]


def _united(found: list[Phase]) -> list[Phase]:
    """Intervals of one kind; those that overlap become one."""
    united: list[Phase] = []
    for phase in sorted(found, key=lambda p: p.start):
        if united and phase.start <= united[-1].end:
            end = max(united[-1].end, phase.end)
            united[-1] = replace(united[-1], end=end)
        else:
            united.append(phase)
    return united


def _of_commands(record: RunRecord, reports: list[NodeReport]) -> list[Phase]:
    """Safe stops that the tracker commanded, with the reasons that it reported meanwhile."""
    stopped = record.get('torque_command', 'safe_stop')
    if stopped is None:
        return []
    time = record.seconds(record.stamps['torque_command'])
    told = [
        (float(record.seconds(r.stamp)), r.message.partition(': ')[2])
        for r in reports
        if r.message.startswith('safe stop: ')
    ]
    return [
        Phase(
            SAFE_STOP,
            '',
            part.start,
            part.end,
            '; '.join(dict.fromkeys(text for at, text in told if part.start <= at <= part.end)),
        )
        for part in intervals(stopped.astype(bool), time)
    ]


def listed(found: list[Phase]) -> tuple[list[Any], ...]:
    """The longest intervals of each kind, and the sum of the others."""
    kept, rests = [], []
    for key in sorted({(p.what, p.sensor) for p in found}):
        same = sorted((p for p in found if (p.what, p.sensor) == key), key=lambda p: -p.duration)
        kept += same[:_MOST]
        if same[_MOST:]:
            rests.append(Rest(*key, len(same) - _MOST, sum(p.duration for p in same[_MOST:])))
    return sorted(kept, key=lambda p: (p.start, p.what, p.sensor)), rests
