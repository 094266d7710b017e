"""Writing of rosbag2 bags: MCAP files with metadata.yaml, in the ros2 profile."""

import os
import resource
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat, Qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lpv_bag.mcap.writer import McapWriter
from lpv_bag.rosbag.interfaces import add_type, decode, make_typestore
from lpv_bag.rosbag.message_loss import RECORD_NAME, Known, as_metadata, as_text
from lpv_bag.rosbag.metadata import FILE_NAME, bag_information, dump, qos_data
from lpv_bag.rosbag.offered_qos import offered_qos, qos_profile
from lpv_core.support.errors import ConfigError

__all__ = ['BagWriter', 'qos_profile']


class _Topic(NamedTuple):
    name: str
    msgtype: str
    encoding: str
    definition: bytes
    profiles: tuple[Qos, ...]
    digest: str


class FinishedFile(NamedTuple):
    """A finished file: name, first and last log time, messages by topic, bytes."""

    name: str
    start: int
    end: int
    counts: dict[str, int]
    size: int

    @property
    def span(self) -> tuple[str, int, int, int]:
        return self.name, self.start, self.end, sum(self.counts.values())


class BagWriter:
    """A bag that is written topic by topic.

    Parameters
    ----------
    path : str or pathlib.Path
        Directory to create.
    preset : str, optional
        Compression, a key of `lpv_bag.mcap.writer.PRESETS`.
    split_size : int, optional
        Size at which a new file is begun [bytes]; 0 for never.
    split_time : int, optional
        Span of log times at which a new file is begun [ns]; 0 for never.
    chunk_time : int, optional
        A chunk is cut when log times enter the next multiple of this [ns]; 0 for never.  What a
        chunk holds then depends on the messages alone, not on when they came.
    fsync : bool, optional
        Wait after each chunk until it is on the disk.

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
    ) -> None:
        self.path = Path(path)
        self.typestore = make_typestore()
        self._preset, self._fsync = preset, fsync
        self._split_size, self._split_time = split_size, split_time
        self._chunk_time = chunk_time
        self._slot: int | None = None
        self._topics: dict[str, _Topic] = {}
        self._channels: dict[str, int] = {}
        self._files: list[FinishedFile] = []
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._first: int | None = None
        self._closed, self._finished = False, True
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
        """Announce a topic.

        Parameters
        ----------
        topic : str
            Full name.
        msgtype : str
            Message type.
        profiles : sequence of rosbags.interfaces.Qos, optional
            Offered QoS of its publishers.
        """
        self.check_type(msgtype)
        definition = self.typestore.generate_msgdef(msgtype, ros_version=2)[0]
        self._add(
            _Topic(
                topic,
                msgtype,
                'ros2msg',
                definition.encode(),
                tuple(profiles),
                self.typestore.hash_rihs01(msgtype),
            )
        )

    def copy_topic(self, connection: Connection) -> None:
        """Announce a topic as another bag has it, with its own message definition."""
        known = self._topics.get(connection.topic)
        if known is not None:
            if known.msgtype != connection.msgtype:
                raise ConfigError(
                    'topic',
                    f'{connection.topic} has two types, {known.msgtype} and {connection.msgtype}',
                    str(self.path),
                )
            return
        kind, definition = connection.msgdef
        if not definition:  # bags of older distributions carry no definitions
            self.add_topic(connection.topic, connection.msgtype, offered_qos(connection))
            return
        encoding = 'ros2msg' if kind == MessageDefinitionFormat.MSG else 'ros2idl'
        self._add(
            _Topic(
                connection.topic,
                connection.msgtype,
                encoding,
                definition.encode(),
                tuple(offered_qos(connection)),
                connection.digest or _hash(connection),
            )
        )

    def _add(self, topic: _Topic) -> None:
        self._topics[topic.name] = topic
        self.counts[topic.name] = 0
        self._define(topic)

    def _define(self, topic: _Topic) -> None:
        schema = (topic.msgtype, topic.definition)
        if schema not in self._schemas:
            self._schemas[schema] = self._file.add_schema(
                topic.msgtype, topic.encoding, topic.definition
            )
        self._channels[topic.name] = self._file.add_channel(
            topic.name,
            self._schemas[schema],
            {
                'offered_qos_profiles': dump(qos_data(topic.profiles)).strip(),
                'topic_type_hash': topic.digest,
            },
        )

    # -------------------------------------------------------------- messages

    def without_garbage(self, msgtype: str, data: bytes) -> bytes:
        """A serialised message with zeros between its fields.

        What is there has no meaning, and some serialisers leave there what was in memory.
        """
        if len(data) < 4 or not data[1] & 1:
            return data
        try:
            message = decode(self.typestore.deserialize_cdr, data, msgtype)
            return _padded(bytes(self.typestore.serialize_cdr(message, msgtype)))
        except Exception:  # many kinds; such a message is recorded as it came
            return data

    def write_raw(
        self, topic: str, timestamp: int, data: bytes, publish_time: int | None = None
    ) -> None:
        """Write a serialised message.

        Parameters
        ----------
        topic : str
            Announced topic.
        timestamp : int
            Log time [ns].
        data : bytes
            CDR.
        publish_time : int, optional
            When it was published [ns]; the log time if not given.

        Raises
        ------
        OSError
            If the disk is full, or does not take what is written for another reason.
        """
        self._advance(timestamp)
        self.counts[topic] += 1
        self._file.write(
            self._channels[topic],
            timestamp,
            data,
            timestamp if publish_time is None else publish_time,
            self.counts[topic] & 0xFFFFFFFF,
        )

    def _advance(self, timestamp: int) -> None:
        """End chunks and begin files where they are due, before a message of this time."""
        if self._first is None:
            self._first = timestamp
        if self._chunk_time:
            slot = timestamp // self._chunk_time
            if self._slot is not None and slot > self._slot:
                self.flush()
            self._slot = slot if self._slot is None else max(slot, self._slot)
        if (
            self._split_size
            and self._file.size + self._file.pending >= self._split_size
            or self._split_time
            and timestamp - self._first >= self._split_time
        ):
            self.split()
            self._first = timestamp

    def write(self, topic: str, timestamp: int, message: object) -> None:
        """Serialise and write a message of this bag's typestore.

        Parameters
        ----------
        topic : str
            Announced topic.
        timestamp : int
            Log time [ns].
        message : object
            Message of ``typestore.types``.
        """
        data = bytes(self.typestore.serialize_cdr(message, self._topics[topic].msgtype))
        self.write_raw(topic, timestamp, _padded(data))

    def flush(self) -> None:
        """Pass everything to the operating system: a later crash does not lose it."""
        self._file.cut()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store a metadata record in the present file."""
        self._file.add_metadata(name, values)

    @property
    def size(self) -> int:
        """Bytes handed to the operating system, of all files."""
        return (0 if self._finished else self._file.size) + sum(file.size for file in self._files)

    @property
    def files(self) -> int:
        """Number of files so far."""
        return len(self._files) + (not self._finished)

    def room(self) -> int:
        """Bytes that can be written while there is still room for the summary."""
        disk = os.statvfs(self.path)
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        room = disk.f_bavail * disk.f_frsize
        if limit != resource.RLIM_INFINITY:
            room = min(room, limit - self._file.size)
        return room - 2 * self._file.tail_size - self._file.pending

    # -------------------------------------------------------------- files

    def _begin_file(self) -> None:
        name = self.path.resolve().name
        if self._split_size or self._split_time:
            name += f'_{len(self._files)}'
        self._file = McapWriter(self.path / f'{name}.mcap', self._preset, self._fsync)
        self._schemas, self._channels, self._finished = {}, {}, False
        for topic in self._topics.values():
            self._define(topic)

    def split(self) -> None:
        """Finish the file and begin the next one."""
        self._finish_file({})
        self._begin_file()

    def _finish_file(self, known: Known) -> str:
        """End the file with its metadata; what is missing at its end, or ''."""
        file, missing = self._file, ''
        try:
            file.cut()
            file.add_metadata(
                'rosbag2',
                {'serialized_metadata': dump(self._information([self._entry()], known)).strip()},
            )
            if known:
                file.add_metadata(RECORD_NAME, as_metadata(known))
        except OSError as error:
            missing = f'the last messages or metadata ({error.strerror})'
        missing = file.finish() or missing
        self._files.append(self._entry())
        self._finished = True
        return missing

    def _entry(self) -> FinishedFile:
        file = self._file
        counts = {name: file.counts[channel] for name, channel in self._channels.items()}
        return FinishedFile(file.path.name, file.start, file.end, counts, file.size)

    def _information(self, files: list[FinishedFile], known: Known) -> dict[str, Any]:
        topics = [
            (
                t.name,
                t.msgtype,
                t.profiles,
                t.digest,
                sum(file.counts.get(t.name, 0) for file in files),
            )
            for t in self._topics.values()
        ]
        return bag_information(
            [file.span for file in files], topics, {RECORD_NAME: as_text(known)} if known else {}
        )

    def close(self, known: Known | None = None) -> str:
        """Finish file and metadata; may be called again.

        Parameters
        ----------
        known : dict, optional
            What is known of the recording, as of `lpv_bag.rosbag.message_loss.Counts.known`.

        Returns
        -------
        str
            '', or what could not be written for want of room.
        """
        if self._closed:
            return ''
        self._closed = True
        missing = '' if self._finished else self._finish_file(known or {})
        text = dump({'rosbag2_bagfile_information': self._information(self._files, known or {})})
        try:
            _write_whole(self.path / FILE_NAME, text, self._fsync)
        except OSError as error:
            missing = missing or f'{FILE_NAME} ({error.strerror})'
        return missing


def _padded(data: bytes) -> bytes:
    """DDS pads samples to four bytes, and so does a recorder: bags can then be compared."""
    return data + bytes(-len(data) % 4)


def _hash(connection: Connection) -> str:
    """Type hash by the bag's own definition, which single files do not store."""
    typestore = get_typestore(Stores.EMPTY)
    typestore.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    return typestore.hash_rihs01(connection.msgtype)


def _write_whole(path: Path, text: str, fsync: bool) -> None:
    """Write a file completely or not at all."""
    new = path.with_name(path.name + '.new')
    with open(new, 'w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        if fsync:
            os.fsync(file.fileno())
    os.replace(new, path)
