"""Measurements of an arm from blocks of sensor_msgs/JointState."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.decoder import Decoder
from lpv_bag.run.streams import stamp_of
from lpv_core.model.joint_order import JointOrder

MEASUREMENT_TYPE = 'sensor_msgs/msg/JointState'
_VECTORS = ('position', 'velocity', 'effort')


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
        self._joints = len(joint_names)
        self._order = JointOrder(joint_names, needs_rates)
        self._decoder = Decoder(reader, MEASUREMENT_TYPE, self._columns)

    def _columns(self, message: Any) -> list[int]:
        self._order.pick(message)
        return list(self._order.indices(message.name))

    def read(self, block: Block, positions: np.ndarray) -> Measurements:
        """Measurements at some positions of a block."""
        count = len(positions)
        vectors = np.zeros((3, count, self._joints))
        result = Measurements(np.zeros(count, np.int64), *vectors)
        for rows, layout, found in self._decoder.read(block, positions):
            if layout is None:
                row = int(rows[0])
                result.stamp[row], result.odd[row] = stamp_of(found.header.stamp), found
                continue
            starts = block.start[positions[rows]]
            result.stamp[rows] = layout.stamps(block.data, starts)
            for name, vector in zip(_VECTORS, vectors):
                values = layout.read(block.data, starts, name)
                vector[rows] = values[:, found] if values.shape[1] else np.nan
        return result

    def places(self, block: Block, positions: np.ndarray, name: str) -> np.ndarray:
        """Offsets of the values of the arm's joints, for callers that change them; or -1."""
        places = np.full((len(positions), self._joints), -1)
        starts, sizes = block.start[positions], block.size[positions]
        for layout, columns in self._decoder.shapes:
            if layout.fields[name].count:
                rows = np.flatnonzero(layout.match(block.data, starts, sizes))
                first = starts[rows] + layout.fields[name].offset
                places[rows] = first[:, None] + 8 * np.array(columns)
        return places
