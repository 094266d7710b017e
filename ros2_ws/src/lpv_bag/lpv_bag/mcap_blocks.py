"""MCAP files read a chunk at a time; the index is that of rosbags' reader."""

import struct
import zlib

import lz4.frame
import numpy as np
import zstandard

from lpv_bag.layout import rows
from lpv_core.jit import njit

RECORD_HEADER = 31
"""Bytes of a message's record before its content: kind, length, channel, sequence, two times."""

_CHUNK = 6
_LARGEST_CHUNK = 256 << 20
"""A chunk that claims to be larger [bytes] is not unpacked here."""
_LARGEST_GROUP = 128 << 20
"""Chunks whose times overlap are sorted together up to this size [bytes]."""
_CHUNK_HEADER = struct.Struct('<BQQQQII')  # kind, length, start, end, size, CRC, length of a name


class Unsuitable(Exception):
    """The file is damaged, or of a kind that is not read here."""


def storage_blocks(storage, channels, start, stop, block_size):
    """Messages of one MCAP file.

    Parameters
    ----------
    storage : rosbags.rosbag2.storage_mcap.McapReader
        Open reader, for its index.
    channels : dict of int to int
        What stands for each channel in the result; channels that are missing or below zero are
        left out.
    start, stop : int or None
        First log time, and first one after the end [ns].
    block_size : int
        How many bytes a block should have.

    Yields
    ------
    tuple of ndarray
        Data, channel, log time, start and size of messages, as in `lpv_bag.blocks.Block`.

    Raises
    ------
    Unsuitable
        If something is not as it should be.
    """
    wanted = np.full(65536, -1, np.int64)
    for channel, number in channels.items():
        wanted[channel] = number
    with open(storage.path, 'rb') as file:
        source = (_chunked(file, storage, wanted, start, stop, block_size) if storage.chunks
                  else _unchunked(file, storage, block_size))
        last = -1
        for data, low, high in source:
            parts = _messages(data, wanted, low, high)
            time = parts[2]
            if len(time) and (time[0] < last or not storage.chunks and (np.diff(time) < 0).any()):
                raise Unsuitable  # only chunks can be sorted
            parts = _sorted(_limited(parts, start, stop))
            if len(parts[1]):
                last = parts[2][-1]
                yield parts


def _messages(data, wanted, low, high):
    """Messages among the records of a buffer; their times must be inside limits."""
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


def _limited(parts, start, stop):
    data, channel, time, starts, sizes = parts
    kept = np.ones(len(time), bool)
    if start is not None:
        kept &= time >= start
    if stop is not None:
        kept &= time < stop
    return parts if kept.all() else (data, *(v[kept] for v in parts[1:]))


def _sorted(parts):
    if not (np.diff(parts[2]) < 0).any():
        return parts
    order = np.argsort(parts[2], kind='stable')
    return (parts[0], *(v[order] for v in parts[1:]))


def _column(data, offsets, shift, dtype):
    return rows(data, dtype, offsets + shift)


def _record_offsets(data):
    """Where the message records of a buffer begin."""
    offsets = np.empty(len(data) // RECORD_HEADER + 1, np.int64)
    count, end = _scan(data, offsets)
    if end != len(data):
        raise Unsuitable
    return offsets[:count]


def _scan(data, offsets):
    """Walk over records; their count, and the end of the last one that is complete, or -1."""
    if len(data) < 9:
        return 0, 0
    # Every byte as the beginning of a number: lengths are anywhere.
    return _walk(data, rows(data, '<u8'), offsets)


@njit
def _walk(data, numbers, offsets):
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


# ------------------------------------------------------------------ chunks


def _chunked(file, storage, wanted, start, stop, block_size):
    """Buffers of whole chunks; those whose times overlap are in one buffer."""
    group, size, end, furthest = [], 0, -1, -1
    for chunk in sorted(_chosen(storage.chunks, wanted, start, stop),
                        key=lambda c: (c.message_start_time, c.chunk_start_offset)):
        follows = chunk.message_start_time >= end and chunk.chunk_start_offset > furthest
        if follows and size >= block_size:
            yield _unpack_all(file, group)
            group, size = [], 0
        group.append(chunk)
        size += chunk.uncompressed_size
        if size > _LARGEST_GROUP and len(group) > 1:
            raise Unsuitable
        end = max(end, chunk.message_end_time)
        furthest = max(furthest, chunk.chunk_start_offset)
    if group:
        yield _unpack_all(file, group)


def _chosen(chunks, wanted, start, stop):
    for chunk in chunks:
        if start is not None and chunk.message_end_time < start:
            continue
        if stop is not None and chunk.message_start_time >= stop:
            continue
        if any(wanted[channel] >= 0 for channel in chunk.channel_count):
            yield chunk


def _unpack_all(file, chunks):
    # Messages of one time keep the order of the file, as rosbags has it.
    parts = [_unpack(file, c) for c in sorted(chunks, key=lambda c: c.chunk_start_offset)]
    return (np.frombuffer(parts[0] if len(parts) == 1 else b''.join(parts), np.uint8),
            min(c.message_start_time for c in chunks), max(c.message_end_time for c in chunks))


def _unpack(file, chunk):
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise Unsuitable
    file.seek(chunk.chunk_start_offset)
    head = file.read(_CHUNK_HEADER.size + len(chunk.compression) + 8)
    try:
        kind, length, _, _, size, crc, name = _CHUNK_HEADER.unpack_from(head)
        (packed,) = struct.unpack_from('<Q', head, _CHUNK_HEADER.size + len(chunk.compression))
    except struct.error:
        raise Unsuitable from None
    if (kind, length, size, name, packed) != (
            _CHUNK, chunk.chunk_length - 9, chunk.uncompressed_size, len(chunk.compression),
            chunk.compressed_size) or packed > length:
        raise Unsuitable
    data = _decompress(file.read(packed), chunk.compression, size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise Unsuitable
    return data


def _decompress(data, compression, size):
    try:
        if compression == '':
            return data
        if compression == 'zstd':
            # The size in the frame decides how much memory is taken.
            if zstandard.frame_content_size(data) not in (-1, size):
                raise Unsuitable
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        if compression == 'lz4':
            return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    except (zstandard.ZstdError, RuntimeError, EOFError, ValueError):
        pass
    raise Unsuitable


# ------------------------------------------------------------------ files without chunks


def _unchunked(file, storage, block_size):
    """Buffers of whole records of a file without chunks."""
    file.seek(storage.data_start)
    left, rest = storage.data_end - storage.data_start, b''
    while left:
        part = file.read(min(left, block_size))
        if not part:
            raise Unsuitable
        left -= len(part)
        data = np.frombuffer(rest + part, np.uint8)
        offsets = np.empty(len(data) // RECORD_HEADER + 1, np.int64)
        _, end = _scan(data, offsets)
        if end < 0 or len(data) - end > _LARGEST_CHUNK:
            raise Unsuitable
        rest = data[end:].tobytes()
        if end:
            yield data[:end], 0, 2**63 - 1
    if rest:
        raise Unsuitable
