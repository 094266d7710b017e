"""Offline run of the diagnosis over a recorded bag, with the node's own code."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.message_blocks import ahead
from lpv_bag.errors import BagError
from lpv_bag.replay.answer_rows import take_all
from lpv_bag.replay.injection import CHANGED, BlockInjector
from lpv_bag.replay.session import Batch, ReplayOptions, ReplayResult
from lpv_bag.replay.writer import ReplayWriter
from lpv_bag.rosbag.reading import BagReader, open_bag
from lpv_bag.run.measurements import MEASUREMENT_TYPE, MeasurementReader
from lpv_bag.run.record import STREAMS, find_connections, find_topic
from lpv_bag.run.streams import RecordedAlarm
from lpv_bag.run.torque_reader import EFFORT_TYPES, EffortReader
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.simulation.faults import FaultInjector
from lpv_core.support.errors import ConfigError
from lpv_core.support.timestamps import NANOSECONDS

_COMMAND = ('torque_command', 'lpv_msgs/msg/TorqueCommand')


class _Inputs(NamedTuple):
    prefix: str
    measured: str
    effort: Connection | None


class Replay:
    """Runs a fresh monitor over a bag: with other ``options`` (or fields of them by name), with
    injected faults; ``on_event`` takes every alarm event and its time since the first measurement
    [s]."""

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
        """Replay one bag into another, which is created.

        All topics are copied unless the options say otherwise, except earlier answers of the same
        monitor, which are replaced.  BagError if the bag cannot be read or lacks measurements,
        ConfigError if the new one cannot be made.
        """
        result, options = ReplayResult(), self._options
        with open_bag(bag) as reader:
            inputs = self._inputs(reader)
            copied = [] if options.estimates_only else reader.connections
            writer = ReplayWriter(out, self._monitor, inputs.prefix, options.preset, copied)
            try:
                wanted = self._wanted(reader, inputs, writer.copied)
                with ThreadPoolExecutor(1) as pool:
                    written: Future[None] | None = None
                    for batch in ahead(self._batches(reader, inputs, wanted, result)):
                        copies = writer.copies(reader, wanted, batch)
                        answers = self._answer(batch, result)
                        if written is not None:
                            written.result()
                        written = pool.submit(writer.write, batch, copies, answers, result)
                    if written is not None:
                        written.result()
                _check(bag, inputs, result)
                if not result.answered and result.rejected:
                    (reason, count), *_ = result.rejected.most_common(1)
                    raise BagError(
                        f'{bag}: none of its {result.measurements} measurements can be used '
                        f'({count} of them: {reason})'
                    )
                with result.stage('writing'):
                    writer.close()
            except BaseException:
                # Half a bag looks like a whole one, and would block the next try.
                shutil.rmtree(out, ignore_errors=True)
                raise
        return result

    def watch(self, bag: str | Path, take: Callable[..., Any]) -> ReplayResult:
        """Run over one bag and write nothing; errors as of `run`.

        ``take`` is called block by block with measurements and answers.
        """
        result = ReplayResult()
        with open_bag(bag) as reader:
            inputs = self._inputs(reader)
            result.topic = inputs.measured
            result.streams = {
                name
                for name, (msgtype, _) in STREAMS.items()
                if find_connections(reader, msgtype, name, namespace=inputs.prefix)
            }
            for batch in ahead(
                self._batches(reader, inputs, self._wanted(reader, inputs, set()), result)
            ):
                take(batch.measured, self._answer(batch, result))
            result.warnings = list(reader.warnings)
            result.lost = int(reader.known.get(inputs.measured, {}).get('lost', 0))
        _check(bag, inputs, result)
        return result

    def _inputs(self, reader: BagReader) -> _Inputs:
        options = self._options
        measured = find_topic(reader, MEASUREMENT_TYPE, 'joint_states', options.topic).topic
        prefix = measured.rsplit('/', 1)[0]
        self._monitor.name = f'{prefix}/uio'
        effort = None
        if options.effort_topic:
            effort = _effort_connection(reader, options.effort_topic)
        elif options.torque_from_command:
            effort = find_topic(reader, _COMMAND[1], _COMMAND[0], f'{prefix}/{_COMMAND[0]}')
        return _Inputs(prefix, measured, effort)

    @staticmethod
    def _wanted(reader: BagReader, inputs: _Inputs, others: set[str]) -> list[Connection]:
        needed = others | {inputs.measured} | ({inputs.effort.topic} if inputs.effort else set())
        return [c for c in reader.connections if c.topic in needed]

    def _batches(
        self, reader: BagReader, inputs: _Inputs, wanted: Sequence[Connection], result: ReplayResult
    ) -> Iterator[Batch]:
        """Blocks of the bag with the measurements in them, decoded."""
        joints, effort = self._monitor.arm.joint_names, inputs.effort
        measurements = MeasurementReader(reader, joints, self._monitor.needs_rates)
        efforts = effort and EffortReader(reader, effort.msgtype, joints)
        injector = self._injector and BlockInjector(self._injector, self._monitor)
        blocks = reader.blocks(wanted, *_limits(reader, self._options))
        while True:
            with result.stage('reading'):
                block = next(blocks, None)
            if block is None:
                return
            with result.stage('decoding'):
                positions = _of(block, wanted, inputs.measured)
                measured = measurements.read(block, positions)
                torque, changed = None, {}
                if effort and efforts:
                    given = _of(block, wanted, effort.topic)
                    torque = efforts.before(block, given, positions)
                    result.rejected.update(efforts.rejected)
                    efforts.rejected.clear()
                if injector:
                    places = {name: measurements.places(block, positions, name) for name in CHANGED}
                    changed = injector.apply(block, positions, measured, places)
            yield Batch(block, positions, measured, torque, changed)

    def _answer(self, batch: Batch, result: ReplayResult) -> Answers:
        """Run the monitor over a block's measurements."""
        with result.stage('recursion'):
            answers = take_all(self._monitor, batch.measured, batch.torque, result.rejected)
        stamp = batch.measured.stamp
        result.measurements += len(stamp)
        result.answered += int(answers.answered.sum())
        if result.first_stamp is None and len(stamp):
            result.first_stamp = int(stamp[0])
        for row, event in answers.events:
            alarm = RecordedAlarm(**vars(event), stamp=int(stamp[row]))
            result.events.append(alarm)
            self._on_event(alarm, (alarm.stamp - (result.first_stamp or 0)) / NANOSECONDS)
        return answers


def _check(bag: str | Path, inputs: _Inputs, result: ReplayResult) -> None:
    if not result.measurements:
        raise BagError(f'{bag}: holds no message on {inputs.measured} in the chosen interval')


def _of(block: Any, connections: Sequence[Connection], topic: str) -> np.ndarray:
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
    raise BagError(f'{reader.paths[0]}: {text}')


def _limits(reader: BagReader, options: ReplayOptions) -> tuple[int | None, int | None]:
    """First log time, and first one after the end [ns]; None without limits."""
    for name in ('start', 'end'):
        value = getattr(options, name)
        if value is not None and not 0.0 <= value < 1e9:
            raise ConfigError(name, f'must be a number of seconds from 0, got {value}')
    if options.start is not None and options.end is not None and options.end <= options.start:
        raise ConfigError('end', 'must be after the start')
    return reader.log_time(options.start), reader.log_time(options.end)
