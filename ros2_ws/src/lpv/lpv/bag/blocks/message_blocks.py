"""Messages of a bag in blocks of some megabytes, so that NumPy can work on thousands at once."""

import struct
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from lpv.bag.errors import DamageError
from lpv.core.support.jit import njit

T = TypeVar('T')
BLOCK_SIZE = 2 << 20
"""Of about one block [bytes]: it fits into the caches, and overheads do not count."""
RECORD = np.dtype('u1,<u8,<u2,<u4,<u8,<u8')
RECORD.names = ('kind', 'length', 'channel', 'sequence', 'log_time', 'publish_time')
"""Head of a message's record in an MCAP file."""
_MESSAGE, _HEAD, _SIZE = 5, struct.Struct('<BQHIQQ'), RECORD.itemsize  # of a message's record
_CHANNEL, _TIME = 9, 15  # places of its channel and its log time


@dataclass
class Block:
    """Consecutive messages; before each are the bytes of a `RECORD` in ``data``."""

    data: np.ndarray  # bytes that hold all messages
    connection: np.ndarray  # index of each message's connection among those asked for; shape (n,)
    time: np.ndarray  # log times [ns], in order; shape (n,)
    start: np.ndarray  # where in ``data`` each message begins [bytes]; shape (n,)
    size: np.ndarray  # length of each message [bytes]; shape (n,)

    def __len__(self) -> int:
        return len(self.time)

    def message(self, index: int) -> bytes:
        """Bytes of one message."""
        start = self.start[index]
        return self.data[start : start + self.size[index]].tobytes()

    def copied(self, channels: np.ndarray) -> 'Block':
        """These messages alone, in their order, as records of other channels."""
        sizes = self.size + RECORD.itemsize
        ends = (self.start + self.size).tolist()
        begins = (self.start - RECORD.itemsize).tolist()
        whole = self.data.data
        data = bytearray().join([whole[a:b] for a, b in zip(begins, ends)])
        places = np.cumsum(sizes) - sizes
        array = np.frombuffer(data, np.uint8)
        rows(array, '<u2')[places + _CHANNEL] = channels
        return Block(array, channels, self.time, places + RECORD.itemsize, self.size)

    def chosen(self, rows: np.ndarray) -> 'Block':
        """Some of the messages."""
        own = self.connection, self.time, self.start, self.size
        return Block(self.data, *(column[rows] for column in own))


def rows(buffer: np.ndarray, dtype: np.dtype | str, starts: np.ndarray | None = None) -> np.ndarray:
    """Parts of a buffer that start at any byte, as an array of their type."""
    dtype = np.dtype(dtype)
    view = np.ndarray((max(0, len(buffer) - dtype.itemsize + 1),), dtype, buffer, strides=(1,))
    return view if starts is None else view[starts]


def record(channel: int, time: int, data: bytes) -> bytes:
    """Record of one message that was published at its log time [ns]."""
    return _HEAD.pack(_MESSAGE, 22 + len(data), channel, 0, time, time) + data


def from_rows(records: np.ndarray) -> Block:
    """A block of records of one size, with the fields of `RECORD` at their beginnings."""
    size, count = records.dtype.itemsize, len(records)
    data, starts = np.ascontiguousarray(records).view(np.uint8), size * np.arange(count)
    channels, times = (records[name].astype(np.int64) for name in ('channel', 'log_time'))
    sizes = np.full(count, size - RECORD.itemsize)
    return Block(data, channels, times, starts + RECORD.itemsize, sizes)


def split(records: bytes | bytearray) -> tuple[Block, list[bytes]]:
    """Messages of a chunk's content, by the file's channel numbers; its other records as bytes."""
    content = np.frombuffer(records, np.uint8)
    if len(content) < 9:
        if len(content):
            raise DamageError('a chunk ends within a record')
        return Block(content, *np.zeros((4, 0), np.int64)), []
    columns = np.empty((4, len(content) // RECORD.itemsize + 1), np.int64)
    others = np.empty(len(content) // 9 + 1, np.int64)
    numbers = rows(content, '<u8')  # they are at any byte
    count, other, end, latest = _walk(content, numbers, columns, others)
    if end != len(content):
        raise DamageError('a chunk ends within a record, or a message is shorter than its head')
    if latest > 2**63 - 2:
        raise DamageError('the time of a message is beyond all times')
    found = [content[at : at + 9 + int(numbers[at + 1])].tobytes() for at in others[:other]]
    return Block(content, *columns[:, :count]), found


@njit
def _walk(
    data: np.ndarray, numbers: np.ndarray, columns: np.ndarray, others: np.ndarray
) -> tuple[int, int, int, int]:
    """Write the four columns of a `Block`, and where records of other kinds begin.

    Returns the numbers of both, the end of the last whole record, and the latest time.
    """
    position, count, other, total, latest = 0, 0, 0, len(data), np.uint64(0)
    while position + 9 <= total:
        size = numbers[position + 1]
        if size > total or position + 9 + np.int64(size) > total:
            break
        if data[position] == _MESSAGE:
            if size < 22:
                break
            time = numbers[position + _TIME]
            latest = max(latest, time)
            low, high = data[position + _CHANNEL], data[position + _CHANNEL + 1]
            columns[0, count] = np.int64(low) + 256 * np.int64(high)
            columns[1, count] = np.int64(time)
            columns[2, count] = position + _SIZE
            columns[3, count] = np.int64(size) + 9 - _SIZE
            count += 1
        else:
            others[other] = position
            other += 1
        position += 9 + np.int64(size)
    return count, other, position, latest


def joined(blocks: list[Block]) -> Block:
    """Messages of several blocks as those of one, by log time."""
    block = blocks[0]
    if len(blocks) > 1:
        begins = np.cumsum([0] + [len(b.data) for b in blocks[:-1]])
        names = ('data', 'connection', 'time', 'start', 'size')
        block = Block(*(np.concatenate([getattr(b, name) for b in blocks]) for name in names))
        block.start = block.start + np.repeat(begins, [len(b) for b in blocks])
    if (np.diff(block.time) < 0).any():
        return block.chosen(np.argsort(block.time, kind='stable'))
    return block


def ahead(items: Iterable[T]) -> Iterator[T]:
    """Items of an iterable, each made by another thread while the one before is in use."""
    end: Any = object()
    with ThreadPoolExecutor(1) as pool:
        source = iter(items)
        coming = pool.submit(next, source, end)
        while (item := coming.result()) is not end:
            coming = pool.submit(next, source, end)
            yield item
