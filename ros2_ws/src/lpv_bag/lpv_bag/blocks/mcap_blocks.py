"""Messages of MCAP files, many chunks at a time."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import BinaryIO

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.cdr_layout import rows
from lpv_bag.errors import DamageError
from lpv_bag.mcap.content import inflate
from lpv_bag.mcap.file import Block, McapFile, Survey
from lpv_bag.rosbag.mcap_bag import McapBag
from lpv_core.support.jit import njit

RECORD_HEADER = 31
"""Bytes of a message's record before its content: kind, length, channel, sequence, two times."""

_LARGEST_GROUP = 128 << 20
"""Chunks whose times overlap are sorted together up to this size [bytes]."""


Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Data, index of the connection, log time [ns], start and size of messages, as in `Block`."""

Content = tuple[int, np.ndarray, int, int]
"""Number of a file, bytes of some of its records, least and greatest log time [ns]."""


class Unsuitable(Exception):
    """The bag is damaged, or of a kind that this module does not read."""


def bag_blocks(
    bag: McapBag,
    connections: Sequence[Connection],
    start: int | None,
    stop: int | None,
    block_size: int,
) -> Iterator[Parts]:
    """Messages of a bag."""
    if any(found.damages for _, found in bag.parts):
        raise Unsuitable
    wanted = [_numbers(bag.connections_of(part), connections) for part in range(len(bag.parts))]
    with contextlib.ExitStack() as stack:
        # Read, not mapped: pages of a mapped file count as memory of this process.
        files = [stack.enter_context(open(file.path, 'rb')) for file, _ in bag.parts]
        single = len(bag.parts) == 1 and _single(bag.parts[0][1].blocks)
        source = (
            _pieces(files[0], single, block_size)
            if single
            else _groups(files, bag.parts, wanted, start, stop, block_size)
        )
        last = -1
        for contents in source:
            parts = _joined([_messages(content, wanted[content[0]]) for content in contents])
            if single and (np.diff(parts[2], prepend=last) < 0).any():
                raise Unsuitable  # what is read in pieces cannot be sorted
            if len(parts[2]):
                last = parts[2][-1]
            parts = _sorted(_limited(parts, start, stop))
            if len(parts[2]):
                yield parts


def _numbers(known: dict[int, Connection], connections: Sequence[Connection]) -> np.ndarray:
    """Index of the connection by channel number, -1 for others."""
    found = np.full(65536, -1, np.int64)
    index = {connection.id: i for i, connection in enumerate(connections)}
    for channel, connection in known.items():
        found[channel] = index.get(connection.id, -1)
    return found


def _messages(content: Content, wanted: np.ndarray) -> Parts:
    """Messages among the records of a buffer; their times must be inside limits."""
    _, data, low, high = content
    offsets = _record_offsets(data)
    sizes = _column(data, offsets, 1, '<u8').astype(np.int64) - 22
    if (sizes < 0).any():
        raise Unsuitable
    channel = wanted[_column(data, offsets, 9, '<u2')]
    time = _column(data, offsets, 15, '<u8').astype(np.int64)
    if (time < 0).any():
        raise Unsuitable
    kept = channel >= 0
    if not kept.all():
        offsets, sizes, channel, time = (v[kept] for v in (offsets, sizes, channel, time))
    if len(time) and not low <= time.min() <= time.max() <= high:
        raise Unsuitable
    return data, channel, time, offsets + RECORD_HEADER, sizes


def _limited(parts: Parts, start: int | None, stop: int | None) -> Parts:
    data, channel, time, starts, sizes = parts
    kept = np.ones(len(time), bool)
    if start is not None:
        kept &= time >= start
    if stop is not None:
        kept &= time < stop
    return parts if kept.all() else (data, channel[kept], time[kept], starts[kept], sizes[kept])


def _sorted(parts: Parts) -> Parts:
    if not (np.diff(parts[2]) < 0).any():
        return parts
    data, channel, time, starts, sizes = parts
    order = np.argsort(time, kind='stable')
    return data, channel[order], time[order], starts[order], sizes[order]


def _column(data: np.ndarray, offsets: np.ndarray, shift: int, dtype: str) -> np.ndarray:
    return rows(data, dtype, offsets + shift)


def _record_offsets(data: np.ndarray) -> np.ndarray:
    """Where the message records of a buffer begin."""
    offsets = np.empty(len(data) // RECORD_HEADER + 1, np.int64)
    count, end = _scan(data, offsets)
    if end != len(data):
        raise Unsuitable
    return offsets[:count]


def _scan(data: np.ndarray, offsets: np.ndarray) -> tuple[int, int]:
    """Number of message records, and the end of the last complete one; -1 if one is damaged."""
    if len(data) < 9:
        return 0, 0
    # Every byte as the beginning of a number: lengths are anywhere.
    return _walk(data, rows(data, '<u8'), offsets)


@njit
def _walk(data: np.ndarray, numbers: np.ndarray, offsets: np.ndarray) -> tuple[int, int]:
    position, count, total = 0, 0, len(data)
    while position + 9 <= total:
        size = numbers[position + 1]
        if size >= 1 << 40:
            return count, -1
        end = position + 9 + np.int64(size)
        if end > total:
            break
        if data[position] == 5:
            if size < 22:
                return count, -1
            offsets[count] = position
            count += 1
        elif data[position] == 6:
            return count, -1
        position = end
    return count, position


# ------------------------------------------------------------------ files


def _groups(
    files: Sequence[BinaryIO],
    parts: list[tuple[McapFile, Survey]],
    wanted: list[np.ndarray],
    start: int | None,
    stop: int | None,
    block_size: int,
) -> Iterator[list[Content]]:
    """Contents of whole chunks; those whose times overlap are in one group."""
    group: list[tuple[int, Block]] = []
    size, end, furthest = 0, -1, (-1, -1)
    for part, block in sorted(
        _chosen(parts, wanted, start, stop),
        key=lambda entry: (entry[1].start, entry[0], entry[1].offset),
    ):
        follows = block.start >= end and (part, block.offset) > furthest
        if follows and size >= block_size:
            yield _contents(files, group)
            group, size = [], 0
        group.append((part, block))
        size += block.size
        if size > _LARGEST_GROUP and len(group) > 1:
            raise Unsuitable
        end = max(end, block.end)
        furthest = max(furthest, (part, block.offset))
    if group:
        yield _contents(files, group)


def _chosen(
    parts: list[tuple[McapFile, Survey]],
    wanted: list[np.ndarray],
    start: int | None,
    stop: int | None,
) -> Iterator[tuple[int, Block]]:
    for part, (_, found) in enumerate(parts):
        for block in found.blocks:
            if start is not None and block.end < start or stop is not None and block.start >= stop:
                continue
            if not block.counts or any(wanted[part][number] >= 0 for number in block.counts):
                yield part, block


def _contents(files: Sequence[BinaryIO], group: list[tuple[int, Block]]) -> list[Content]:
    # Messages of one time keep the order of the files.
    found = []
    for part, block in sorted(group, key=lambda entry: (entry[0], entry[1].offset)):
        files[part].seek(block.offset)
        try:
            content = inflate(
                files[part].read(block.length), block.compression, block.size, block.crc
            )
        except DamageError:
            raise Unsuitable from None
        found.append((part, np.frombuffer(content, np.uint8), block.start, block.end))
    return found


def _joined(parts: list[Parts]) -> Parts:
    """Messages of several buffers as those of one."""
    if len(parts) == 1:
        return parts[0]
    begins = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
    data, channel, time, _, sizes = (np.concatenate(column) for column in zip(*parts))
    starts = np.concatenate([part[3] + begin for part, begin in zip(parts, begins)])
    return data, channel, time, starts, sizes


def _single(blocks: list[Block]) -> Block | None:
    """The one block of a file without chunks, or None."""
    return blocks[0] if len(blocks) == 1 and blocks[0].loose and not blocks[0].cut else None


def _pieces(file: BinaryIO, block: Block, block_size: int) -> Iterator[list[Content]]:
    """Whole records of a file without chunks, some megabytes at a time."""
    file.seek(block.offset)
    left, rest = block.length, b''
    while left:
        part = file.read(min(left, block_size))
        if not part:
            raise Unsuitable
        left -= len(part)
        data = np.frombuffer(rest + part, np.uint8)
        _, end = _scan(data, np.empty(len(data) // RECORD_HEADER + 1, np.int64))
        if end < 0 or len(data) - end > _LARGEST_GROUP:
            raise Unsuitable
        rest = data[end:].tobytes()
        if end:
            yield [(0, data[:end], block.start, block.end)]
    if rest:
        raise Unsuitable
