"""Puts message records of several kinds, in their order, into the bytes of one chunk."""

import numpy as np

from lpv_bag.blocks.cdr_layout import rows
from lpv_bag.blocks.chunk_writing import RECORD, record_head
from lpv_bag.blocks.mcap_blocks import RECORD_HEADER
from lpv_bag.blocks.message_blocks import Block

Index = dict[int, tuple[np.ndarray, np.ndarray]]
"""Log times [ns] and offsets of messages by channel."""
_FEW = 16
"""Fewer records of one size than this are copied one by one."""


class Buffer:
    """Memory that is used again and again: fresh pages cost more than what is written to them."""

    def __init__(self) -> None:
        self._data = np.empty(0, np.uint8)

    def take(self, size: int) -> np.ndarray:
        """Some bytes, ndarray of uint8; those taken before are lost."""
        if len(self._data) < size:
            self._data = np.empty(size + size // 4, np.uint8)
        return self._data[:size]


class ChunkAssembly:
    """Records that are added in any order and come out sorted by their slots."""

    def __init__(self, slots: int, buffer: Buffer | None = None) -> None:
        self._sizes, self._buffer = np.zeros(slots, np.int64), buffer
        self._arrays: list[tuple[np.ndarray, np.ndarray]] = []
        self._single: list[tuple[int, int, int, int, bytes]] = []

    def add_rows(self, slots: np.ndarray, records: np.ndarray) -> None:
        """Add records of one size and channel."""
        if len(slots):
            self._sizes[slots] = records.dtype.itemsize
            self._arrays.append((slots, records))

    def add_message(self, slot: int, channel: int, time: int, data: bytes) -> None:
        """Add one message behind those that are in a slot already."""
        self._single.append((slot, int(self._sizes[slot]), channel, time, data))
        self._sizes[slot] += RECORD_HEADER + len(data)

    def add_copies(
        self, slots: np.ndarray, block: Block, chosen: np.ndarray, channel: np.ndarray
    ) -> None:
        """Add messages of a block."""
        sizes = block.size[chosen]
        for size in np.unique(sizes):
            same = np.flatnonzero(sizes == size)
            if len(same) < _FEW:
                for i in same:
                    self.add_message(
                        slots[i],
                        int(channel[i]),
                        int(block.time[chosen[i]]),
                        block.message(chosen[i]),
                    )
                continue
            dtype = np.dtype([('head', RECORD), ('data', f'V{size}')])
            records = rows(
                block.data, f'V{dtype.itemsize}', block.start[chosen[same]] - RECORD_HEADER
            ).view(dtype)
            head = records['head']
            head['kind'], head['length'], head['sequence'] = 5, size + 22, 0
            head['channel'] = channel[same]
            head['log_time'] = head['publish_time'] = block.time[chosen[same]]
            self._sizes[slots[same]] = dtype.itemsize
            self._arrays.append((slots[same], records))

    def finish(self) -> tuple[np.ndarray, Index]:
        """The chunk."""
        ends = np.cumsum(self._sizes)
        starts = ends - self._sizes
        total = int(ends[-1]) if len(ends) else 0
        data = np.empty(total, np.uint8) if self._buffer is None else self._buffer.take(total)
        index: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
        for slots, records in self._arrays:
            places, size = starts[slots], records.dtype.itemsize
            head = records['head'] if 'head' in (records.dtype.names or ()) else records
            rows(data, f'V{size}')[places] = records.view(f'V{size}')
            for channel in np.unique(head['channel']):
                of = head['channel'] == channel
                index.setdefault(int(channel), []).append(
                    (head['log_time'][of].astype(np.int64), places[of])
                )
        for slot, shift, channel, time, content in self._single:
            place = int(starts[slot]) + shift
            record = record_head(channel, time, len(content)) + content
            data[place : place + len(record)] = np.frombuffer(record, np.uint8)
            index.setdefault(channel, []).append((np.array([time]), np.array([place])))
        return data, {channel: _together(parts) for channel, parts in index.items()}


def _together(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    if len(parts) == 1:
        return parts[0]
    times, places = (np.concatenate(column) for column in zip(*parts))
    order = np.argsort(places)
    return times[order], places[order]
