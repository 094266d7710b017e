"""Writing of rosbag2 bags: MCAP files by the mcap package, with metadata.yaml."""

import json
import os
import resource
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Connection, MessageDefinitionFormat, Qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lpv_bag.blocks.message_blocks import RECORD, Block, from_rows
from lpv_bag.rosbag.interfaces import add_type, decode, make_typestore
from lpv_bag.rosbag.message_loss import RECORD_NAME, Known
from lpv_bag.rosbag.metadata import FILE_NAME, bag_information, dump, qos_text
from lpv_bag.rosbag.offered_qos import offered_qos, qos_profile
from lpv_core.support.errors import ConfigError

__all__ = ['PRESETS', 'BagWriter', 'qos_profile']

PRESETS = {
    'none': (CompressionType.NONE, 1 << 20),
    'zstd_fast': (CompressionType.ZSTD, 1 << 20),
    'zstd_small': (CompressionType.ZSTD, 1 << 22),
}
"""Compression and size of a chunk [bytes] by name."""


class _Topic(NamedTuple):
    name: str
    msgtype: str
    encoding: str
    definition: str
    profiles: tuple[Qos, ...]
    digest: str


class _Output:
    """A file that takes what is written as a whole or not at all.

    Half a record, of a disk that gets full, would hide the records after it.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, 'xb', buffering=0)  # noqa: SIM115
        self.size = 0

    def write(self, data: bytes) -> None:
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Everything is with the operating system already."""

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()


class _Index(MessageIndex):
    """Log times and offsets of the messages of one channel, as an array."""

    def write(self, stream: RecordBuilder) -> None:
        data = np.asarray(self.records, '<u8').tobytes()
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(data))
        stream.write(data)
        stream.finish_record()


class _McapWriter(Writer):
    """The writer of the mcap package, which takes whole chunks as well.

    A call for each message would take a minute for an hour of answers.
    """

    def add_chunk(self, parts: Sequence[Block]) -> None:
        """Write one chunk of records, whose channels are the blocks' connections."""
        self.flush()
        builder, statistics = self._Writer__chunk_builder, self._Writer__statistics  # type: ignore[attr-defined]
        channels = np.concatenate([part.connection for part in parts])
        times = np.concatenate([part.time for part in parts])
        starts = np.cumsum([builder.count] + [len(part.data) for part in parts[:-1]])
        places = np.concatenate([s + p.start - RECORD.itemsize for s, p in zip(starts, parts)])
        for part in parts:
            builder.record_writer.write(part.data.data)
        for channel in np.unique(channels).tolist():
            mine = channels == channel
            pairs = np.column_stack([times[mine], places[mine]])
            builder.message_indices[channel] = _Index(channel, pairs)  # type: ignore[arg-type]
            statistics.channel_message_counts[channel] += len(pairs)
        low, high, known = int(times.min()), int(times.max()), statistics.message_count
        builder.message_start_time, builder.message_end_time = low, high
        builder.num_messages = len(times)
        statistics.message_start_time = min(low, statistics.message_start_time) if known else low
        statistics.message_end_time = max(high, statistics.message_end_time)
        statistics.message_count += len(times)
        self.flush()


