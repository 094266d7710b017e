"""Opening of bags: MCAP files by chunks, others by rosbags; of damaged ones what is whole."""

import contextlib
import functools
import logging
import os
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import interfaces
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, Nodetype, Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lpv.bag.blocks.message_blocks import BLOCK_SIZE, Block, joined, record, split
from lpv.bag.errors import BagError, DamageError
from lpv.bag.rosbag.interfaces import decode, standard_types
from lpv.bag.rosbag.mcap_file import McapFile, error_text
from lpv.bag.rosbag.metadata import (
    DEFINITIONS,
    FILE_NAME,
    BagMetadata,
    Known,
    encoding_of,
    offered_qos,
    read_metadata,
)
from lpv.core.support.config import read_at_most
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import MOST_BYTES
from lpv.core.support.timestamps import NANOSECONDS

_LOG = logging.getLogger(__name__)
_LARGEST_GROUP = 4 * MOST_BYTES
"""Chunks whose times overlap are sorted together up to this size [bytes]."""
_STAMP = (('std_msgs/msg/Header', ('stamp',)), ('builtin_interfaces/msg/Time', ('sec', 'nanosec')))

_UNFINISHED = 'the recording was not finished, its end may be missing ({})'
_FORMAT = interfaces.MessageDefinitionFormat
_FORMATS = {name: kind for kind, name in DEFINITIONS.items()}
_NONE = MessageDefinition(_FORMAT.NONE, '')
_IDL = '=' * 80 + '\n'
"""Before each of the definitions that a type in IDL needs."""


