"""Offline run of the diagnosis over a recorded bag, with the node's own code."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv.bag.blocks.message_blocks import Block, ahead
from lpv.bag.errors import BagError
from lpv.bag.replay.injection import BlockInjector
from lpv.bag.replay.writer import Batch, ReplayWriter
from lpv.bag.rosbag.reading import BagReader, open_bag
from lpv.bag.run.measurements import EFFORT_TYPES, EffortReader, MeasurementReader
from lpv.bag.run.record import STREAMS, RecordedAlarm, arm_namespace, find_connections, find_topic
from lpv.core.monitoring.alarm_text import UNUSED, unusable_text
from lpv.core.monitoring.answers import Answers
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import RATE_BIAS, AlarmEvent
from lpv.core.simulation.faults import GRACE, Fault, FaultInjector, tells_of
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import NANOSECONDS

_COMMAND = 'torque_command'


@dataclass(frozen=True)
class ReplayOptions:
    """What is replayed, and what is written."""

    topic: str | None = None  # of the measurements, where the bag has several JointState topics
    # torques to use in place of the measured efforts; of a type in measurements.EFFORT_TYPES
    effort_topic: str | None = None
    start: float | None = None  # first message, counted from the first one of the bag [s]
    end: float | None = None  # end of the interval, counted likewise [s]
    torque_from_command: bool = False  # take torques from the recorded commands
    estimates_only: bool = False  # write the answers alone; otherwise all topics are copied, too
    preset: str = 'none'  # compression of the new bag, key of `lpv.bag.rosbag.writing.PRESETS`


@dataclass
class ReplayResult:
    """What a replay found."""

    measurements: int = 0  # samples read
    answered: int = 0  # samples that led to an answer
    first_stamp: int | None = None  # stamp of the first usable sample [ns]
    last_stamp: int | None = None  # stamp of the last one [ns]
    rejected: Counter[str] = field(default_factory=Counter)  # unusable messages by reason
    events: list[RecordedAlarm] = field(default_factory=list)  # alarm events
    # what the observer warns of, with times from the first usable sample on [s]
    notes: list[tuple[float, str]] = field(default_factory=list)
    topic: str = ''  # of the measurements
    namespace: str = ''  # of the arm's nodes
    streams: set[str] = field(default_factory=set)  # of `STREAMS`, that are there
    warnings: list[str] = field(default_factory=list)  # tolerated defects of the bag
    lost: int = 0  # measurements that the recorder says it has lost


class Replay:
    """Runs a fresh monitor over a bag; ``on_event`` gets alarms, and times from the start [s]."""

    def __init__(
        self,
        monitor: SerialSensorMonitor,
        options: ReplayOptions | None = None,
        injector: FaultInjector | None = None,
        on_event: Callable[[RecordedAlarm, float], None] | None = None,
        **changes: Any,
    ) -> None:
        self._monitor, self._injector = monitor, injector
        self._options = replace(options or ReplayOptions(), **changes)
        self._on_event = on_event or (lambda event, time: None)

    def run(self, bag: str | Path, out: str | Path) -> ReplayResult:
        """Replay a bag into a new one; BagError or ConfigError if either cannot be read or made."""
        options = self._options
        with open_bag(bag) as reader:
            result, effort = self._begin(reader)
            copied = [] if options.estimates_only else reader.connections
            if self._injector is not None:  # what was true is not true of other readings
                copied = [c for c in copied if not c.msgtype.endswith('/GroundTruth')]
            writer = ReplayWriter(out, self._monitor, options.preset, copied)
            with writer.bag, ThreadPoolExecutor(1) as pool:
                written: Future[Any] = pool.submit(int)
                for batch in ahead(self._batches(reader, effort, result, writer.copied)):
                    copies, answers = writer.copies(reader, batch), self._answer(batch, result)
                    written.result()
                    written = pool.submit(writer.write, batch, copies, answers)
                written.result()
                self._check(bag, result)
        return result

    def watch(self, bag: str | Path, take: Callable[..., Any]) -> ReplayResult:
        """Run over a bag, hand measurements and answers to ``take`` by blocks, write nothing."""
        with open_bag(bag) as reader:
            result, effort = self._begin(reader)
            within = result.namespace
            result.streams = {n for n in STREAMS if find_connections(reader, n, namespace=within)}
            for batch in ahead(self._batches(reader, effort, result)):
                take(batch.measured, self._answer(batch, result))
            result.warnings = list(reader.warnings)
            result.lost = int(reader.known.get(result.topic, {}).get('lost', 0))
        self._check(bag, result)
        return result

    def _check(self, bag: str | Path, result: ReplayResult) -> None:
        """BagError for a bag of which nothing was diagnosed."""
        counters = self._monitor.counters
        fitting = result.measurements - sum(result.rejected.values())
        if not result.measurements:
            raise BagError(f'{bag}: holds no message on {result.topic} in the chosen interval')
        if not result.answered and result.rejected:
            (reason, count), *_ = result.rejected.most_common(1)
            text = f'none of its {result.measurements} measurements can be used'
            raise BagError(f'{bag}: {text} ({count} of them: {reason})')
        if result.answered == 1 < fitting:
            raise BagError(
                f'{bag}: no measurement on {result.topic} is newer than the first one: let the '
                'driver stamp them with the time of measurement'
            )
        unused = sum(getattr(counters, name) for name in UNUSED)
        if fitting - unused <= 1 <= unused:  # the first of a stream fits any
            raise BagError(f'{bag}: {unusable_text(counters)}')

    def _begin(self, reader: BagReader) -> tuple[ReplayResult, Connection | None]:
        """A result that names the topic of the measurements; where the torques come from."""
        options, effort = self._options, None
        joints = self._monitor.arm.joint_names
        measured = find_topic(reader, 'joint_states', options.topic, joints)
        prefix = arm_namespace(reader, measured)
        self._monitor.name = f'{prefix}/uio'
        if options.effort_topic:
            effort = _effort_connection(reader, options.effort_topic)
        elif options.torque_from_command:
            topic = find_topic(reader, _COMMAND, f'{prefix}/{_COMMAND}')
            effort = _effort_connection(reader, topic)
        return ReplayResult(topic=measured, namespace=prefix), effort

    def _batches(
        self,
        reader: BagReader,
        effort: Connection | None,
        result: ReplayResult,
        others: frozenset[str] = frozenset(),
    ) -> Iterator[Batch]:
        """Blocks of what is measured, and of other topics, with the measurements decoded."""
        arm, options = self._monitor.arm, self._options
        if options.start is not None and options.end is not None and options.end <= options.start:
            raise ConfigError('--to', 'must be after --from')
        needed = others | {result.topic} | ({effort.topic} if effort else set())
        wanted = [c for c in reader.connections if c.topic in needed]
        measurements = MeasurementReader(reader, arm.joint_names)
        efforts = effort and EffortReader(reader, effort.msgtype, arm.joint_names)
        # Commands are in N m; the monitor wants the unit of efforts.
        commanded = effort is not None and effort.msgtype == STREAMS[_COMMAND][0]
        gain = np.array([joint.torque_gain if commanded else 1.0 for joint in arm.joints])
        injector = self._injector and BlockInjector(self._injector, arm, reader)
        for block in reader.blocks(wanted, *map(reader.log_time, (options.start, options.end))):
            positions = _of(block, wanted, result.topic)
            measured = measurements.read(block, positions)
            result.measurements += len(positions)
            if efforts and effort:
                given = _of(block, wanted, effort.topic)
                torque = efforts.before(block, given, measured.places) / gain
                measured = measured._replace(effort=torque)
            rejected = np.setdiff1d(positions, measured.places, assume_unique=True)
            changed = injector.apply(block, measured) if injector else {}
            yield Batch(wanted, block, measured, rejected, changed)
        result.rejected = measurements.rejected + (efforts.rejected if efforts else Counter())

    def _answer(self, batch: Batch, result: ReplayResult) -> Answers:
        """Run the monitor over a block's measurements."""
        stamp, arrived = batch.measured.stamp, batch.block.time[batch.measured.places]
        answers = self._monitor.take_many(*batch.measured[1:], arrived)
        result.answered += int(answers.answered.sum())
        if result.first_stamp is None and len(stamp):
            result.first_stamp = int(stamp[0])
        for row, report in answers.due:
            # Of the messages without use, as a node that hears them one by one.
            before = batch.rejected.searchsorted(batch.measured.places[row])
            report.rejected += int(before)
        self._monitor.rejected += len(batch.rejected)
        if len(stamp):
            result.last_stamp = int(stamp[-1])
        start = result.first_stamp or 0
        for row, event in answers.events:
            alarm = RecordedAlarm(**vars(event), stamp=int(stamp[row]))
            result.events.append(alarm)
            self._on_event(alarm, (alarm.stamp - start) / NANOSECONDS)
        for row, text in answers.warnings:
            result.notes.append(((int(stamp[row]) - start) / NANOSECONDS, text))
        return answers


