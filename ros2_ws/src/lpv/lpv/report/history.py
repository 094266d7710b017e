"""What happened in a run: alarms from onset to end, times without an answer, stops, speeds."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lpv.bag.rosbag.output_folder import SCENARIO_NAME
from lpv.bag.run.record import (
    NodeReport,
    RecordedAlarm,
    RunRecord,
    alarms_of,
    load_run,
    node_reports,
)
from lpv.core.control.path import SerialPath
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import alarms
from lpv.core.simulation.faults import tells_of
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.resources import bringup_file
from lpv.report.certificate import Certificate, beside_bag, examine, find_arm_and_gains
from lpv.report.table import make_table

INCONSISTENT, SAFE_STOP, UNSAFE = 'inconsistent', 'safe stop', 'not trustworthy'
NOT_DIAGNOSABLE, NO_DATA = 'not diagnosable', 'no data'
TOO_FAST, NO_COMMAND, BRAKED = 'above speed limit', 'no command', 'drives braked'
_STATES = {alarms.SensorState.NOT_DIAGNOSABLE: NOT_DIAGNOSABLE, alarms.SensorState.STALE: NO_DATA}
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
_TOLD = (
    (INCONSISTENT, 'observer', INCONSISTENT),
    (UNSAFE, 'observer', 'a confirmed fault cannot be compensated'),
    (BRAKED, 'drives', 'braked: '),
)
"""What a node's reports tell, by how they begin."""
_MOST = 8
"""Intervals of one kind that are listed individually."""
_MOST_TIPS = 5000
"""Samples of which the tip is computed."""


Span = tuple[float, float]
"""Start and end of an interval since the first measurement [s]."""


def spans(mask: np.ndarray, time: np.ndarray) -> list[Span]:
    """Where a mask is true; each span ends at the first sample outside, or with the record."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    starts, ends = edges[::2], np.minimum(edges[1::2], len(time) - 1)
    return list(zip(time[starts].tolist(), time[ends].tolist()))


# ------------------------------------------------------------------ alarms


@dataclass(frozen=True)
class Episode:
    """One alarm of one sensor; times since the first measurement [s]."""

    sensor: str  # name of the sensor
    sensor_index: int  # its column
    onset: float  # first sample above the threshold, as diagnosed
    raised: float  # when the fault was confirmed
    cleared: float | None  # when the alarm ended; None if it lasted to the end of the run
    # fault estimate and bound: now, at the end of the run, while it is active; else the last ones
    # before it was cleared; of noise and of a rate those of its last event; NaN of a dropout
    size: float
    bound: float
    # estimate of largest magnitude during the alarm; NaN without estimates of such an error
    largest: float
    kind: str  # latest classification
    confidence: float  # latest confidence
    # start of the true fault at the time of the alarm; NaN if there was none (false alarm), None
    # without ground truth, and where the fault had just ended
    true_onset: float | None = None

    @property
    def delay(self) -> float | None:
        """Time from the true fault's onset to the alarm [s]; None where that is unknown."""
        if self.true_onset is None or math.isnan(self.true_onset):
            return None
        return self.raised - self.true_onset

    def unit(self, arm: SerialArm) -> str:
        """Unit of its sizes; '' if a damaged message names a sensor that the arm has not."""
        units = arm.position_units[self.sensor_index :][:1]
        return ''.join(alarms.size_unit(self.kind, unit) for unit in units)

    @property
    def about(self) -> tuple[int, str]:
        """Its sensor, and what of it; one alarm at a time is about it."""
        return self.sensor_index, alarms.subject(self.kind)

    @property
    def false_alarm(self) -> bool:
        """Whether ground truth says that there was no fault."""
        return self.true_onset is not None and math.isnan(self.true_onset)


class FaultSpan(NamedTuple):
    """Where a fault of one sensor acted."""

    sensor_index: int  # column of the sensor
    start: float  # [s] since the first measurement
    end: float  # [s]; that of the record if it lasted so long


