"""Measurements of an arm from blocks of sensor_msgs/JointState."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.decoder import Decoder
from lpv_core.monitoring.joint_order import JointOrder
from lpv_core.support.errors import SampleError

MEASUREMENT_TYPE = 'sensor_msgs/msg/JointState'
_VECTORS = ('position', 'velocity', 'effort')


@dataclass
class Measurements:
    """Measurements of a block; n of them, joints in the order of the arm file."""

    stamp: np.ndarray  # header stamps [ns]; shape (n,)
    position: np.ndarray  # [rad]; zero for those without use; shape (n, joints)
    velocity: np.ndarray  # [rad/s]; likewise, NaN where a message carries none
    effort: np.ndarray  # [N m]; likewise
    # messages by row: those without use, whose joints are not the arm's or whose sizes are wrong
    unusable: dict[int, Any] = field(default_factory=dict)
    # and those that are not like the ones before
    single: dict[int, Any] = field(default_factory=dict)


class MeasurementReader:
    """Reads measurements of one arm."""

    def __init__(
        self, reader: BagReader, joint_names: Sequence[str], needs_rates: bool = True
    ) -> None:
        self._joints = len(joint_names)
        self._order = JointOrder(joint_names, needs_rates)
        self._decoder = Decoder(reader, MEASUREMENT_TYPE, _VECTORS, self._columns)

    def _columns(self, message: Any) -> list[int]:
        self._order.pick(message)
        return list(self._order.indices(message.name))

    def read(self, block: Block, positions: np.ndarray) -> Measurements:
        """Measurements at some positions of a block."""
        vectors = np.zeros((3, len(positions), self._joints))
        result = Measurements(np.zeros(len(positions), np.int64), *vectors)
        for part in self._decoder.read(block, positions):
            result.stamp[part.rows] = part.stamps
            if isinstance(part.learnt, SampleError):
                result.unusable[int(part.rows[0])] = part.message
                continue
            if part.message is not None:
                result.single[int(part.rows[0])] = part.message
            for name, vector in zip(_VECTORS, vectors):
                values = part.values[name]
                vector[part.rows] = values[:, part.learnt] if values.shape[1] else np.nan
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