def _of(block: Block, connections: Sequence[Connection], topic: str) -> np.ndarray:
    """Positions of a topic's messages in a block."""
    return np.flatnonzero(np.array([c.topic == topic for c in connections])[block.connection])


def _effort_connection(reader: BagReader, topic: str) -> Connection:
    found = next((c for c in reader.connections if c.topic == topic), None)
    if found is not None and found.msgtype in EFFORT_TYPES:
        return found
    if found is None:
        there = ', '.join(sorted(c.topic for c in reader.connections if c.msgtype in EFFORT_TYPES))
        text = f'the bag has no topic {topic!r}; topics that may carry torques are '
        text += there or 'missing'
    else:
        text = f'{topic} is of type {found.msgtype}; torques can be read from '
        text += ', '.join(EFFORT_TYPES)
    raise BagError(f'{reader.path}: {text}')


@dataclass(frozen=True)
class InjectedFault:
    """One injected fault and the alarm that found it."""

    fault: Fault
    acted: bool  # the recording was not over before
    wrong_sensors: tuple[str, ...] = ()  # healthy sensors that were alarmed meanwhile
    delay: float | None = None  # from its onset to the confirmed alarm of its sensor, if any [s]
    last: RecordedAlarm | None = None  # what that alarm said last while the fault acted
    error: float | None = None  # its size minus the injected one, where that is defined [rad]

    @property
    def verdict(self) -> str:
        """One phrase for the user."""
        if not self.acted:
            return 'not injected, the recording ends before'
        if self.last is not None:
            return 'found'
        wrong = ', '.join(self.wrong_sensors)
        return f'wrong sensor: {wrong}' if wrong else 'not found'


