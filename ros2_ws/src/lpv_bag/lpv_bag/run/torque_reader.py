"""Joint torques from messages of several types."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_core.support.errors import SampleError

EFFORT_TYPES = {
    'lpv_msgs/msg/TorqueCommand': ('torque', None),
    'sensor_msgs/msg/JointState': ('effort', 'name'),
    'std_msgs/msg/Float64MultiArray': ('data', None),
    'trajectory_msgs/msg/JointTrajectoryPoint': ('effort', None),
    'trajectory_msgs/msg/JointTrajectory': ('points.0.effort', 'joint_names'),
}
"""Fields of torques and of joint names by message type; without names, joints are in the order of
the arm file."""


def locate(message: object, msgtype: str, joints: Sequence[str]) -> tuple[list[int], list[float]]:
    """Torques of an arm in a message."""
    path, names = EFFORT_TYPES[msgtype]
    values: Any = message
    for part in path.split('.'):
        if part.isdigit():
            if not len(values):
                raise SampleError(f'{msgtype} holds no torques: {path} is missing')
            values = values[int(part)]
        else:
            values = getattr(values, part)
    if names is None:
        if len(values) != len(joints):
            raise SampleError(f'{msgtype} has {len(values)} torques for {len(joints)} joints')
        return list(range(len(joints))), [float(v) for v in values]
    present = list(getattr(message, names))
    missing = [j for j in joints if present.count(j) != 1]
    if missing:
        raise SampleError(
            f'{msgtype} names joint {missing[0]!r} {present.count(missing[0])} times: {present}'
        )
    if len(values) != len(present):
        raise SampleError(f'{msgtype} has {len(values)} torques for {len(present)} joints')
    index = [present.index(j) for j in joints]
    return index, [float(values[i]) for i in index]


class EffortReader:
    """The latest torques before each measurement."""

    def __init__(self, reader: BagReader, msgtype: str, joints: Sequence[str]) -> None:
        self._reader = reader
        self._msgtype, self._joints = msgtype, tuple(joints)
        self._path = EFFORT_TYPES[msgtype][0]
        self._layout: Layout | None = None
        self._index: list[int] = []
        self._latest = np.full(len(self._joints), math.nan)
        self.rejected: list[str] = []

    def before(self, block: Block, positions: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Torques that were the latest ones at each measurement."""
        values, valid = self._read(block, positions)
        values = np.concatenate([self._latest[None], values[valid]])
        self._latest = values[-1].copy()
        return values[np.searchsorted(positions[valid], measured)]

    def _read(self, block: Block, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.full((len(positions), len(self._joints)), math.nan)
        valid = np.zeros(len(positions), bool)
        if self._layout is None and len(positions):
            self._learn(block.message(positions[0]))
        starts = block.start[positions]
        if self._layout is not None:
            valid = self._layout.match(block.data, starts, block.size[positions])
            found = self._layout.read(block.data, starts[valid], self._path)
            values[valid] = found[:, self._index]
        for i in np.flatnonzero(~valid):
            message = self._reader.deserialize(block.message(positions[i]), self._msgtype)
            try:
                values[i] = locate(message, self._msgtype, self._joints)[1]
                valid[i] = True
            except SampleError as error:
                self.rejected.append(str(error))
        return values, valid

    def _learn(self, data: bytes) -> None:
        message = self._reader.deserialize(data, self._msgtype)
        layout = find_layout(data, self._msgtype, self._reader.typestore_of(self._msgtype))
        try:
            index, values = locate(message, self._msgtype, self._joints)
        except SampleError:
            return
        if layout is None or self._path not in layout.fields:
            return
        found = layout.read(np.frombuffer(data, np.uint8), np.zeros(1, int), self._path)[0, index]
        if np.array_equal(found, values, equal_nan=True):
            self._layout, self._index = layout, index
