"""Streams of a run, thousands of messages at a time where they have the same shape."""

from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block, read_blocks
from lpv_bag.blocks.prefetch import ahead
from lpv_bag.rosbag.mcap_bag import McapBag
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.rows import RunRows
from lpv_bag.run.streams import ALARMS, SCALARS, STREAMS, stamp_of
from lpv_core.support.errors import SampleError

JointIndex = list[int] | Literal[False] | None
"""Columns of the wanted joints; None for other streams, False for messages of other joints."""
_MOST_LAYOUTS = 4
_MOST_ATTEMPTS = 32
"""Messages of one connection from which a shape is to be learnt; then they are read one by one."""


def read_streams(reader: BagReader, chosen: dict[str, list[Connection]], rows: RunRows) -> None:
    """Read all messages of some streams."""
    pairs = [(name, c) for name, connections in chosen.items() for c in connections]
    readers = [_StreamReader(reader, name, c.msgtype, rows) for name, c in pairs]
    number = 0
    for block in ahead(read_blocks(reader, [c for _, c in pairs])):
        for i, stream in enumerate(readers):
            positions = np.flatnonzero(block.connection == i)
            if len(positions):
                stream.read(block, positions, number)
        number += len(block)


class _StreamReader:
    """Reads the messages of one connection."""

    def __init__(self, reader: BagReader, name: str, msgtype: str, rows: RunRows) -> None:
        self._reader, self._name, self._msgtype, self._rows = reader, name, msgtype, rows
        self._layouts: list[tuple[Layout, JointIndex]] = []
        can = name != ALARMS and isinstance(reader.source, McapBag)
        self._attempts = _MOST_ATTEMPTS if can else 0

    def read(self, block: Block, positions: np.ndarray, first: int) -> None:
        """Take messages of a block; ``first`` is the number of its first message."""
        left = positions
        for shape in self._layouts:
            left = self._take(block, left, first, *shape)
        while len(left):
            data = block.message(left[0])
            message = self._reader.deserialize(data, self._msgtype)
            if self._attempts and self._learn(data, message):
                left = self._take(block, left, first, *self._layouts[-1])
            else:
                self._rows.add(self._name, first + int(left[0]), message)
                left = left[1:]

    def _take(
        self, block: Block, positions: np.ndarray, first: int, layout: Layout, index: JointIndex
    ) -> np.ndarray:
        """Read the messages that match a layout; the positions of the others."""
        if not len(positions):
            return positions
        starts = block.start[positions]
        same = layout.match(block.data, starts, block.size[positions])
        found, starts = positions[same], starts[same]
        if len(found) and index is not False:
            self._rows.add_many(
                self._name,
                first + found,
                layout.stamps(block.data, starts),
                self._values(layout, index, block.data, starts),
            )
        return positions[~same]

    def _values(
        self, layout: Layout, index: JointIndex, data: np.ndarray, starts: np.ndarray
    ) -> list[np.ndarray]:
        columns = []
        for field in STREAMS[self._name][1]:
            values = layout.read(data, starts, field).astype(float)
            if isinstance(index, list):  # of joint_states, whose fields may be empty
                values = (
                    values[:, index]
                    if values.shape[1] == self._joints(layout)
                    else np.full((len(starts), len(index)), np.nan)
                )
            elif field in SCALARS:
                values = values[:, 0]
            columns.append(values)
        return columns

    @staticmethod
    def _joints(layout: Layout) -> int:
        return len(layout.strings.get('name', ()))

    def _learn(self, data: bytes, message: Any) -> bool:
        """Learn the layout of a message; whether it has one.

        With it goes the index of the wanted joints: None for other streams, False if a message of
        this shape is of other joints.
        """
        self._attempts -= 1
        if len(self._layouts) == _MOST_LAYOUTS:
            return False
        layout = find_layout(data, self._msgtype, self._reader.typestore_of(self._msgtype))
        if layout is None:
            return False
        index: JointIndex = None
        try:
            expected = self._rows.values(self._name, message)
        except SampleError:
            return False
        if self._name == 'joint_states':
            columns = self._rows.pick(message.name)
            index = False if columns is None else list(columns)
        elif expected is None:
            return False
        # The general reader decides what the bytes mean.
        bytes_, start = np.frombuffer(data, np.uint8), np.zeros(1, int)
        if layout.stamps(bytes_, start)[0] != stamp_of(message.header.stamp):
            return False
        if index is not False and expected is not None:
            values = self._values(layout, index, bytes_, start)
            if not all(
                np.array_equal(np.asarray(e, float), v[0], equal_nan=True)
                for e, v in zip(expected, values)
            ):
                return False
        self._layouts.append((layout, index))
        return True
