"""Bags that are written a chunk at a time."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode

from lpv_bag.blocks.cdr_layout import rows
from lpv_bag.rosbag.message_loss import Known
from lpv_bag.rosbag.writing import BagWriter, FinishedFile

RECORD = np.dtype(
    [
        ('kind', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
"""Head of a message's record."""
OFFSETS = {name: place[1] for name, place in (RECORD.fields or {}).items()}
"""Of the fields of `RECORD` [bytes]."""


def record_head(channel: int, time: int, size: int) -> bytes:
    """Head of a message's record."""
    return struct.pack('<BQHIQQ', Opcode.MESSAGE, size + 22, channel, 0, time, time)


class ChunkBagWriter(BagWriter):
    """A bag writer that also takes chunks which are ready."""

    def __init__(
        self, path: str | Path, preset: str = 'none', custom_data: dict[str, str] | None = None
    ) -> None:
        self._custom_data = custom_data or {}
        super().__init__(path, preset)

    def channel(self, topic: str) -> int:
        """Channel id of an announced topic."""
        return self._channels[topic]

    def write_chunk(
        self, data: np.ndarray, index: dict[int, tuple[np.ndarray, np.ndarray]]
    ) -> None:
        """Write a chunk."""
        self.flush()
        for topic, channel in self._channels.items():
            if channel in index:
                places = index[channel][1]
                numbers = np.arange(1, len(places) + 1) + self.counts[topic]
                rows(data, '<u4')[places + OFFSETS['sequence']] = numbers & 0xFFFFFFFF
                self.counts[topic] += len(places)
        # Signed and unsigned numbers together would become floats, and lose nanoseconds.
        self._file.put_chunk(
            data.data,
            {
                channel: np.column_stack([c.astype('<u8') for c in columns]).ravel()
                for channel, columns in index.items()
            },
        )

    def _information(self, files: list[FinishedFile], known: Known) -> dict[str, Any]:
        found = super()._information(files, known)
        found['custom_data'] = {**(found.get('custom_data') or {}), **self._custom_data}
        return found
