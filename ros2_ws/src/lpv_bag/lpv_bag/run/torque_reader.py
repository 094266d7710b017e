"""Joint torques from messages of several types."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.decoder import Decoder
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


class EffortReader:
    """The latest torques before each measurement."""

    def __init__(self, reader: BagReader, msgtype: str, joints: Sequence[str]) -> None:
        self._msgtype, self._joints = msgtype, tuple(joints)
        self._path, self._names = EFFORT_TYPES[msgtype]
        self._decoder = Decoder(reader, msgtype, lambda message: self._locate(message)[0])
        self._latest = np.full(len(self._joints), math.nan)
        self.rejected: list[str] = []

    def before(self, block: Block, positions: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Torques that were the latest ones at each measurement."""
        found = np.full((len(positions), len(self._joints)), math.nan)
        valid = np.ones(len(positions), bool)
        for rows, layout, what in self._decoder.read(block, positions):
            if layout is not None:
                starts = block.start[positions[rows]]
                found[rows] = layout.read(block.data, starts, self._path)[:, what]
                continue
            try:
                found[rows] = self._locate(what)[1]
            except SampleError as error:
                valid[rows] = False
                self.rejected.append(str(error))
        values = np.concatenate([self._latest[None], found[valid]])
        self._latest = values[-1].copy()
        return values[np.searchsorted(positions[valid], measured)]

    def _locate(self, message: Any) -> tuple[list[int], list[float]]:
        """Columns and values of the arm's torques in a message."""
        values: Any = message
        for part in self._path.split('.'):
            if part.isdigit():
                if not len(values):
                    raise SampleError(f'{self._msgtype} holds no torques: {self._path} is missing')
                values = values[int(part)]
            else:
                values = getattr(values, part)
        names = list(getattr(message, self._names)) if self._names else list(self._joints)
        for joint in self._joints:
            if names.count(joint) != 1:
                raise SampleError(
                    f'{self._msgtype} names joint {joint!r} {names.count(joint)} times: {names}'
                )
        if len(values) != len(names):
            raise SampleError(f'{self._msgtype} has {len(values)} torques for {len(names)} joints')
        columns = [names.index(joint) for joint in self._joints]
        return columns, [float(values[i]) for i in columns]
