"""Records of the MCAP format, parsed from bytes that may be damaged.

Every length is checked against the bytes that are there before anything is read, and a record must
be consumed exactly: a flipped bit in a length is then noticed in the record that has it.
"""

import functools
import struct
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from mcap.opcode import Opcode

from lpv_bag.errors import DamageError

MAGIC = b'\x89MCAP0\r\n'
HEADER = struct.Struct('<BQ')
"""Opcode and length of the content that follows."""
MESSAGE = struct.Struct('<HIQQ')
"""Channel, sequence number, log time, publish time; the data follow."""
MAX_CHUNK = 1 << 27
"""Largest chunk that is read, decompressed [bytes]."""
MAX_RECORD = 1 << 30
"""Largest record that is read [bytes]."""
T = TypeVar('T')


class Schema(NamedTuple):
    """A message definition."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A topic of one publisher, or of several with the same QoS."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]  # of pairs; hashable, two equal channels are one


class Chunk(NamedTuple):
    """Head of a chunk record; times are of the messages in it."""

    start: int
    end: int
    size: int
    crc: int
    compression: str
    data_offset: int  # in the content
    data_size: int


class ChunkIndex(NamedTuple):
    """Where a chunk is."""

    start: int
    end: int
    offset: int
    length: int
    message_indexes: dict[int, int]
    index_length: int
    compression: str
    data_size: int
    size: int

    def counts(self) -> dict[int, int]:
        """Messages by channel, from the lengths of the message indexes after the chunk."""
        ends = sorted(self.message_indexes.values())[1:]
        ends.append(self.offset + self.length + self.index_length)
        order = sorted(self.message_indexes, key=self.message_indexes.__getitem__)
        return {
            channel: max(0, end - self.message_indexes[channel] - 15) // 16
            for channel, end in zip(order, ends)
        }


class Cursor:
    """Sequential reader of a record's content."""

    def __init__(self, content: bytes | memoryview) -> None:
        self._content, self.at = memoryview(content), 0

    def take(self, count: int) -> memoryview:
        """The next bytes."""
        if count > len(self._content) - self.at:
            raise DamageError('a length points past the end of its record')
        self.at += count
        return self._content[self.at - count : self.at]

    def numbers(self, layout: str) -> tuple[Any, ...]:
        """The next numbers, by a layout of `struct`."""
        return struct.unpack('<' + layout, self.take(struct.calcsize('<' + layout)))

    def number(self, layout: str) -> int:
        """The next number."""
        return self.numbers(layout)[0]

    def text(self) -> str:
        """A string, preceded by its length."""
        try:
            return str(self.take(self.number('I')), 'utf-8')
        except UnicodeDecodeError:
            raise DamageError('a string is not UTF-8') from None

    def block(self) -> 'Cursor':
        """A cursor over a block, preceded by its length of 4 bytes."""
        return Cursor(self.take(self.number('I')))

    @property
    def left(self) -> int:
        """Bytes that are left."""
        return len(self._content) - self.at

    def finish(self) -> None:
        """Check that the content was read to its end."""
        if self.left:
            raise DamageError('a record is longer than its content')


def _pairs(cursor: Cursor) -> tuple[tuple[str, str], ...]:
    found = []
    while cursor.left:
        found.append((cursor.text(), cursor.text()))
    return tuple(found)


def _record(read: Callable[[Cursor], T]) -> Callable[[bytes | memoryview], T]:
    """Parser of a content from a function that reads its fields: nothing may be left over."""

    @functools.wraps(read)
    def parse(content: bytes | memoryview) -> T:
        cursor = Cursor(content)
        result = read(cursor)
        cursor.finish()
        return result

    return parse


@_record
def parse_schema(cursor: Cursor) -> Schema:
    """`Schema` from a record's content; DamageError if it is none."""
    number = cursor.number('H')
    if number == 0:
        raise DamageError('a schema has the number 0')
    return Schema(number, cursor.text(), cursor.text(), bytes(cursor.take(cursor.number('I'))))


@_record
def parse_channel(cursor: Cursor) -> Channel:
    """`Channel` from a record's content; DamageError if it is none."""
    return Channel(
        cursor.number('H'), cursor.number('H'), cursor.text(), cursor.text(), _pairs(cursor.block())
    )