def judge(faults: Sequence[Fault], result: ReplayResult) -> list[InjectedFault]:
    """What alarms say of faults whose onsets count from the first measurement, in their order."""
    start, found = result.first_stamp or 0, []
    events = [((event.stamp - start) / NANOSECONDS, event) for event in result.events]

    def tells(fault: Fault, at: float, event: RecordedAlarm) -> bool | None:
        onset = (event.onset - start) / NANOSECONDS
        is_own = event.sensor == fault.sensor
        return is_own and tells_of(fault.onset, fault.end, onset, at, event.kind)

    end = math.inf if result.last_stamp is None else (result.last_stamp - start) / NANOSECONDS
    raised = [(at, event) for at, event in events if event.event == AlarmEvent.RAISED]
    false = [one for one in raised if all(tells(fault, *one) is False for fault in faults)]
    for fault in faults:
        during = {event.sensor for at, event in false if fault.onset <= at <= fault.end + GRACE}
        said = [one for one in events if one[1].event != AlarmEvent.CLEARED]
        own = [(at, event) for at, event in said if tells(fault, at, event)]
        delays = [at - fault.onset for at, event in own if event.event == AlarmEvent.RAISED]
        wrong = tuple(sorted(during - {fault.sensor}))
        one = InjectedFault(fault, fault.onset <= end, wrong)
        if delays:
            at, last = ([pair for pair in own if pair[0] <= fault.end] or own)[-1]
            true, error = true_size(fault, at), None
            if true is not None and (last.kind == RATE_BIAS) == (fault.kind == RATE_BIAS):
                error = last.size - true
            one = replace(one, delay=delays[0], last=last, error=error)
        found.append(one)
    return found


def true_size(fault: Fault, time: float) -> float | None:
    """Error of a reading [rad], or of a rate, at a time; None where it depends on the reading."""
    if fault.kind == 'drift':
        grown = fault.rate * (min(time, fault.end) - fault.onset)
        # The sign of the limit does not count, as in `lpv.core.simulation.faults.apply_faults`.
        return grown if fault.size == 0.0 else min(max(grown, -abs(fault.size)), abs(fault.size))
    return fault.size if fault.kind in ('bias', RATE_BIAS) else None
