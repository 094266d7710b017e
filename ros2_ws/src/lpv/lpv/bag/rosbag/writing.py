"""Writing of rosbag2 bags: MCAP files by the mcap package, with metadata.yaml."""

import contextlib
import json
import os
import resource
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mcap.writer
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex, Schema
from mcap.writer import CompressionType, Writer
from rosbags import interfaces
from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos
from rosbags.rosbag2.metadata import dump_qos_v9

from lpv.bag.blocks.message_blocks import RECORD, Block, from_rows
from lpv.bag.rosbag import metadata
from lpv.bag.rosbag.interfaces import add_type, decode, padded_cdr, standard_types
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.support.config import write_whole
from lpv.core.support.errors import ConfigError

PRESETS = {
    'none': (CompressionType.NONE, 1 << 20, 0),
    'zstd_fast': (CompressionType.ZSTD, 1 << 20, 1),
    'zstd_small': (CompressionType.ZSTD, 1 << 22, 3),
}
"""Compression, size of a chunk [bytes] and level by name: mcap's default, that of
rosbag2_storage_mcap.  At level 1 a replay's answers take as much room as at 3, measurements alone
a tenth more, in half the time."""
_level: ContextVar[int] = ContextVar('level', default=3)
"""Of the chunk that is being written in this thread: mcap's writer knows this one only."""
mcap.writer.zstandard = SimpleNamespace(  # type: ignore[assignment]
    compress=lambda data: zstandard.compress(data, _level.get())
)


class _Output:
    """A file that takes whole writes or nothing: half a record would hide those after it."""

    def __init__(self, path: Path) -> None:
        self.file = open(path, 'xb', buffering=0)  # noqa: SIM115
        self.size = 0

    def write(self, data: bytes) -> None:
        left = memoryview(data)
        try:
            while left:
                left = left[self.file.write(left) :]
        except OSError:
            with contextlib.suppress(OSError):  # the first one says what is wrong
                self.file.truncate(self.size)
                self.file.seek(self.size)
            raise
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Everything is with the operating system already."""


class _Index(MessageIndex):
    """Log times and offsets of the messages of one channel, as an array."""

    def write(self, stream: RecordBuilder) -> None:
        data = np.asarray(self.records, '<u8').tobytes()
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(data))
        stream.write(data)
        stream.finish_record()


class _File(Writer):
    """One file by mcap's writer, which takes whole chunks, too: a call a message is far slower."""

    def __init__(self, path: Path, preset: str) -> None:
        compression, size, self._level = PRESETS[preset]
        self.name, self.output = path.name, _Output(path)
        super().__init__(self.output, size, compression)  # type: ignore[arg-type]
        self.chunk = self._Writer__chunk_builder  # type: ignore[attr-defined]
        self.chunks = self._Writer__chunk_indices  # type: ignore[attr-defined]
        self.statistics = self._Writer__statistics  # type: ignore[attr-defined]
        self.channels: dict[str, int] = {}
        self._schemas = {('', '', b''): 0}  # a topic without schema
        self.start('ros2', 'lpv.bag')

    @property
    def content(self) -> metadata.Content:
        """What has been written so far."""
        found = self.statistics
        counts = {t: found.channel_message_counts.get(n, 0) for t, n in self.channels.items()}
        span = found.message_start_time, found.message_end_time, found.message_count
        return metadata.Content((self.name, *span), Counter(counts), self.output.size)

    def define(self, topic: Connection) -> None:
        kind, text = topic.msgdef
        schema = topic.msgtype, metadata.DEFINITIONS.get(kind, ''), text.encode()
        if isinstance(own := topic.owner, Schema):  # it may be of any kind
            schema = own.name, own.encoding, own.data
        if schema not in self._schemas:
            self._schemas[schema] = self.register_schema(*schema)
        qos = metadata.dump(dump_qos_v9(metadata.offered_qos(topic))).strip()
        about = {'offered_qos_profiles': qos, 'topic_type_hash': topic.digest}
        how = metadata.encoding_of(topic), self._schemas[schema], about
        self.channels[topic.topic] = self.register_channel(topic.topic, *how)

    def _Writer__finalize_chunk(self) -> None:  # noqa: N802
        """End a chunk, as mcap's writer does, at this file's level."""
        before = _level.set(self._level)
        try:
            super()._Writer__finalize_chunk()  # type: ignore[misc]
        finally:
            _level.reset(before)

    def add_chunk(self, parts: Sequence[Block]) -> None:
        """Write one chunk of records, whose channels are the blocks' connections."""
        self.flush()
        chunk, statistics = self.chunk, self.statistics
        channels = np.concatenate([part.connection for part in parts])
        times = np.concatenate([part.time for part in parts])
        starts = np.cumsum([chunk.count] + [len(part.data) for part in parts[:-1]])
        places = np.concatenate([s + p.start - RECORD.itemsize for s, p in zip(starts, parts)])
        for part in parts:
            chunk.record_writer.write(part.data.data)
        for channel in np.unique(channels).tolist():
            mine = channels == channel
            pairs = np.column_stack([times[mine], places[mine]])
            chunk.message_indices[channel] = _Index(channel, pairs)  # type: ignore[arg-type]
            statistics.channel_message_counts[channel] += len(pairs)
        low, high, known = int(times.min()), int(times.max()), statistics.message_count
        chunk.message_start_time, chunk.message_end_time = low, high
        chunk.num_messages = len(times)
        statistics.message_start_time = min(low, statistics.message_start_time) if known else low
        statistics.message_end_time = max(high, statistics.message_end_time)
        statistics.message_count += len(times)
        self.flush()


