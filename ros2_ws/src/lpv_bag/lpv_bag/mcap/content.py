"""Contents of chunks: bounded decompression, and the records in them."""

import zlib
from typing import Any, NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from lpv_bag.errors import DamageError
from lpv_bag.mcap.records import (
    HEADER,
    MAX_CHUNK,
    MESSAGE,
    Channel,
    Schema,
    parse_channel,
    parse_schema,
)

_PIECE = 1 << 22


class Message(NamedTuple):
    """A message as it is stored."""

    log_time: int
    channel: int
    sequence: int
    publish_time: int
    data: bytes


def _pieces(stream: Any, limit: int) -> tuple[bytes, Exception | None]:
    """What a decompressing stream gives until it ends or fails, at most ``limit`` bytes."""
    found, error = [], None
    while limit > 0:
        try:
            piece = stream.read(min(limit, _PIECE))
        except (zstandard.ZstdError, RuntimeError, OSError, EOFError) as failure:
            error = failure
            break
        if not piece:
            break
        found.append(piece)
        limit -= len(piece)
    return b''.join(found), error


def _stream(data: bytes | memoryview, compression: str) -> Any:
    if compression == 'zstd':
        return zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(bytes(data))
    if compression == 'lz4':
        return _Lz4Stream(data)
    raise DamageError(f'a chunk is compressed with {compression[:20]!r}, which is unknown')


class _Lz4Stream:
    def __init__(self, data: bytes | memoryview) -> None:
        self._decompressor, self._data = lz4.frame.LZ4FrameDecompressor(), bytes(data)

    def read(self, limit: int) -> bytes:
        if self._decompressor.eof:
            return b''
        data, self._data = self._data, b''
        return self._decompressor.decompress(data, limit)


def inflate(data: bytes | memoryview, compression: str, size: int, crc: int) -> bytes:
    """Content of a whole chunk, checked."""
    if size > MAX_CHUNK:
        raise DamageError(f'a chunk claims to hold {size} bytes')
    if compression:
        content, error = _pieces(_stream(data, compression), size + 1)
        if error is not None:
            raise DamageError(f'a chunk cannot be decompressed ({error})')
    else:
        content = bytes(data)
    if len(content) != size:
        raise DamageError('a chunk does not have the size that it claims')
    if crc and zlib.crc32(content) != crc:
        raise DamageError('the checksum of a chunk is wrong')
    return content


def inflate_part(data: bytes | memoryview, compression: str, size: int) -> bytes:
    """The beginning of a chunk's content, as far as it is readable."""
    if not compression:
        return bytes(data[:size])
    try:
        return _pieces(_stream(data, compression), min(size, MAX_CHUNK))[0]
    except DamageError:
        return b''


def records(
    content: bytes, wanted: set[int] | None = None
) -> tuple[list[Message], list[Schema | Channel], str | None]:
    """Messages, schemas and channels of a chunk's content."""
    messages: list[Message] = []
    definitions: list[Schema | Channel] = []
    at, size = 0, len(content)
    unpack_header, unpack_message = HEADER.unpack_from, MESSAGE.unpack_from
    try:
        while at < size:
            if size - at < 9:
                raise DamageError('a chunk ends within a record')
            opcode, length = unpack_header(content, at)
            start, at = at + 9, at + 9 + length
            if at > size:
                raise DamageError('a chunk ends within a record')
            if opcode == Opcode.MESSAGE:
                if length < 22:
                    raise DamageError('a message is shorter than its head')
                channel, sequence, log_time, publish_time = unpack_message(content, start)
                if wanted is None or channel in wanted:
                    messages.append(
                        Message(log_time, channel, sequence, publish_time, content[start + 22 : at])
                    )
            elif opcode == Opcode.SCHEMA:
                definitions.append(parse_schema(content[start:at]))
            elif opcode == Opcode.CHANNEL:
                definitions.append(parse_channel(content[start:at]))
            elif opcode < 0x80:
                raise DamageError(f'a chunk holds a record of kind {opcode}')
    except DamageError as error:
        return messages, definitions, str(error)
    return messages, definitions, None