def true_faults(record: RunRecord) -> list[FaultSpan] | None:
    """Where faults acted; None without ground truth."""
    truth = record.get('ground_truth', 'fault')
    if truth is None:
        return None
    time = record.seconds(record.stamps['ground_truth'])
    # A dropout is recorded as NaN, which is not zero either.
    found = [spans(column != 0.0, time) for column in truth.T]
    return [FaultSpan(i, *span) for i, own in enumerate(found) for span in own]


def episodes(record: RunRecord) -> list[Episode]:
    """Alarms of a run, in the order in which they were raised."""
    faults = true_faults(record)
    found = [_episode(record, events, faults) for events in alarms_of(record.alarms)]
    return sorted(found, key=lambda e: (e.raised, e.sensor_index))


def _episode(
    record: RunRecord, events: list[RecordedAlarm], faults: list[FaultSpan] | None
) -> Episode:
    first, end, i = events[0], events[-1], events[0].sensor_index
    last = next((e for e in reversed(events) if e.event != alarms.AlarmEvent.CLEARED), first)
    cleared = record.seconds(end.stamp) if end.event == alarms.AlarmEvent.CLEARED else None
    onset, raised = record.seconds(first.onset), record.seconds(first.detected)
    own = [fault for fault in faults or () if fault.sensor_index == i]
    told = [tells_of(fault.start, fault.end, onset, raised, first.kind) for fault in own]
    mine = [fault.start for fault, is_told in zip(own, told) if is_told]
    # The truth has faults of positions alone.
    unknown = faults is None or (not mine and (None in told or first.kind == alarms.RATE_BIAS))
    true_onset = None if unknown else mine[-1] if mine else math.nan
    size, bound, largest = last.size, last.bound, math.nan
    known = record.streams.get('fault_estimate', {'estimate': np.zeros((0, 0))})
    if last.kind == 'dropout':
        size = bound = math.nan
    elif 0 <= i < known['estimate'].shape[1] and last.kind not in ('noise', alarms.RATE_BIAS):
        time, values = record.seconds(record.stamps['fault_estimate']), known['estimate'][:, i]
        until = math.inf if cleared is None else cleared
        rows = np.flatnonzero((time >= raised) & (time <= until) & np.isfinite(values))
        if rows.size:
            largest = float(max(values[rows], key=abs))
            if cleared is None:
                size, bound = float(values[rows[-1]]), float(known['bound'][rows[-1], i])
    return Episode(
        first.sensor, i, onset, raised, cleared, size,
        bound, largest, last.kind, last.confidence, true_onset,
    )  # fmt: skip


def missed_faults(record: RunRecord, found: list[Episode]) -> list[FaultSpan]:
    """True faults during which no alarm was raised or active; none without ground truth."""
    return [
        fault for fault in true_faults(record) or []
        if not any(e.sensor_index == fault.sensor_index and (
                   tells_of(fault.start, fault.end, e.onset, e.raised, e.kind) or (
                   e.raised < fault.end and (e.cleared is None or e.cleared > fault.start)))
                   for e in found)
    ]  # fmt: skip


# ------------------------------------------------------------------ phases


@dataclass(frozen=True)
class Phase:
    """An interval without an answer, or in which the arm was stopped or too fast."""

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


