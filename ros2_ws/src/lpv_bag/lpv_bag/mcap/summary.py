"""The summary at the end of an MCAP file: what it says, where it can be trusted."""

import mmap
import zlib
from collections.abc import Iterator

from mcap.opcode import Opcode

from lpv_bag.errors import DamageError
from lpv_bag.mcap.file import Block, Survey, release
from lpv_bag.mcap.records import (
    HEADER,
    MAGIC,
    PARSERS,
    Chunk,
    parse_channel,
    parse_chunk,
    parse_chunk_index,
    parse_schema,
    parse_statistics,
)

FOOTER_SIZE = 29
"""With its head [bytes]."""


_RELEASED = 256
"""Number of chunk heads after which the pages that hold them are released."""


class Unindexed(DamageError):
    """The summary is whole, but finding the messages needs a pass over all data."""


def summary_span(data: mmap.mmap | bytes) -> tuple[int, int]:
    """Where the summary is."""
    if len(data) < 16 + FOOTER_SIZE or data[-8:] != MAGIC:
        raise DamageError('it does not end as a finished MCAP file')
    footer = len(data) - 8 - FOOTER_SIZE
    if HEADER.unpack_from(data, footer) != (Opcode.FOOTER, 20):
        raise DamageError('its footer is damaged')
    start, _, crc = PARSERS[Opcode.FOOTER](data[footer + 9 : footer + FOOTER_SIZE])
    if not 8 <= start <= footer:
        raise DamageError('it has no summary')
    if crc and zlib.crc32(data[start : footer + FOOTER_SIZE - 4]) != crc:
        raise DamageError('the checksum of its summary is wrong')
    return start, footer


def walk_summary(data: mmap.mmap | bytes, at: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Records of a summary."""
    while at < end:
        if end - at < 9:
            raise DamageError('its summary ends within a record')
        opcode, length = HEADER.unpack_from(data, at)
        if length > end - at - 9:
            raise DamageError('a record of its summary is too long')
        yield opcode, data[at + 9 : at + 9 + length]
        at += 9 + length


def from_summary(data: mmap.mmap | bytes) -> Survey:
    """What a file holds by its summary.

    Checksums of chunks stand in their heads, and what the heads say must be what the summary says.
    """
    if data[:8] != MAGIC:
        raise DamageError('it does not begin as an MCAP file')
    start, footer = summary_span(data)
    result = Survey(complete=True)
    for opcode, content in walk_summary(data, start, footer):
        _take_summary(result, opcode, content)
    _check_blocks(data, result, start)
    return result


def _take_summary(result: Survey, opcode: int, content: bytes) -> None:
    if opcode == Opcode.SCHEMA:
        result.define(parse_schema(content))
    elif opcode == Opcode.CHANNEL:
        result.define(parse_channel(content))
    elif opcode == Opcode.STATISTICS:
        result.counts = parse_statistics(content)
    elif opcode == Opcode.CHUNK_INDEX:
        index = parse_chunk_index(content)
        at = index.offset + 9 + 40 + len(index.compression.encode())
        result.blocks.append(
            Block(
                at,
                index.data_size,
                index.compression,
                index.size,
                0,
                index.start,
                index.end,
                index.counts(),
            )
        )
        if at + index.data_size != index.offset + index.length:
            raise DamageError('the place of a chunk is wrong')
    elif opcode == Opcode.METADATA_INDEX:
        offset, _, name = PARSERS[opcode](content)
        result.metadata.append((offset, name, None))
    elif opcode == Opcode.ATTACHMENT_INDEX:
        result.attachments += 1
    elif opcode < 0x80 and opcode != Opcode.SUMMARY_OFFSET:
        raise DamageError(f'its summary holds a record of kind {opcode}')


def _check_blocks(data: mmap.mmap | bytes, result: Survey, end: int) -> None:
    """Read the checksums of the chunks, and compare their heads with the index.

    A file without statistics, or with messages outside of chunks, is read as a whole.
    """
    if result.counts is None or (any(result.counts.values()) and not result.blocks):
        raise Unindexed('its summary does not say where the messages are')
    if not set(result.counts) <= set(result.channels):
        raise DamageError('its summary counts messages of unknown topics')
    for count, block in enumerate(sorted(result.blocks, key=lambda b: b.offset), 1):
        if count % _RELEASED == 0:
            release(data)
        head = block.offset - 40 - len(block.compression.encode())
        if head < 17 or block.offset + block.length > end:
            raise DamageError('the place of a chunk is wrong')
        found = parse_chunk(data[head : block.offset], whole=False)
        block.crc = found.crc
        if found != Chunk(
            block.start,
            block.end,
            block.size,
            found.crc,
            block.compression,
            block.offset - head,
            block.length,
        ):
            raise DamageError(f'the head of the chunk at byte {head - 9} is damaged')
