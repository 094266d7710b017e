"""Measurements of an arm from blocks of sensor_msgs/JointState."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.record import stamp_of
from lpv_core.model.joint_order import JointOrder
from lpv_core.support.errors import SampleError

MEASUREMENT_TYPE = 'sensor_msgs/msg/JointState'
_VECTORS = ('position', 'velocity', 'effort')
_MOST_LAYOUTS = 8


@dataclass
class Measurements:
    """Measurements of a block; n of them, joints in the order of the arm file."""

    stamp: np.ndarray  # header stamps [ns]; shape (n,)
    position: np.ndarray  # [rad]; zero for the odd ones; shape (n, joints)
    velocity: np.ndarray  # [rad/s]; likewise, NaN where a message carries none
    effort: np.ndarray  # [N m]; likewise
    # deserialised messages by row, where joints are not those of the arm, sizes are wrong, or the
    # message is not like those before
    odd: dict[int, Any] = field(default_factory=dict)


class MeasurementReader:
    """Reads measurements of one arm."""

    def __init__(
        self, reader: BagReader, joint_names: Sequence[str], needs_rates: bool = True
    ) -> None:
        self._reader, self._joints = reader, len(joint_names)
        self._order = JointOrder(joint_names, needs_rates)
        self._layouts: list[tuple[Layout, list[int]]] = []

    def read(self, block: Block, positions: np.ndarray) -> Measurements:
        """Measurements at some positions of a block."""
        count = len(positions)
        position, velocity, effort = np.zeros((3, count, self._joints))
        result = Measurements(np.zeros(count, np.int64), position, velocity, effort)
        left = np.arange(count)
        for layout, index in self._layouts:
            left = self._fill(result, block, positions, left, layout, index)
        while len(left):
            row = int(left[0])
            data = block.message(positions[row])
            message = self._reader.deserialize(data, MEASUREMENT_TYPE)
            if self._learn(data, message):
                left = self._fill(result, block, positions, left, *self._layouts[-1])
            else:
                result.stamp[row] = stamp_of(message.header.stamp)
                result.odd[row] = message
                left = left[1:]
        return result

    def places(self, block: Block, positions: np.ndarray, name: str) -> np.ndarray:
        """Offsets of the values of the arm's joints, for callers that change them; or -1."""
        found = np.full((len(positions), self._joints), -1)
        starts, sizes = block.start[positions], block.size[positions]
        for layout, index in self._layouts:
            if not layout.fields[name].count:
                continue
            rows = np.flatnonzero(layout.match(block.data, starts, sizes))
            first = starts[rows] + layout.fields[name].offset
            found[rows] = first[:, None] + 8 * np.array(index)
        return found

    def _fill(
        self,
        result: Measurements,
        block: Block,
        positions: np.ndarray,
        rows: np.ndarray,
        layout: Layout,
        index: list[int],
    ) -> np.ndarray:
        """Fill in the rows that match a layout; the rows that do not."""
        if not len(rows):
            return rows
        starts = block.start[positions[rows]]
        same = layout.match(block.data, starts, block.size[positions[rows]])
        every = len(rows) == len(positions) and same.all()
        if not every:
            starts = starts[same]
        chosen = slice(None) if every else rows[same]
        result.stamp[chosen] = layout.stamps(block.data, starts)
        for name in _VECTORS:
            values = layout.read(block.data, starts, name)
            getattr(result, name)[chosen] = values[:, index] if values.shape[1] else np.nan
        return rows[~same]

    def _learn(self, data: bytes, message: Any) -> bool:
        """Learn the layout of a message; whether it has one."""
        if len(self._layouts) == _MOST_LAYOUTS:
            return False
        try:
            expected = self._order.pick(message)
        except SampleError:
            return False
        layout = find_layout(data, MEASUREMENT_TYPE, self._reader.typestore_of(MEASUREMENT_TYPE))
        if layout is None:
            return False
        index = list(self._order.indices(message.name))
        bytes_ = np.frombuffer(data, np.uint8)
        # The general reader decides what the bytes mean.
        same = layout.stamps(bytes_, np.zeros(1, int))[0] == stamp_of(message.header.stamp)
        for name, values in zip(_VECTORS, expected):
            found = layout.read(bytes_, np.zeros(1, int), name)[0]
            found = found[index] if found.size else np.full(self._joints, np.nan)
            same = same and np.array_equal(found, values, equal_nan=True)
        if same:
            self._layouts.append((layout, index))
        return bool(same)