def phases(
    record: RunRecord, arm: SerialArm, reports: Mapping[str, Sequence[NodeReport]]
) -> list[Phase]:
    """All such intervals by beginning, as exact as the nodes' ``reports`` where these say it."""
    _, time, rates = _rates(record)
    commands = record.stamps.get('torque_command', np.zeros(0, np.int64))
    last = max([*commands[-1:], record.stamps['joint_states'][-1]])
    times = record.seconds(np.append(commands, last)).tolist()
    silent = [pair for pair in zip(times, times[1:]) if pair[1] - pair[0] > MAX_GAP]
    fast = spans((np.abs(rates) > arm.velocity_limit).any(axis=1), time)
    found = [Phase(NO_COMMAND, '', *span) for span in silent]
    found += [Phase(TOO_FAST, '', *span) for span in fast]
    found += _safe_stops(record, reports.get('tracking', ()))
    for what, who, begin in _TOLD:
        found += _told(record, reports.get(who, ()), what, begin)
    states = record.get('fault_estimate', 'state')
    if states is not None:
        stamps = record.stamps['fault_estimate']
        time, begun = record.seconds(stamps), ~starting(record, stamps)
        found += [
            Phase(what, sensor, *span)
            for state, what in _STATES.items()
            for sensor, column in zip(arm.sensor_names, states.T)
            for span in spans((column == state) & begun, time)
        ]
    return sorted(found, key=lambda p: (p.start, p.what, p.sensor))


def starting(record: RunRecord, stamps: np.ndarray) -> np.ndarray:
    """Which samples are the first ones, when no answer is expected yet."""
    mode = record.get('state_estimate', 'mode')
    if mode is None:
        return np.zeros(len(stamps), bool)
    return np.isin(stamps, record.stamps['state_estimate'][mode == alarms.Mode.INITIALISING])


def _told(record: RunRecord, reports: Sequence[NodeReport], what: str, begin: str) -> list[Phase]:
    """While a node's reports begin with a text: each of them holds until the next one."""
    found: list[Phase] = []
    ends = [float(record.seconds(report.stamp)) for report in reports[1:]] + [record.time[-1]]
    for report, end in zip(reports, ends):
        start, reason = float(record.seconds(report.stamp)), report.message.removeprefix(begin)
        if reason == report.message or reason == 'no command yet':
            continue
        note = reason if what == BRAKED else ''
        if found and (found[-1].end, found[-1].note) == (start, note):
            found[-1] = replace(found[-1], end=end)
        else:
            found.append(Phase(what, '', start, max(start, end), note))
    return found


def _safe_stops(record: RunRecord, reports: Sequence[NodeReport]) -> list[Phase]:
    """Safe stops that the tracker commanded, with the reasons that it reported meanwhile."""
    stopped = record.get('torque_command', 'safe_stop')
    if stopped is None:
        return []
    begin, found = 'safe stop: ', []
    told = [(record.seconds(r.stamp), r.message) for r in reports if r.message.startswith(begin)]
    for start, end in spans(stopped != 0, record.seconds(record.stamps['torque_command'])):
        during = (text.removeprefix(begin) for at, text in told if start <= at <= end)
        reasons = dict.fromkeys(during)
        found.append(Phase(SAFE_STOP, '', start, end, '; '.join(reasons)))
    return found


def listed(found: Sequence[Phase]) -> tuple[list[Phase], list[dict[str, Any]]]:
    """The longest intervals of each kind, and the sums of the others."""
    kept: list[Phase] = []
    rests: list[dict[str, Any]] = []
    for key in sorted({(p.what, p.sensor) for p in found}):
        same = sorted((p for p in found if (p.what, p.sensor) == key), key=lambda p: -p.duration)
        kept += same[:_MOST]
        if rest := same[_MOST:]:
            names = dict(zip(('what', 'sensor'), key))
            rests.append({**names, 'count': len(rest), 'duration': sum(p.duration for p in rest)})
    return sorted(kept, key=lambda p: (p.start, p.what, p.sensor)), rests


# ------------------------------------------------------------------ motion


@dataclass(frozen=True)
class Motion:
    """Extremes of a run; None where they are not known."""

    source: str  # whose rates they are: true or measured
    fastest: float  # largest joint rate, as a share of the joint's limit; infinite if not finite
    speed: float  # that rate
    limit: float  # its limit
    unit: str  # of both
    joint: str  # the joint
    path_error: float | None  # largest distance of the true tip from the reference [m]