class BagReader:
    """A bag that is open for reading: MCAP files, or another ``source`` by rosbags."""

    def __init__(
        self,
        path: Path,
        connections: list[Connection],
        files: Sequence[McapFile] = (),
        source: AnyReader | None = None,
    ) -> None:
        self.path, self.connections, self.files, self.source = path, connections, files, source
        self.warnings: list[str] = []  # what is wrong with the bag; grows while it is read
        self.known: Known = {}  # what the recorder knew of each topic
        self.said: Counter[str] = Counter()  # messages that there should be, by topic
        self.finished = True  # whether the recording was ended in order
        self.cut: list[str] = []  # files of which an unknown number of messages is lost
        places = [place for file in files for place in file.places]
        self.start_time = min((place.start for place in places), default=2**63 - 1)
        self.end_time = max((place.end + 1 for place in places), default=0)
        if source is not None:
            self.start_time, self.end_time = source.start_time, source.end_time

    @functools.cached_property
    def typestore(self) -> Typestore:
        """Types as the bag defines them, else standard ones; BagError if they make no sense."""
        there = ((c.msgtype, c.msgdef, c.digest) for c in self.connections)
        defined = tuple(dict.fromkeys(one for one in there if one[1].format != _NONE.format))
        with damage(self.path):
            return _types_by(defined) if defined else standard_types()

    def warn(self, text: str) -> None:
        """Note, and log, what is wrong with the bag."""
        self.warnings.append(text)
        _LOG.warning('%s: %s', self.path, text)

    def log_time(self, seconds: float | None) -> int | None:
        """Log time of a moment counted from the first message [ns]; None stays None."""
        return None if seconds is None else self.start_time + round(seconds * NANOSECONDS)

    def blocks(
        self, connections: Sequence[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[Block]:
        """Messages of some topics by log time in [start, stop) [ns], thousands at once."""
        with damage(self.path):
            if self.source is None:
                last = 2**63 - 1 if stop is None else stop
                yield from self._mcap_blocks(connections, start or 0, last)
            elif connections:
                messages = self.source.messages(connections, start=start, stop=stop)
                yield from _collect(messages, connections)

    def _mcap_blocks(self, topics: Sequence[Connection], low: int, high: int) -> Iterator[Block]:
        wanted = [_wanted(file, topics) for file in self.files]
        places = sorted(
            (place.start, part, place)
            for part, file in enumerate(self.files)
            for place in file.places
            if place.end >= low and place.start < high
            if not place.channels or (wanted[part][list(place.channels)] >= 0).any()
        )
        group: list[tuple[int, int, Block]] = []  # chunks that overlap
        end, size, bad = -1, 0, 0
        for first, part, place in places:
            if group and first > end and size >= BLOCK_SIZE:
                yield from _sorted(group)
                group, size = [], 0
            try:
                block = self.files[part].read(place)
            except DamageError as error:
                self.warn(str(error))
                bad += 1
                continue
            block.connection = wanted[part][block.connection]
            kept = (block.connection >= 0) & (block.time >= low) & (block.time < high)
            group.append((part, place.offset, block if kept.all() else block.chosen(kept)))
            end, size = max(end, place.end), size + len(block.data)
            if size > _LARGEST_GROUP and len(group) > 1:
                raise DamageError(f'more than {_LARGEST_GROUP >> 20} MiB overlap in time')
        yield from _sorted(group)
        if bad and bad == len(places):
            raise DamageError('no chunk of it is whole')

    def messages(
        self,
        connections: Collection[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, log time [ns] and raw data of each message, as of `blocks`; all if empty."""
        wanted = list(connections or self.connections)
        for block in self.blocks(wanted, start, stop):
            numbers, times = block.connection.tolist(), block.time.tolist()
            for i, number in enumerate(numbers):
                yield wanted[number], times[i], block.message(i)

    def deserialize(self, rawdata: bytes, typ: str) -> Any:
        """Decode a message; BagError if it does not fit the type."""
        with damage(self.path):
            return decode(self.typestore, rawdata, typ)

    def check_definition(self, msgtype: str, fields: Iterable[str]) -> None:
        """BagError if fields of a message type, or its stamp, are not what they are here."""
        # More fields, and arrays of a fixed length for sequences, are those of other versions.
        for name, needed in ((msgtype, fields), *_STAMP):
            there, expected = (
                dict(types.fielddefs[name][1]) if name in types.fielddefs else {}
                for types in (self.typestore, standard_types())
            )
            for field in needed:
                if _element(there.get(field)) != _element(expected[field]):
                    what = 'has another type there' if field in there else 'is not in it'
                    text = f"the bag's definition of {msgtype} is not the expected one"
                    raise BagError(f'{self.path}: {text}: {field} of {name} {what}')


def _element(kind: Any) -> Any:
    """Type of a field, whatever the length of an array."""
    if kind is not None and kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return 'array', kind[1][0]
    return kind


def _wanted(file: McapFile, connections: Sequence[Connection]) -> np.ndarray:
    """Index among some connections by channel number, -1 for others."""
    index = {(c.topic, c.msgtype): i for i, c in enumerate(connections)}
    found = np.full(65536, -1, np.int64)
    for number, channel in file.channels.items():
        schema = file.schemas.get(channel.schema_id)
        found[number] = index.get((channel.topic, schema.name if schema else ''), -1)
    return found


def _sorted(group: list[tuple[int, int, Block]]) -> Iterator[Block]:
    """Messages of chunks that overlap; those of one time keep the order of the files."""
    if any(len(block) for *_, block in group):
        yield joined([block for *_, block in sorted(group, key=lambda entry: entry[:2])])


def _collect(
    messages: Iterable[tuple[Connection, int, bytes]], connections: Sequence[Connection]
) -> Iterator[Block]:
    """Blocks of messages that come one by one."""
    numbers = {(c.topic, c.id): i for i, c in enumerate(connections)}
    data = bytearray()
    for connection, time, content in messages:
        data += record(numbers[connection.topic, connection.id], max(0, time), content)
        if len(data) >= BLOCK_SIZE:
            yield split(data)[0]
            data = bytearray()
    if data:
        yield split(data)[0]


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """What readers, parsers and decompressors raise, as a BagError that names the bag."""
    try:
        yield
    except DamageError as error:
        raise BagError(f'{path}: cannot be read, the bag is damaged: {error}') from None
    except LpvError:
        raise
    except Exception as error:  # many kinds
        text = f'cannot be read, the bag is damaged or incomplete ({error_text(error)})'
        raise BagError(f'{path}: {text}') from error


@contextlib.contextmanager
def open_bag(path: str | Path) -> Iterator[BagReader]:
    """Open a rosbag2 folder, ``.mcap`` or ``.db3``; what is damaged warns, or is a BagError."""
    path = Path(path)
    if not path.exists():
        raise BagError(f'{path}: there is no such bag')
    with contextlib.ExitStack() as stack:
        with damage(path):
            reader = _opened(path, stack)
        yield reader


def _is_compressed(file: Path) -> bool:
    """Whether a file is one of a bag that rosbag2 itself compressed, as a file or by message."""
    with contextlib.suppress(DamageError):
        known = read_metadata(file.parent)
        return known.compressed and file.name.removesuffix('.zstd') in {
            name.removesuffix('.zstd') for name in known.files
        }
    return False


def _opened(path: Path, stack: ExitStack) -> BagReader:
    metadata, damages = None, list[str]()
    try:
        metadata = read_metadata(path) if (path / FILE_NAME).exists() else None
        if metadata is None and path.is_dir():
            damages.append(f'it has no {FILE_NAME}, its recording was not finished')
    except DamageError as error:
        damages.append(str(error))
    if path.is_file() and _is_compressed(path):
        raise BagError(f'{path}: is compressed by rosbag2: give the folder that it is in')
    if path.is_file() and path.suffix == '.bag':
        how = f'rosbags-convert --src {path} --dst {path.stem}'
        raise BagError(f'{path}: is a bag of ROS 1; this makes one of ROS 2 of it: {how}')
    if path.is_file() and path.suffix not in ('.mcap', '.db3'):
        raise BagError(f'{path}: is not a bag: a rosbag2 folder, or an .mcap or .db3 file')
    paths = _numbered(path, '.db3') if path.is_dir() else [path] * (path.suffix == '.db3')
    by_rosbags = bool(paths) and not any(path.glob('*.mcap'))
    if metadata is not None:
        by_rosbags = metadata.storage != 'mcap' or metadata.compressed
        paths = [] if metadata.compressed else paths  # which hold no messages yet
    files, source, before = list[McapFile](), None, len(damages)
    if by_rosbags:
        source = _by_rosbags(path, paths, damages, stack)
        connections, whole = source.connections, paths if len(damages) == before else []
    else:
        paths = _files(path, metadata, damages)
        files = _mcap_files(paths, damages, stack)
        connections = _connections_of(files, metadata.hashes if metadata else {})
        whole = [file.path for file in files if file.complete]
    if damages and not any(connection.msgcount for connection in connections):
        why = f'{damages[-1]}, and nothing in it can be recovered'
        raise BagError(f'{path}: cannot be read, the bag is damaged or incomplete: {why}')
    reader = BagReader(path, connections, files, source)
    if metadata is None:  # nobody knows how many messages there were
        reader.cut = [one.name for one in paths if one not in whole]
        reader.finished = paths[-1] in whole
    for text in damages:
        reader.warn(text)
    for connection in connections:
        reader.said[connection.topic] += connection.msgcount
    if metadata is not None:
        reader.known, there = metadata.known, reader.said
        for topic, count in metadata.counts.items():
            if there[topic] != count:
                said = f'{FILE_NAME} says {count} messages, the files hold {there[topic]}'
                reader.warn(f'{topic}: {said}')
        reader.said = there | Counter(metadata.counts)
    return reader


def _mcap_files(paths: Sequence[Path], damages: list[str], stack: ExitStack) -> list[McapFile]:
    """Those that can be read, with what is in them."""
    files = []
    for path in paths:
        try:
            file = stack.enter_context(contextlib.closing(McapFile(path)))
        except BagError as error:
            damages.append(str(error))
            continue
        files.append(file)
        for number, text in enumerate(file.damages):
            if number == 0 and not file.complete:
                text = _UNFINISHED.format(text)
            damages.append(f'{path.name}: {text}')
    return files


def _by_rosbags(path: Path, files: list[Path], damages: list[str], stack: ExitStack) -> AnyReader:
    """A bag that rosbags reads; of sqlite3 files that are damaged, copies of what is whole."""
    opened = functools.partial(AnyReader, default_typestore=standard_types())
    try:
        if any(one.stat().st_size % _page_size(one) for one in files):
            raise DamageError('it ends within a page')
        return stack.enter_context(opened(files if files and damages else [path]))
    except Exception as error:  # of many kinds
        if not files:
            raise
        damages.append(_UNFINISHED.format(error_text(error)))
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    return stack.enter_context(opened([_whole_part(one, folder) for one in files]))


def _whole_part(path: Path, folder: Path) -> Path:
    """Copy of a sqlite3 file as far as it is whole, in the order in which it was written."""
    cut, whole = folder / 'cut', folder / path.name
    shutil.copyfile(path, cut)
    os.truncate(cut, path.stat().st_size // _page_size(path) * _page_size(path))
    with contextlib.closing(sqlite3.connect(cut)) as old, sqlite3.connect(whole) as new:
        old.execute('PRAGMA writable_schema = ON')  # or one shorter than it says is refused
        for table in ('schema', 'topics', 'message_definitions', 'messages'):
            names = [name for _, name, *_ in old.execute(f'PRAGMA table_info({table})')]
            if not names:
                continue
            columns = ', '.join('"' + name.replace('"', '""') + '"' for name in names)
            new.execute(f'CREATE TABLE {table} ({columns})')
            added = f'INSERT INTO {table} VALUES ({", ".join("?" * len(names))})'
            with contextlib.suppress(sqlite3.DatabaseError):
                new.executemany(added, old.execute(f'SELECT * FROM {table} ORDER BY rowid'))
    new.close()
    return whole


def _page_size(database: Path) -> int:
    """Of a sqlite3 file [bytes]; what is there of a page that was cut would be read with zeros."""
    size = int.from_bytes(read_at_most(database, 18)[16:], 'big')
    return size if size > 1 else 65536


def _numbered(folder: Path, suffix: str) -> list[Path]:
    """Files of a bag in the order of their numbers."""
    return sorted(folder.glob(f'*{suffix}'), key=lambda one: (len(one.name), one.name))


def _files(path: Path, metadata: BagMetadata | None, damages: list[str]) -> list[Path]:
    """MCAP files of a bag; what is missing is added to the damages."""
    if not path.is_dir():
        return [path]
    paths = _numbered(path, '.mcap')
    if metadata is not None:
        named = [path / name for name in metadata.files]
        paths = [one for one in named if one.is_file()]
        if missing := [one.name for one in named if one not in paths]:
            damages.append(f'{FILE_NAME} names files that are missing: {", ".join(missing)}')
    if not paths:
        raise BagError(f'{path}: is not a bag, it has no {FILE_NAME} with files, nor MCAP files')
    return paths


def _connections_of(files: Iterable[McapFile], hashes: dict[str, str]) -> list[Connection]:
    """Topics, with the messages that are there; all publishers of a topic are one."""
    found: dict[tuple[str, str], Connection] = {}
    for file in files:
        for number in sorted(file.channels):
            one = _connection(file, number, hashes)
            known = found.setdefault((one.topic, one.msgtype), one)
            if known is not one:
                profiles = offered_qos(known)
                profiles += [qos for qos in offered_qos(one) if qos not in profiles]
                ext = ConnectionExtRosbag2(encoding_of(one), profiles)
                count = known.msgcount + one.msgcount
                found[one.topic, one.msgtype] = known._replace(msgcount=count, ext=ext)
    return list(found.values())


@functools.lru_cache(maxsize=64)
def _profiles(text: str) -> tuple[Qos, ...]:
    try:
        return tuple(parse_qos(text))
    except Exception:  # many kinds; no result depends on it
        return ()


def _connection(file: McapFile, number: int, hashes: dict[str, str]) -> Connection:
    channel = file.channels[number]
    schema = file.schemas.get(channel.schema_id)
    name, definition = '', _NONE
    if schema is not None:
        name = schema.name
        if schema.encoding in _FORMATS:
            text = schema.data.decode(errors='replace')
            definition = MessageDefinition(_FORMATS[schema.encoding], text)
    profiles = list(_profiles(channel.metadata.get('offered_qos_profiles', '')))
    digest = channel.metadata.get('topic_type_hash') or hashes.get(name, '')
    ext = ConnectionExtRosbag2(channel.message_encoding, profiles)
    count = file.counts.get(number, 0)
    return Connection(number, channel.topic, name, definition, digest, count, ext, schema)


@functools.lru_cache(maxsize=4)  # a command opens few kinds of bags, each several times
def _types_by(defined: tuple[tuple[str, MessageDefinition, str], ...]) -> Typestore:
    """Types by their names, definitions and hashes."""
    types = get_typestore(Stores.EMPTY)
    found = {}
    for name, definition, _ in defined:
        text = definition.data
        if definition.format == _FORMAT.MSG:
            found.update(get_types_from_msg(text, name))
            continue
        parts = [part.split('\n', 1)[1] for part in text.split(_IDL)[1:]] or [text]
        for part in parts:
            found.update(get_types_from_idl(part))
    types.register(found)
    texts = Counter(name for name, _ in {(name, one.data) for name, one, _ in defined})
    for name, _, digest in defined:
        if texts[name] > 1:
            raise DamageError(f'topics of type {name} define it differently')
        if digest and types.hash_rihs01(name) != digest:
            raise DamageError(f'the hash of {name} is not that of its definition')
    return types