class BagWriter:
    """A bag written topic by topic; ConfigError if it exists, or is not whole after a ``with``.

    A ``with`` that ends by an exception leaves no bag.
    """

    def __init__(
        self,
        path: str | Path,
        preset: str = 'none',  # of `PRESETS`
        split_size: int = 0,  # of a file [bytes]; 0: not limited
        split_time: int = 0,  # of a file by log times [ns]
        chunk_time: int = 0,  # chunks end at its multiples: they depend on messages alone [ns]
        fsync: bool = False,  # wait after each chunk until it is on the disk
        custom_data: dict[str, str] | None = None,
    ) -> None:
        self.path, self._preset, self._fsync = Path(path), preset, fsync
        self.typestore = standard_types()
        self._split_size, self._split_time = split_size, split_time
        self._chunk_time, self._custom = chunk_time, dict(custom_data or {})
        self._slot: int | None = None
        self._topics: dict[str, Connection] = {}
        self._done: list[metadata.Content] = []  # no files: these hold the index of every chunk
        self._closed = False
        self._failure: OSError | None = None  # the first one
        try:
            self.path.mkdir(parents=True)
            self._begin_file()
        except FileExistsError:
            raise ConfigError('bag', 'cannot be written: it exists already', str(path)) from None
        except OSError as error:
            raise ConfigError('bag', f'cannot be written: {error}', str(path)) from error

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, kind: object, error: BaseException | None, _: object) -> None:
        missing = self.close()
        if error is not None:  # half a bag looks like a whole one, and would block the next try
            shutil.rmtree(self.path, ignore_errors=True)
        if missing and error in (None, self._failure):
            raise ConfigError('bag', f'cannot be written as a whole: {missing}', str(self.path))

    @property
    def files(self) -> int:
        return len(self._contents())

    def _contents(self) -> list[metadata.Content]:
        is_done = self._file.output.file.closed
        return self._done if is_done else [*self._done, self._file.content]

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, by topic."""
        contents = self._contents()
        return {topic: sum(one.counts[topic] for one in contents) for topic in self._topics}

    @property
    def size(self) -> int:
        """Bytes handed to the operating system, of all files."""
        return sum(content.size for content in self._contents())

    def add_topic(self, topic: str, msgtype: str, profiles: Sequence[Qos] = ()) -> None:
        """Announce a topic by its full name and type, with the QoS that its publishers offer."""
        self._add(self.describe(topic, msgtype, profiles))

    def describe(self, topic: str, msgtype: str, profiles: Sequence[Qos] = ()) -> Connection:
        """A topic as `add_topic` announces it; raises where its type cannot be recorded."""
        add_type(self.typestore, msgtype)
        text = self.typestore.generate_msgdef(msgtype, ros_version=2)[0]
        definition = interfaces.MessageDefinition(interfaces.MessageDefinitionFormat.MSG, text)
        digest, ext = self.typestore.hash_rihs01(msgtype), ConnectionExtRosbag2('cdr', [*profiles])
        return Connection(0, topic, msgtype, definition, digest, 0, ext, None)

    def copy_topic(self, connection: Connection) -> None:
        """Announce a topic as another bag has it, with its own message definition."""
        topic, msgtype = connection.topic, connection.msgtype
        known = self._topics.get(topic)
        if known is not None and known.msgtype != msgtype:
            reason = f'{topic} has two types, {known.msgtype} and {msgtype}'
            raise ConfigError('topic', reason, str(self.path))
        if known is None:
            if not connection.msgdef.data and metadata.encoding_of(connection) == 'cdr':
                # As in bags of older distributions; its type may not be installed here.
                with contextlib.suppress(ConfigError):
                    profiles = metadata.offered_qos(connection)
                    connection = self.describe(topic, msgtype, profiles)
            self._add(connection)

    def _add(self, topic: Connection) -> None:
        self._topics[topic.topic] = topic
        with self._noting():
            self._file.define(topic)

    def channel(self, topic: str) -> int:
        """Number of an announced topic in the records of `write_chunk`."""
        return self._file.channels[topic]

    def without_garbage(self, msgtype: str, data: bytes) -> bytes:
        """A serialised message with zeros between fields, where some leave old memory."""
        if len(data) < 4 or not data[1] & 1:
            return data
        try:
            message = decode(self.typestore, data, msgtype)
            return padded_cdr(self.typestore, message, msgtype)
        except Exception:  # many kinds; such a message is recorded as it came
            return data

    def write(self, topic: str, timestamp: int, message: object) -> None:
        """Serialise and write a message of this bag's typestore, as of `write_raw`."""
        data = padded_cdr(self.typestore, message, self._topics[topic].msgtype)
        self.write_raw(topic, timestamp, data)

    def write_joint_states(
        self, topic: str, names: Iterable[str], samples: Iterable[tuple[Any, ...]]
    ) -> int:
        """Write stamps [ns], positions, rates and efforts on a new topic; how many messages."""
        self.add_topic(topic, 'sensor_msgs/msg/JointState', [metadata.qos_profile(True, False, 10)])
        messages, joints, count = BagMessages(self.typestore, 'base_link'), list(names), 0
        for stamp, *values in samples:
            self.write(topic, stamp, messages.joint_state(stamp, joints, *values))
            count += 1
        return count

    def write_raw(
        self, topic: str, timestamp: int, data: bytes, publish_time: int | None = None
    ) -> None:
        """Write CDR with log and publication time [ns]; OSError if the disk does not take it."""
        published = timestamp if publish_time is None else publish_time
        with self._noting():
            self._advance(timestamp)
            self._file.add_message(self._file.channels[topic], timestamp, data, published)

    def _advance(self, timestamp: int) -> None:
        """End chunks and begin files where they are due, before a message of this time."""
        if self._chunk_time:
            slot = timestamp // self._chunk_time
            if self._slot is not None and slot > self._slot:
                self.flush()
            self._slot = max(slot, self._slot or slot)
        file, statistics = self._file, self._file.statistics
        large = self._split_size and file.output.size + file.chunk.count >= self._split_size
        span = timestamp - statistics.message_start_time if statistics.message_count else 0
        if large or (self._split_time and span >= self._split_time):
            self._finish_file()
            if self._failure:
                raise self._failure
            self._begin_file()

    def write_chunk(self, *parts: Block | np.ndarray) -> None:
        """Write a chunk of blocks by numbers of channels, or of a replay's `RecordTemplate`."""
        blocks = [p if isinstance(p, Block) else from_rows(p) for p in parts if len(p)]
        with self._noting():
            if blocks:
                self._file.add_chunk(blocks)

    def flush(self) -> None:
        """Pass everything to the operating system: a later crash does not lose it."""
        with self._noting():
            self._file.flush()
            self._sync()

    def _sync(self) -> None:
        if self._fsync:
            os.fsync(self._file.output.file.fileno())

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """Keep the first error, after which files are only closed.

        What is in a file stays; mcap's writer cannot go on from a chunk that was refused.
        """
        try:
            yield
        except OSError as error:
            self._failure = self._failure or error
            raise

    def room(self) -> int:
        """Bytes that can be written while there is still room for the summary."""
        disk, output = os.statvfs(self.path), self._file.output
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        room = disk.f_bavail * disk.f_frsize
        if limit != resource.RLIM_INFINITY:
            room = min(room, limit - output.size)
        topics = sum(1000 + 2 * len(topic.msgdef.data) for topic in self._topics.values())
        chunks = len(self._file.chunks) * (100 + 10 * len(self._topics))
        return room - self._file.chunk.count - 2 * topics - chunks

    def _begin_file(self) -> None:
        name = self.path.resolve().name
        if self._split_size or self._split_time:
            name += f'_{len(self._done)}'
        self._file = _File(self.path / f'{name}.mcap', self._preset)
        for topic in self._topics.values():
            self._file.define(topic)

    def _finish_file(self) -> None:
        """End the file, unless it failed before; what is in it is counted."""
        file = self._file
        if file.output.file.closed:
            return
        with contextlib.suppress(OSError), self._noting():
            if not self._failure:
                file.flush()
                about = metadata.dump(self._information(file.content)).strip()
                file.add_metadata('rosbag2', {'serialized_metadata': about})
                file.finish()
                self._sync()
        with contextlib.suppress(OSError), self._noting():
            file.output.file.close()
        self._done.append(file.content)

    def _information(self, *contents: metadata.Content) -> dict[str, Any]:
        return metadata.bag_information(contents, self._topics.values(), self._custom)

    def close(self, known: metadata.Known | None = None) -> str:
        """Finish files and metadata; '', or what could not be written; may be called again."""
        if self._closed:
            return ''
        if known:
            text = json.dumps(known, sort_keys=True, separators=(',', ':'))
            self._custom[metadata.RECORD_NAME] = text
        self._finish_file()
        self._closed = True
        if self._failure:
            return f'its last messages or its end ({self._failure.strerror or self._failure})'
        text = metadata.dump({'rosbag2_bagfile_information': self._information(*self._done)})
        try:
            write_whole(self.path / metadata.FILE_NAME, text, self._fsync)
        except OSError as error:
            return f'{metadata.FILE_NAME} ({error.strerror})'
        return ''