class BagWriter:
    """A bag that is written topic by topic.

    Parameters
    ----------
    path : str or pathlib.Path
        Directory to create.
    preset : str, optional
        Compression, a key of `PRESETS`.
    split_size : int, optional
        Size at which a new file is begun [bytes]; 0 for never.
    split_time : int, optional
        Span of log times at which a new file is begun [ns]; 0 for never.
    chunk_time : int, optional
        A chunk is cut when log times enter the next multiple of this [ns]; 0 for never.  What a
        chunk holds then depends on the messages alone, not on when they came.
    fsync : bool, optional
        Wait after each chunk until it is on the disk.
    custom_data : dict of str to str, optional
        Stored in metadata.yaml.

    Attributes
    ----------
    counts : dict of str to int
        Messages written, by topic.
    typestore : rosbags typestore
        Of the types that are known.

    Raises
    ------
    ConfigError
        If it exists already or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        preset: str = 'none',
        split_size: int = 0,
        split_time: int = 0,
        chunk_time: int = 0,
        fsync: bool = False,
        custom_data: dict[str, str] | None = None,
    ) -> None:
        self.path, self._preset, self._fsync = Path(path), preset, fsync
        self.typestore = make_typestore()
        self._split_size, self._split_time = split_size, split_time
        self._chunk_time, self._custom = chunk_time, dict(custom_data or {})
        self._slot: int | None = None
        self._topics: dict[str, _Topic] = {}
        self._files: list[tuple[str, int, int, int]] = []  # name, times, messages of each
        self._written = 0  # bytes of the files before
        self._closed, self._failure = False, ''
        self.counts: dict[str, int] = {}
        try:
            self.path.mkdir(parents=True)
            self._begin_file()
        except FileExistsError:
            raise ConfigError('bag', 'cannot be written: it exists already', str(path)) from None
        except OSError as error:
            raise ConfigError('bag', f'cannot be written: {error}', str(path)) from error

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -------------------------------------------------------------- topics

    def check_type(self, msgtype: str) -> None:
        """Make sure that a type's definition can be stored."""
        add_type(self.typestore, msgtype)

    def add_topic(self, topic: str, msgtype: str, profiles: Sequence[Qos] = ()) -> None:
        """Announce a topic by its full name and type, with the QoS that its publishers offer."""
        self.check_type(msgtype)
        definition = self.typestore.generate_msgdef(msgtype, ros_version=2)[0]
        digest = self.typestore.hash_rihs01(msgtype)
        self._add(_Topic(topic, msgtype, 'ros2msg', definition, tuple(profiles), digest))

    def copy_topic(self, connection: Connection) -> None:
        """Announce a topic as another bag has it, with its own message definition."""
        topic, msgtype, (kind, text) = connection.topic, connection.msgtype, connection.msgdef
        known = self._topics.get(topic)
        if known is None and not text:  # bags of older distributions carry no definitions
            self.add_topic(topic, msgtype, offered_qos(connection))
        elif known is None:
            encoding = 'ros2msg' if kind == MessageDefinitionFormat.MSG else 'ros2idl'
            digest = connection.digest or _hash(connection)
            self._add(
                _Topic(topic, msgtype, encoding, text, tuple(offered_qos(connection)), digest)
            )
        elif known.msgtype != msgtype:
            raise ConfigError(
                'topic', f'{topic} has two types, {known.msgtype} and {msgtype}', str(self.path)
            )

    def _add(self, topic: _Topic) -> None:
        self._topics[topic.name] = topic
        self.counts[topic.name] = 0
        self._define(topic)

    def _define(self, topic: _Topic) -> None:
        schema = (topic.msgtype, topic.encoding, topic.definition.encode())
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(*schema)
        metadata = {
            'offered_qos_profiles': qos_text(topic.profiles),
            'topic_type_hash': topic.digest,
        }
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, 'cdr', self._schemas[schema], metadata
        )

    def channel(self, topic: str) -> int:
        """Number of an announced topic in the records of `write_chunk`."""
        return self._channels[topic]

    # -------------------------------------------------------------- messages

    def without_garbage(self, msgtype: str, data: bytes) -> bytes:
        """A serialised message with zeros between its fields.

        What is there has no meaning, and some serialisers leave there what was in memory.
        """
        if len(data) < 4 or not data[1] & 1:
            return data
        try:
            message = decode(self.typestore.deserialize_cdr, data, msgtype)
            return self._serialized(message, msgtype)
        except Exception:  # many kinds; such a message is recorded as it came
            return data

    def _serialized(self, message: object, msgtype: str) -> bytes:
        """CDR, padded to four bytes as DDS does: bags can then be compared."""
        data = bytes(self.typestore.serialize_cdr(message, msgtype))
        return data + bytes(-len(data) % 4)

    def write_raw(
        self, topic: str, timestamp: int, data: bytes, publish_time: int | None = None
    ) -> None:
        """Write a serialised message; OSError if the disk does not take it.

        Its log time [ns], CDR, and when it was published [ns], the log time if not given.
        """
        try:
            self._advance(timestamp)
            published = timestamp if publish_time is None else publish_time
            self._writer.add_message(self._channels[topic], timestamp, data, published)
        except OSError as error:
            self._fail(error)
        self.counts[topic] += 1
        self._count(timestamp, timestamp, 1)

    def _advance(self, timestamp: int) -> None:
        """End chunks and begin files where they are due, before a message of this time."""
        if self._chunk_time:
            slot = timestamp // self._chunk_time
            if self._slot is not None and slot > self._slot:
                self.flush()
            self._slot = slot if self._slot is None else max(slot, self._slot)
        _, start, _, count = self._files[-1]
        large = self._split_size and self._output.size + self._pending >= self._split_size
        late = self._split_time and count and timestamp - start >= self._split_time
        if large or late:
            self._finish_file()
            self._begin_file()

    def _count(self, first: int, last: int, count: int) -> None:
        name, start, end, before = self._files[-1]
        start, end = (min(start, first), max(end, last)) if before else (first, last)
        self._files[-1] = (name, start, end, before + count)

    def write(self, topic: str, timestamp: int, message: object) -> None:
        """Serialise and write a message of this bag's typestore, as of `write_raw`."""
        self.write_raw(topic, timestamp, self._serialized(message, self._topics[topic].msgtype))

    def write_chunk(self, *parts: Block | np.ndarray) -> None:
        """Write thousands of messages as one chunk.

        Blocks hold their messages alone, with numbers of channels as connections; arrays are
        records, as of `lpv_bag.replay.answer_records.RecordTemplate`.
        """
        blocks = [p if isinstance(p, Block) else from_rows(p) for p in parts if len(p)]
        if not blocks:
            return
        try:
            self._writer.add_chunk(blocks)
        except OSError as error:
            self._fail(error)
        counts = np.bincount(np.concatenate([block.connection for block in blocks]))
        for topic, channel in self._channels.items():
            self.counts[topic] += int(counts[channel]) if channel < len(counts) else 0
        first = min(int(block.time.min()) for block in blocks)
        last = max(int(block.time.max()) for block in blocks)
        self._count(first, last, sum(map(len, blocks)))

    def flush(self) -> None:
        """Pass everything to the operating system: a later crash does not lose it."""
        try:
            self._writer.flush()
            if self._fsync:
                self._output.sync()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        """What is in the file stays; mcap's writer cannot go on from a chunk that was refused."""
        self._failure = self._failure or error.strerror or str(error)
        raise error

    @property
    def size(self) -> int:
        """Bytes handed to the operating system, of all files."""
        return self._written + self._output.size

    @property
    def files(self) -> int:
        """Number of files so far."""
        return len(self._files)

    @property
    def _pending(self) -> int:
        return self._writer._Writer__chunk_builder.count  # type: ignore[attr-defined]

    def room(self) -> int:
        """Bytes that can be written while there is still room for the summary."""
        disk = os.statvfs(self.path)
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        room = disk.f_bavail * disk.f_frsize
        if limit != resource.RLIM_INFINITY:
            room = min(room, limit - self._output.size)
        chunks = len(self._writer._Writer__chunk_indices)  # type: ignore[attr-defined]
        topics = sum(1000 + 2 * len(topic.definition) for topic in self._topics.values())
        return room - self._pending - 2 * topics - chunks * (100 + 10 * len(self._topics))

    # -------------------------------------------------------------- files

    def _begin_file(self) -> None:
        name = self.path.resolve().name
        if self._split_size or self._split_time:
            name += f'_{len(self._files)}'
        compression, size = PRESETS[self._preset]
        self._output = _Output(self.path / f'{name}.mcap')
        self._files.append((f'{name}.mcap', 0, 0, 0))
        self._writer = _McapWriter(self._output, size, compression)  # type: ignore[arg-type]
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._before = dict(self.counts)
        self._writer.start('ros2', 'lpv_bag')
        for topic in self._topics.values():
            self._define(topic)

    def _finish_file(self) -> None:
        try:
            self._writer.flush()
            counts = {
                name: count - self._before.get(name, 0) for name, count in self.counts.items()
            }
            text = dump(self._information(self._files[-1:], counts)).strip()
            self._writer.add_metadata('rosbag2', {'serialized_metadata': text})
            self._writer.finish()
        except OSError as error:
            self._failure = error.strerror or str(error)
        self._written += self._output.size
        self._output.close()
        self._output.size = 0

    def _information(
        self, files: list[tuple[str, int, int, int]], counts: dict[str, int]
    ) -> dict[str, Any]:
        topics = [
            (t.name, t.msgtype, t.profiles, t.digest, counts[t.name]) for t in self._topics.values()
        ]
        return bag_information(files, topics, self._custom)

    def close(self, known: Known | None = None) -> str:
        """Finish file and metadata, with what is known of the recording; may be called again.

        Returns '', or what could not be written: the files then end as after a crash.
        """
        if self._closed:
            return ''
        self._closed = True
        if known:
            self._custom[RECORD_NAME] = json.dumps(known, sort_keys=True, separators=(',', ':'))
        if not self._failure:
            self._finish_file()
        if self._failure:
            self._output.close()
            return f'its last messages or its end ({self._failure})'
        text = dump({'rosbag2_bagfile_information': self._information(self._files, self.counts)})
        new = self.path / f'{FILE_NAME}.new'
        try:
            with open(new, 'w', encoding='utf-8') as file:
                file.write(text)
                file.flush()
                if self._fsync:
                    os.fsync(file.fileno())
            os.replace(new, self.path / FILE_NAME)
        except OSError as error:
            return f'{FILE_NAME} ({error.strerror})'
        return ''


def _hash(connection: Connection) -> str:
    """Type hash by the bag's own definition, which single files do not store; '' if it is none."""
    try:
        typestore = get_typestore(Stores.EMPTY)
        typestore.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return typestore.hash_rihs01(connection.msgtype)
    except Exception:  # many kinds
        return ''
