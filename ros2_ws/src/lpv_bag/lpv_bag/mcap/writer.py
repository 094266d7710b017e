"""Writing of one MCAP file that can be read at any moment while it is written.

The records are those of the mcap package.  The caller ends chunks: `McapWriter.cut` hands
everything to the operating system, and later writes do not change it.  The package's own writer has
one level of compression, cannot be used after a failed write, and defines topics in the first chunk
alone.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from lpv_bag.mcap.records import HEADER, MAGIC

Buffer = bytes | bytearray | memoryview
_MESSAGE = struct.Struct('<BQHIQQ')
_INDEX = struct.Struct('<BQHI')
_CHUNK = struct.Struct('<BQQQQII')
LIBRARY = 'lpv_bag numbered'
"""In the header of a file: its messages are numbered as `McapWriter.write` says."""
_REPEAT = 64


class Preset(NamedTuple):
    """How chunks are compressed."""

    level: int | None  # of zstd; None stores as is
    chunk_size: int  # content after which a chunk is cut [bytes]


PRESETS = {
    'none': Preset(None, 1 << 20),
    'zstd_fast': Preset(1, 1 << 20),
    'zstd_small': Preset(12, 1 << 22),
}
"""Compression by name, after the presets of rosbag2."""


class McapWriter:
    """One file of a bag."""

    def __init__(self, path: str | Path, preset: str = 'none', fsync: bool = False) -> None:
        self.path, self._preset, self._fsync = Path(path), PRESETS[preset], fsync
        self._compress = None
        if self._preset.level is not None:
            self._compress = zstandard.ZstdCompressor(self._preset.level).compress
        self.size = self.start = self.end = 0
        self.counts: dict[int, int] = {}
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._new: list[Schema | Channel] = []
        self._indexes: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._begin_chunk()
        self._file = open(path, 'xb', buffering=0)  # noqa: SIM115
        self._put(MAGIC + _bytes(Header('ros2', LIBRARY)))

    def _begin_chunk(self) -> None:
        self._content = bytearray()
        self._entries: dict[int, list[int]] = {}

    @property
    def pending(self) -> int:
        """Size of the chunk that has not ended yet [bytes]."""
        return len(self._content)

    # -------------------------------------------------------------- definitions

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a message type; its number."""
        schema = Schema(len(self._schemas) + 1, data, encoding, name)
        self._schemas.append(schema)
        self._new.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Define a topic; its number."""
        channel = Channel(len(self._channels) + 1, topic, 'cdr', metadata, schema)
        self._channels.append(channel)
        self._new.append(channel)
        self.counts[channel.id] = 0
        return channel.id

    # -------------------------------------------------------------- messages

    def write(
        self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None:
        """Add a message; a full chunk is written."""
        content = self._content
        if self._new:
            self._define()
        entry = self._entries.get(channel)
        if entry is None:
            entry = self._entries[channel] = []
        entry += (log_time, len(content))
        content += _MESSAGE.pack(
            Opcode.MESSAGE, 22 + len(data), channel, sequence, log_time, publish_time
        )
        content += data
        if len(content) >= self._preset.chunk_size:
            self.cut()

    def _define(self) -> None:
        builder = RecordBuilder()
        for record in self._new:
            record.write(builder)
        self._content += builder.end()
        self._new = []

    def cut(self) -> None:
        """End the chunk, if it has messages, and hand it to the operating system."""
        if not self._entries:
            return
        content, entries = bytes(self._content), self._entries
        self._begin_chunk()
        self._put_chunk(
            content, {channel: np.array(values, '<u8') for channel, values in entries.items()}
        )

    def put_chunk(self, content: Buffer, entries: dict[int, np.ndarray]) -> None:
        """Write a chunk that was assembled elsewhere."""
        self.cut()
        if self._new:
            self._put(b''.join(map(_bytes, self._new)))
            self._new = []
        self._put_chunk(content, entries)

    def _put_chunk(self, content: Buffer, entries: dict[int, np.ndarray]) -> None:
        if _is_repeated(len(self._indexes) + 1):
            self._new = [*self._schemas, *self._channels]
        start = min(int(values[::2].min()) for values in entries.values())
        end = max(int(values[::2].max()) for values in entries.values())
        data = content if self._compress is None else self._compress(content)
        compression = '' if self._compress is None else 'zstd'
        head = _CHUNK.pack(
            Opcode.CHUNK,
            40 + len(compression) + len(data),
            start,
            end,
            len(content),
            zlib.crc32(content),
            len(compression),
        )
        head += compression.encode() + struct.pack('<Q', len(data))
        length = len(head) + len(data)
        offsets, tail = {}, bytearray()
        for channel, values in sorted(entries.items()):
            offsets[channel] = self.size + length + len(tail)
            tail += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(values), channel, 8 * len(values))
            tail += values.astype('<u8').tobytes()
        index = ChunkIndex(
            length, self.size, compression, len(data), end, len(tail), offsets, start, len(content)
        )
        self._put(head, data, tail)
        self._indexes.append(index)
        first = not any(self.counts.values())
        self.start = start if first else min(start, self.start)
        self.end = end if first else max(end, self.end)
        for channel, values in entries.items():
            self.counts[channel] += len(values) // 2

    def _put(self, *parts: Buffer) -> None:
        """Write all of it or nothing: half a record would hide the records after it."""
        try:
            for part in parts:
                view = memoryview(part)
                while view:
                    view = view[self._file.write(view) :]
            if self._fsync:
                os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += sum(map(len, parts))

    # -------------------------------------------------------------- end

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes(Metadata(name=name, metadata=values))
        index = MetadataIndex(self.size, len(record), name)
        self._put(record)
        self._metadata.append(index)

    @property
    def tail_size(self) -> int:
        """Approximate size of what `finish` writes [bytes]."""
        return (
            sum(200 + len(s.data) for s in self._schemas)
            + 1000 * len(self._channels)
            + sum(80 + 10 * len(i.message_index_offsets) for i in self._indexes)
            + 1000
        )

    def finish(self) -> str:
        """Write the summary and close the file.

        Where there is no room for it, the file is ended without a summary, so that it can be read
        from the front; where there is not even room for that, it is left as it is.
        """
        try:
            return self._finish()
        finally:
            self._file.close()

    def _finish(self) -> str:
        error = None
        try:
            self.cut()
        except OSError as failure:
            error = failure
        for make in (self._summary, self._bare_end):
            try:
                self._put(make())
            except OSError as failure:
                error = error or failure
            else:
                break
        else:
            return f'the end ({error.strerror if error else None})'
        return f'the last messages or the summary ({error.strerror})' if error else ''

    def _bare_end(self) -> bytes:
        return _bytes(DataEnd(0)) + _bytes(Footer(0, 0, 0)) + MAGIC

    def _summary(self) -> bytes:
        end = _bytes(DataEnd(0))
        start = self.size + len(end)
        groups = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._indexes),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, members in groups:
            data = b''.join(map(_bytes, members))
            if data:
                offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        offset_start = start + len(summary)
        summary += offsets
        footer = _bytes(Footer(start, offset_start, 0))
        crc = zlib.crc32(summary + footer[: HEADER.size + 16])
        return bytes(end + summary + _bytes(Footer(start, offset_start, crc)) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            0,
            len(self._channels),
            dict(self.counts),
            len(self._indexes),
            sum(self.counts.values()),
            self.end,
            self.start,
            len(self._metadata),
            len(self._schemas),
        )


def _is_repeated(chunk: int) -> bool:
    """Whether a chunk repeats all definitions, so that damage to one chunk does not lose them."""
    return chunk % _REPEAT == 0 or chunk & (chunk - 1) == 0


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
