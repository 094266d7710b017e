"""Offline run of the diagnosis over a recorded bag, with the node's own code."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.message_blocks import read_blocks
from lpv_bag.blocks.prefetch import Behind, ahead
from lpv_bag.replay.answer_rows import take_all
from lpv_bag.replay.injection import CHANGED, BlockInjector
from lpv_bag.replay.session import Batch, ReplayOptions, ReplayResult
from lpv_bag.replay.writer import ReplayWriter
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.measurements import MEASUREMENT_TYPE, MeasurementReader
from lpv_bag.run.record import BagError, find_topic, open_bag
from lpv_bag.run.stream_tap import StreamTap
from lpv_bag.run.streams import RecordedAlarm
from lpv_bag.run.torque_reader import EFFORT_TYPES, EffortReader
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.factory import Monitor
from lpv_core.simulation.faults import FaultInjector
from lpv_core.support.errors import ConfigError
from lpv_core.support.timestamps import NANOSECONDS

_COMMAND = ('torque_command', 'lpv_msgs/msg/TorqueCommand')


class Replay:
    """Runs a monitor over a bag and writes a bag with its answers.

    Parameters
    ----------
    monitor : Monitor
        Fresh observer and diagnosis.
    options : ReplayOptions, optional
        What to read and to write.
    injector : FaultInjector, optional
        Faults to add to the measurements, to see what the diagnosis makes of them.
    on_event : callable, optional
        Called with every alarm event, and its time since the first measurement [s].
    **changes
        Fields of ``options`` by name.
    """

    def __init__(
        self,
        monitor: Monitor,
        options: ReplayOptions | None = None,
        injector: FaultInjector | None = None,
        on_event: Callable[[RecordedAlarm, float], None] | None = None,
        **changes: Any,
    ) -> None:
        self._monitor, self._injector = monitor, injector
        self._options = replace(options or ReplayOptions(), **changes)
        self._on_event = on_event or (lambda event, time: None)

    def run(self, bag: str | Path, out: str | Path) -> ReplayResult:
        """Replay one bag.

        All topics are copied unless the options say otherwise, except earlier answers of the
        same monitor, which are replaced.

        Parameters
        ----------
        bag, out : str or pathlib.Path
            Bag to read, bag to create.

        Returns
        -------
        ReplayResult
            What was found.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks measurements.
        ConfigError
            If the new bag cannot be made.
        """
        result = ReplayResult()
        with open_bag(bag) as reader:
            inputs = self._inputs(reader)
            writer = ReplayWriter(out, self._monitor, inputs.prefix, self._options.preset)
            try:
                writer.announce(reader.connections, not self._options.estimates_only)
                self._run(reader, inputs, writer, result)
                if not result.measurements:
                    raise _nothing(bag, inputs)
                if not result.answered and result.rejected:
                    raise _unusable(bag, result)
                with result.stage('writing'):
                    writer.close()
            except BaseException:
                # Half a bag looks like a whole one, and would block the next try.
                writer.abandon()
                shutil.rmtree(out, ignore_errors=True)
                raise
        return result

    def watch(
        self, bag: str | Path, take: Callable[..., Any], streams: Sequence[str] = ()
    ) -> ReplayResult:
        """Run over one bag and write nothing.

        Parameters
        ----------
        bag : str or pathlib.Path
            Bag to read.
        take : callable
            Called with measurements, answers, and other streams as of `StreamTap.read`, block by
            block.
        streams : sequence of str, optional
            Other streams of the bag, names of `lpv_bag.run.record.STREAMS`.

        Returns
        -------
        ReplayResult
            What was found.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks measurements.
        """
        result = ReplayResult()
        with open_bag(bag) as reader:
            inputs = self._inputs(reader)
            tap = StreamTap(reader, inputs.prefix, streams)
            result.topic, result.streams = inputs.measured, tap.present
            for batch in ahead(self._batches(reader, inputs, tap, result)):
                answers = self._answer(batch, result)
                take(batch.measured, answers, tap.read(batch.block))
            result.warnings = list(reader.warnings)
            result.lost = int(reader.known.get(inputs.measured, {}).get('lost', 0))
        if not result.measurements:
            raise _nothing(bag, inputs)
        return result

    def _answer(self, batch: Batch, result: ReplayResult) -> Answers:
        result.measurements += len(batch.positions)
        stamps = batch.measured.stamp
        if result.first_stamp is None and len(stamps):
            result.first_stamp = int(stamps[0])
        with result.stage('recursion'):
            answers = take_all(self._monitor, batch.measured, batch.torque, result.rejected)
        result.answered += int(np.count_nonzero(answers.answered))
        for row, event in answers.events:
            result.events.append(RecordedAlarm(**vars(event), stamp=int(stamps[row])))
            since = (stamps[row] - result.first_stamp) / NANOSECONDS
            self._on_event(result.events[-1], float(since))
        return answers

    def _run(
        self, reader: BagReader, inputs: '_Inputs', writer: ReplayWriter, result: ReplayResult
    ) -> None:
        with Behind(lambda batch, answers: writer.write(batch, answers, result)) as write:
            for batch in ahead(self._batches(reader, inputs, writer, result)):
                write(batch, self._answer(batch, result))

    def _inputs(self, reader: BagReader) -> '_Inputs':
        options = self._options
        measured = find_topic(reader, MEASUREMENT_TYPE, 'joint_states', options.topic).topic
        prefix = measured.rsplit('/', 1)[0]
        self._monitor.name = f'{prefix}/uio'
        effort = None
        if options.effort_topic:
            effort = _effort_connection(reader, options.effort_topic)
        elif options.torque_from_command:
            effort = find_topic(reader, _COMMAND[1], _COMMAND[0], f'{prefix}/{_COMMAND[0]}')
        return _Inputs(prefix, measured, effort and effort.topic, effort and effort.msgtype)

    def _batches(
        self,
        reader: BagReader,
        inputs: '_Inputs',
        writer: ReplayWriter | StreamTap,
        result: ReplayResult,
    ) -> Iterator[Batch]:
        """Blocks of the bag with the measurements in them, decoded."""
        options, joints = self._options, self._monitor.arm.joint_names
        kept = [
            c
            for c in reader.connections
            if c.topic in (inputs.measured, inputs.effort) or writer.is_copied(c)
        ]
        is_measured = np.array([c.topic == inputs.measured for c in kept])
        is_effort = np.array([c.topic == inputs.effort for c in kept])
        measurements = MeasurementReader(reader, joints, self._monitor.needs_rates)
        efforts = injector = None
        if inputs.effort_type:
            efforts = EffortReader(reader, inputs.effort_type, joints)
        if self._injector is not None:
            injector = BlockInjector(self._injector, self._monitor)
        blocks = read_blocks(reader, kept, *_limits(reader, options), fast=options.fast)
        while True:
            with result.stage('reading'):
                block = next(blocks, None)
            if block is None:
                return
            with result.stage('decoding'):
                positions = np.flatnonzero(is_measured[block.connection])
                measured = measurements.read(block, positions)
                torque = None
                if efforts is not None:
                    torque = efforts.before(
                        block, np.flatnonzero(is_effort[block.connection]), positions
                    )
                    result.rejected.update(efforts.rejected)
                    efforts.rejected.clear()
                changed = {}
                if injector is not None:
                    changed = injector.apply(
                        block,
                        positions,
                        measured,
                        {name: measurements.places(block, positions, name) for name in CHANGED},
                    )
                batch = Batch(
                    block, positions, measured, torque, *writer.choose(reader, kept, block), changed
                )
            yield batch


@dataclass(frozen=True)
class _Inputs:
    prefix: str
    measured: str
    effort: str | None
    effort_type: str | None


def _nothing(bag: str | Path, inputs: '_Inputs') -> BagError:
    return BagError(f'{bag}: holds no message on {inputs.measured} in the chosen interval')


def _unusable(bag: str | Path, result: ReplayResult) -> BagError:
    (reason, count), *_ = result.rejected.most_common(1)
    return BagError(
        f'{bag}: none of its {result.measurements} measurements can be used '
        f'({count} of them: {reason})'
    )


def _effort_connection(reader: BagReader, topic: str) -> Connection:
    found = [c for c in reader.connections if c.topic == topic]
    if not found:
        there = ', '.join(sorted(c.topic for c in reader.connections if c.msgtype in EFFORT_TYPES))
        raise BagError(
            f'{reader.paths[0]}: the bag has no topic {topic!r}; topics that may carry '
            f'torques are {there or "missing"}'
        )
    if found[0].msgtype not in EFFORT_TYPES:
        raise BagError(
            f'{reader.paths[0]}: {topic} is of type {found[0].msgtype}; torques can be '
            f'read from ' + ', '.join(EFFORT_TYPES)
        )
    return found[0]


def _limits(reader: BagReader, options: ReplayOptions) -> tuple[int | None, int | None]:
    """First log time, and first one after the end [ns]; None without limits."""
    for name in ('start', 'end'):
        value = getattr(options, name)
        if value is not None and not 0.0 <= value < 1e9:
            raise ConfigError(name, f'must be a number of seconds from 0, got {value}')
    if options.start is not None and options.end is not None and options.end <= options.start:
        raise ConfigError('end', 'must be after the start')
    return reader.log_time(options.start), reader.log_time(options.end)
