"""MCAP files, read by the mcap package a chunk at a time, as far as they are whole."""

import io
import mmap
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from lpv.bag.blocks.message_blocks import BLOCK_SIZE, Block, split
from lpv.bag.errors import BagError, DamageError
from lpv.core.support.limits import MOST_BYTES

_MAX_RECORD = 2 * MOST_BYTES
"""Largest record: a chunk that compression made no smaller, with its index [bytes]."""
_KINDS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}


class Place(NamedTuple):
    """Where a chunk is, or messages outside of any, and what is in it."""

    start: int  # least log time [ns]
    end: int  # greatest log time [ns]
    offset: int  # [bytes]
    channels: tuple[int, ...]  # none where they are not known
    messages: int
    length: int = 0  # of messages outside of chunks [bytes]


class McapFile:
    """An open file, whose topics and places are known: from its summary, or from a scan."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.places: list[Place] = []
        self.counts: dict[int, int] = {}  # messages by channel, as far as is known
        self.attachments = 0
        self.complete = False  # whether the recording was finished
        self.damages: list[str] = []
        try:
            with open(path, 'rb') as file:
                # Reads from a map end where the file ends, whatever length a record claims.
                self._data: Any = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = 'is empty' if isinstance(error, ValueError) else f'cannot be read ({error})'
            raise BagError(f'{path}: {reason}') from None
        try:
            if self._read_summary():
                return
        except Exception as error:  # of many kinds: the bytes may be anything
            self.damages.append(error_text(error))
        self._scan()

    def close(self) -> None:
        self._data.close()

    def _read_summary(self) -> bool:
        """Whether the summary says it all; any exception if it is damaged."""
        summary = SeekingReader(self._data, record_size_limit=_MAX_RECORD).get_summary()
        if summary is None or summary.statistics is None:
            return False
        footer = self._data[-37:-8]
        start, crc = int.from_bytes(footer[9:17], 'little'), int.from_bytes(footer[25:], 'little')
        if crc and zlib.crc32(self._data[start:-12]) != crc:
            raise DamageError('the checksum of its summary is wrong')
        counts, places = dict(summary.statistics.channel_message_counts), []
        is_filled = summary.statistics.message_count > 0 or any(counts.values())
        needed = {channel.schema_id for channel in summary.channels.values()} - {0}
        # Writers may leave indexes, counts by topic, topics and schemas out of a summary.
        parts = summary.chunk_indexes, any(counts.values()), summary.channels
        if is_filled and not (all(parts) and needed <= {*summary.schemas}):
            return False
        # Without messages a chunk has no times, whatever writers put there.
        for index in summary.chunk_indexes if is_filled else ():
            if not index.message_start_time <= index.message_end_time < 2**63 - 1:
                raise DamageError('the times of a chunk are wrong')
            channels = tuple(index.message_index_offsets)
            messages = max(0, index.message_index_length - 15 * len(channels)) // 16
            times = index.message_start_time, index.message_end_time
            places.append(Place(*times, index.chunk_start_offset, channels, messages))
        if not {*counts, *(c for p in places for c in p.channels)} <= {*summary.channels}:
            raise DamageError('its summary counts messages of unknown topics')
        self.schemas, self.channels = summary.schemas, summary.channels
        self.counts, self.places, self.complete = counts, places, True
        self.attachments = summary.statistics.attachment_count
        return True

    def _scan(self) -> None:
        """Find all that is whole from the front."""
        at, found = 8, Counter[int]()
        self._data.seek(0)
        reader = StreamReader(self._data, emit_chunks=True, record_size_limit=_MAX_RECORD)
        try:
            for one in reader.records:
                after = self._data.tell()
                if isinstance(one, Message) and one.log_time < 2**63 - 1:
                    self._add_loose(one, at, after)
                    found[one.channel_id] += 1
                elif isinstance(one, Chunk):
                    found += self._add_chunk(one, at)
                elif isinstance(one, (Schema, Channel)):
                    self._define(one)
                self.attachments += isinstance(one, Attachment)
                self.complete |= isinstance(one, DataEnd)
                at = after
        except Exception as error:  # of many kinds
            if not self.complete:
                rest, why = len(self._data) - at, error_text(error)
                self.damages.append(f'{rest} bytes from byte {at} on are lost ({why})')
        if unknown := sum(found[number] for number in found if number not in self.channels):
            self.damages.append(f'{unknown} messages of topics whose definition is lost')
        self.counts = {number: count for number, count in found.items() if number in self.channels}

    def _add_loose(self, message: Message, at: int, after: int) -> None:
        """Add a message outside of chunks to the place before, if that ends where it begins."""
        place = Place(message.log_time, message.log_time, at, (), 0)
        last = self.places[-1] if self.places else place
        if 0 < last.length < BLOCK_SIZE and last.offset + last.length == at:
            place = self.places.pop()
        times = min(place.start, message.log_time), max(place.end, message.log_time)
        count, length = place.messages + 1, after - place.offset
        self.places.append(Place(*times, place.offset, (), count, length))

    def _add_chunk(self, chunk: Chunk, at: int) -> Counter[int]:
        try:
            block, others = split(_content(chunk))
            for other in others:
                if other[0] in _KINDS:
                    self._define(_KINDS[other[0]].read(ReadDataStream(io.BytesIO(other[9:]))))
        except Exception as error:  # of many kinds
            self.damages.append(f'the chunk at byte {at} is damaged ({error_text(error)})')
            return Counter()
        found = Counter(block.connection.tolist())
        if len(block):
            times = int(block.time.min()), int(block.time.max())
            self.places.append(Place(*times, at, tuple(found), len(block)))
        return found

    def _define(self, found: Schema | Channel) -> None:
        known: dict[int, Any] = self.channels if isinstance(found, Channel) else self.schemas
        if known.setdefault(found.id, found) != found:
            raise DamageError(f'the number {found.id} means two different topics or schemas')

    def read(self, place: Place) -> Block:
        """Messages of a chunk; DamageError if they are not what was recorded."""
        if place.length:
            data = self._data[place.offset : place.offset + place.length]
            return split(data)[0]
        try:
            self._data.seek(place.offset)
            head = ReadDataStream(self._data)
            if head.read1() != Opcode.CHUNK:
                raise DamageError('there is no chunk')
            head.read8()
            block = split(_content(Chunk.read(head)))[0]
            if hasattr(self._data, 'madvise'):  # what has been read would count as memory
                self._data.madvise(mmap.MADV_DONTNEED)
            times = block.time
            if len(times) and not place.start <= times.min() <= times.max() <= place.end:
                raise DamageError('its times are not those of the index')
        except Exception as error:  # of many kinds: the bytes may be anything
            text = f'the chunk at byte {place.offset} is damaged ({error_text(error)})'
            text += f', its {place.messages} messages are left out'
            raise DamageError(f'{self.path.name}: {text}') from None
        return block


def _content(chunk: Chunk) -> bytes:
    """Content of a chunk, checked, in bounded memory."""
    size = chunk.uncompressed_size
    if size > MOST_BYTES:
        raise DamageError(f'it claims to hold {size} bytes')
    if chunk.compression == 'lz4':  # mcap's own way has no bound
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
        chunk = replace(chunk, compression='', data=data)
    elif chunk.compression == 'zstd' and zstandard.frame_content_size(chunk.data) > MOST_BYTES:
        raise DamageError('its compressed data claim to be larger than a chunk may be')
    elif chunk.compression not in ('', 'zstd'):
        raise DamageError(f'it is compressed with {chunk.compression[:20]!r}, which is unknown')
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    if length != size:
        raise DamageError('it does not have the size that it claims')
    return stream.read(length)


def error_text(error: BaseException) -> str:
    """An error in one line."""
    return ' '.join(str(error).split())[:200] or type(error).__name__
