"""Offline run of the diagnosis over a recorded bag, with the node's own code."""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv_bag.replay.answer_rows import take_all
from lpv_bag.replay.injection import CHANGED, BlockInjector
from lpv_bag.replay.writer import ReplayWriter
from lpv_bag.rosbag.message_blocks import read_blocks
from lpv_bag.rosbag.prefetch import Behind, ahead
from lpv_bag.run.measurements import MEASUREMENT_TYPE, MeasurementReader
from lpv_bag.run.record import BagError, find_topic, open_bag
from lpv_bag.run.stream_tap import Bystander
from lpv_bag.run.torque_reader import EFFORT_TYPES, EffortReader
from lpv_core.observer.sampled_observer import NANOSECONDS
from lpv_core.support.errors import ConfigError

_COMMAND = ('torque_command', 'lpv_msgs/msg/TorqueCommand')


@dataclass(frozen=True)
class ReplayOptions:
    """What is replayed, and what is written."""

    topic: str = None  # topic of the measurements, where the bag has several of type JointState
    # topic of torques to use in place of the measured efforts; its type is one of
    # `lpv_bag.run.torque_reader.EFFORT_TYPES`
    effort_topic: str = None
    torque_from_command: bool = False  # take torques from the recorded commands
    # only messages in this interval, counted from the first message of the bag [s]
    start: float = None
    # only messages in this interval, counted from the first message of the bag [s]
    end: float = None
    estimates_only: bool = False  # write the answers alone; otherwise all topics are copied, too
    preset: str = 'none'  # compression of the new bag, key of `lpv_bag.mcap.writer.PRESETS`
    fast: bool = True  # false reads message by message whatever the file is like


@dataclass
class ReplayResult:
    """What a replay found."""

    measurements: int = 0  # samples read
    # reasons of samples that could not be used, with how often
    rejected: Counter = field(default_factory=Counter)
    events: list = field(default_factory=list)  # alarm events
    seconds: dict = field(default_factory=Counter)  # processor time by stage [s]
    topic: str = ''  # of the measurements
    streams: set = field(default_factory=set)  # other streams that were asked for and are there
    warnings: list = field(default_factory=list)  # what is wrong with the bag, and was put up with
    lost: int = 0  # measurements that the recorder says it has lost

    @contextmanager
    def stage(self, name):
        """Count the calling thread's processor time of a ``with`` block."""
        start = time.thread_time()
        try:
            yield
        finally:
            self.seconds[name] += time.thread_time() - start


class Replay:
    """Runs a monitor over a bag and writes a bag with what it answers.

    Parameters
    ----------
    monitor : SensorMonitor
        Fresh observer and diagnosis.
    options : ReplayOptions, optional
        What to read and to write.
    injector : FaultInjector, optional
        Faults to add to the measurements, to see what the diagnosis makes of them.
    on_event : callable, optional
        Called with every alarm event.
    **changes
        Fields of ``options`` by name.
    """

    def __init__(
        self,
        monitor,
        options: ReplayOptions | None = None,
        injector=None,
        on_event: Callable[..., Any] | None = None,
        **changes,
    ) -> None:
        self._monitor, self._injector = monitor, injector
        self._options = replace(options or ReplayOptions(), **changes)
        self._on_event = on_event or (lambda event: None)

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
            Called with measurements, answers, and other streams as of `Bystander.read`, block by
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
            bystander = Bystander(reader, inputs.prefix, streams)
            result.topic, result.streams = inputs.measured, bystander.present
            for batch in ahead(self._batches(reader, inputs, bystander, result)):
                answers = self._answer(batch, result)
                take(batch.measured, answers, bystander.read(batch.block))
            result.warnings = list(reader.warnings)
            result.lost = int(reader.known.get(inputs.measured, {}).get('lost', 0))
        if not result.measurements:
            raise _nothing(bag, inputs)
        return result

    def _answer(self, batch, result):
        result.measurements += len(batch.positions)
        with result.stage('recursion'):
            answers = take_all(self._monitor, batch.measured, batch.torque, result.rejected)
        for _, event in answers.events:
            result.events.append(event)
            self._on_event(event)
        return answers

    def _run(self, reader, inputs, writer, result) -> None:
        with Behind(lambda *parts: writer.write(*parts, result)) as write:
            for batch in ahead(self._batches(reader, inputs, writer, result)):
                write(batch, self._answer(batch, result))

    def _inputs(self, reader):
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

    def _batches(self, reader, inputs, writer, result):
        """Blocks of the bag with the measurements in them, decoded."""
        options, joints = self._options, self._monitor.arm.joint_names
        kept = [
            c
            for c in reader.connections
            if c.topic in (inputs.measured, inputs.effort) or writer.is_copied(c)
        ]
        is_measured = np.array([c.topic == inputs.measured for c in kept])
        is_effort = np.array([c.topic == inputs.effort for c in kept])
        measurements = MeasurementReader(reader, joints)
        efforts = injector = None
        if inputs.effort:
            efforts = EffortReader(reader, inputs.effort_type, joints)
        if self._injector is not None:
            injector = BlockInjector(self._injector, self._monitor)
        blocks = read_blocks(reader, kept, *_limits(reader, options), options.fast)
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
                batch = _Batch(
                    block, positions, measured, torque, *writer.choose(reader, kept, block), changed
                )
            yield batch


@dataclass(frozen=True)
class _Inputs:
    prefix: str
    measured: str
    effort: str
    effort_type: str


@dataclass
class _Batch:
    """A block, its measurements, which of its messages are copied to which channels, and measured
    messages that were changed, by row."""

    block: object
    positions: np.ndarray
    measured: object
    torque: np.ndarray
    copied: np.ndarray
    channels: np.ndarray
    changed: dict


def _nothing(bag, inputs):
    return BagError(f'{bag}: holds no message on {inputs.measured} in the chosen interval')


def _effort_connection(reader, topic):
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


def _limits(reader, options):
    """First log time and first one behind the end [ns]; None without limits."""
    for name in ('start', 'end'):
        value = getattr(options, name)
        if value is not None and not 0.0 <= value < 1e9:
            raise ConfigError(name, f'must be a number of seconds from 0, got {value}')
    if options.start is not None and options.end is not None and options.end <= options.start:
        raise ConfigError('end', 'must be behind the start')
    return tuple(
        None if value is None else reader.start_time + round(value * NANOSECONDS)
        for value in (options.start, options.end)
    )