def parse_chunk(content: bytes | memoryview, whole: bool = True) -> Chunk:
    """`Chunk` from a record's content; DamageError if it is none."""
    cursor = Cursor(content)
    start, end, size, crc = cursor.numbers('QQQI')
    compression = cursor.text()
    result = Chunk(start, end, size, crc, compression, cursor.at + 8, cursor.number('Q'))
    if whole and result.data_size != cursor.left:
        raise DamageError('a chunk is not as long as its record')
    if result.size > MAX_CHUNK:
        raise DamageError(f'a chunk claims to hold {result.size} bytes')
    return result


def _by_channel(cursor: Cursor, what: str) -> dict[int, int]:
    """A block of pairs of a channel and a number."""
    entries = cursor.block()
    if entries.left % 10:
        raise DamageError(f'{what} half an entry')
    return dict(struct.iter_unpack('<HQ', entries.take(entries.left)))


@_record
def parse_chunk_index(cursor: Cursor) -> ChunkIndex:
    """`ChunkIndex` from a record's content; DamageError if it is none."""
    start, end, offset, length = cursor.numbers('QQQQ')
    offsets = _by_channel(cursor, 'a chunk index has')
    index_length, compression = cursor.number('Q'), cursor.text()
    data_size, size = cursor.numbers('QQ')
    return ChunkIndex(
        start, end, offset, length, offsets, index_length, compression, data_size, size
    )


@_record
def parse_message_index(cursor: Cursor) -> tuple[int, int]:
    """Channel and number of its messages, of a message index; DamageError if it is none."""
    channel, entries = cursor.number('H'), cursor.block()
    if entries.left % 16:
        raise DamageError('a message index has half an entry')
    return channel, entries.left // 16


@_record
def parse_metadata(cursor: Cursor) -> tuple[str, dict[str, str]]:
    """Name and dict of a metadata record; DamageError if it is none."""
    return cursor.text(), dict(_pairs(cursor.block()))


@_record
def parse_statistics(cursor: Cursor) -> dict[int, int]:
    """Number of messages by channel; DamageError if it is no statistics record."""
    total = cursor.numbers('QHIIIIQQ')[0]
    counts = _by_channel(cursor, 'the statistics have')
    if sum(counts.values()) != total:
        raise DamageError('the statistics do not add up')
    return counts


def _fixed(layout: str) -> Callable[[bytes | memoryview], tuple[Any, ...]]:
    return _record(lambda cursor: cursor.numbers(layout))


@_record
def _attachment(cursor: Cursor) -> tuple[str, str]:
    cursor.numbers('QQ')
    result = cursor.text(), cursor.text()
    cursor.take(cursor.number('Q') + 4)
    return result


@_record
def _attachment_index(cursor: Cursor) -> tuple[str, str]:
    cursor.numbers('QQQQQ')
    return cursor.text(), cursor.text()


def _message(content: bytes | memoryview) -> tuple[int, ...]:
    if len(content) < MESSAGE.size:
        raise DamageError('a message is shorter than its head')
    return MESSAGE.unpack_from(content)


PARSERS: dict[int, Callable[[bytes | memoryview], Any]] = {
    Opcode.HEADER: _record(lambda cursor: (cursor.text(), cursor.text())),
    Opcode.FOOTER: _fixed('QQI'),
    Opcode.SCHEMA: parse_schema,
    Opcode.CHANNEL: parse_channel,
    Opcode.MESSAGE: _message,
    Opcode.CHUNK: parse_chunk,
    Opcode.MESSAGE_INDEX: parse_message_index,
    Opcode.CHUNK_INDEX: parse_chunk_index,
    Opcode.ATTACHMENT: _attachment,
    Opcode.ATTACHMENT_INDEX: _attachment_index,
    Opcode.STATISTICS: parse_statistics,
    Opcode.METADATA: parse_metadata,
    Opcode.METADATA_INDEX: _record(lambda cursor: (*cursor.numbers('QQ'), cursor.text())),
    Opcode.SUMMARY_OFFSET: _fixed('BQQ'),
    Opcode.DATA_END: _fixed('I'),
}
"""Parsers of contents by opcode."""