def motion(record: RunRecord, arm: SerialArm) -> Motion:
    """Extremes of the motion: of the true arm where it is recorded, else as measured."""
    source, _, rates = _rates(record)
    limits = np.asarray(arm.velocity_limit)
    # A missing rate (NaN) is a matter of the sensor, an infinite one is not.
    shares = np.where(np.isnan(rates), 0.0, np.abs(rates)) / limits
    row, joint = np.unravel_index(int(np.argmax(shares)), shares.shape)
    truth, reference = (record.aligned(s, 'position') for s in ('ground_truth', 'reference'))
    path_error = None
    if truth is not None and reference is not None:
        one, two = tip_positions(arm, truth, reference)
        path_error = float(np.linalg.norm(one - two, axis=1).max()) if len(one) else None
    fastest = float(shares[row, joint]), float(abs(rates[row, joint])), float(limits[joint])
    names = f'{arm.position_units[joint]}/s', arm.joint_names[joint]
    return Motion(source, *fastest, *names, path_error)


def _rates(record: RunRecord) -> tuple[str, np.ndarray, np.ndarray]:
    """Whose rates, their times [s], and the rates [rad/s]."""
    stream = 'ground_truth' if 'ground_truth' in record.streams else 'joint_states'
    source = 'true' if stream == 'ground_truth' else 'measured'
    time = np.asarray(record.seconds(record.stamps[stream]))
    return source, time, record.streams[stream]['velocity']


def tip_positions(arm: SerialArm, *positions: np.ndarray) -> list[np.ndarray]:
    """Tips in the base frame, (k, 3) [m], of some samples in which all positions are known."""
    # Only here: compiled code that other parts of the report do not need.
    from lpv.core.serial_arm.chain import compile_chain
    from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics

    rows = np.flatnonzero(np.isfinite(np.hstack(positions)).all(axis=1))
    rows, chain = rows[:: max(1, len(rows) // _MOST_TIPS)], compile_chain(arm)
    tips = ([forward_kinematics(chain, q)[1] for q in position[rows]] for position in positions)
    return [np.reshape(one, (-1, 3)) for one in tips]


# ------------------------------------------------------------------ all of it


@dataclass
class Run:
    """A recorded run, and what follows from it: alarms, misses, phases, motion, table."""

    record: RunRecord
    arm: SerialArm
    reports: Mapping[str, Sequence[NodeReport]]  # of the nodes, as of `node_reports`
    certificate: Certificate  # of the gains
    title: str = 'Run'  # heading of its page
    path: SerialPath | None = None  # reference, with the obstacle

    def __post_init__(self) -> None:
        self.alarms = episodes(self.record)
        self.missed = missed_faults(self.record, self.alarms)
        self.phases = phases(self.record, self.arm, self.reports)
        self.motion = motion(self.record, self.arm)
        self.table = make_table(self.record, self.arm)


def load(
    bag: str | Path,
    arm: SerialArm | None = None,
    scenario: str | Path | None = None,
    title: str = '',
    gains: str | Path | None = None,
    topic: str | None = None,  # of the measurements, in a bag of several arms
) -> Run:
    """Read all that a report needs; arm, scenario and gains are those of the bag if not given."""
    arm, gains, source = find_arm_and_gains(bag, arm, gains)
    record = load_run(bag, topic, arm.joint_names)
    streams = ('fault_estimate', 'state_estimate', 'torque_command')
    known = next((record.topics[name] for name in streams if name in record.topics), None)
    reports = {} if known is None else node_reports(bag, known.rpartition('/')[0])
    path = None
    if scenario:
        path = load_scenario(bringup_file('scenarios', str(scenario))).path(arm)
    elif copy := beside_bag(bag, SCENARIO_NAME):
        with contextlib.suppress(LpvError):  # a damaged copy must not stand in the way of a report
            path = load_scenario(copy).path(arm)
    title = title or f'{Path(bag).name}, arm “{arm.name}”'
    return Run(record, arm, reports, examine(gains, arm, source), title, path)
