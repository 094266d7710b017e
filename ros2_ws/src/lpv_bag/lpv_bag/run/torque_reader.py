"""Joint torques from messages of several types."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.decoder import Decoder, value_at
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
        self._decoder = Decoder(reader, msgtype, [self._path], self._columns)
        self._latest = np.full(len(self._joints), math.nan)
        self.rejected: list[str] = []

    def before(self, block: Block, positions: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Torques that were the latest ones at each measurement."""
        found = np.full((len(positions), len(self._joints)), math.nan)
        valid = np.ones(len(positions), bool)
        for part in self._decoder.read(block, positions):
            if isinstance(part.learnt, SampleError):
                valid[part.rows] = False
                self.rejected.append(str(part.learnt))
            else:
                found[part.rows] = part.values[self._path][:, part.learnt]
        values = np.concatenate([self._latest[None], found[valid]])
        self._latest = values[-1].copy()
        return values[np.searchsorted(positions[valid], measured)]

    def _columns(self, message: Any) -> list[int]:
        """Columns of the arm's torques in a message."""
        try:
            values = value_at(message, self._path)
        except IndexError:
            text = f'{self._msgtype} holds no torques: {self._path} is missing'
            raise SampleError(text) from None
        names = list(getattr(message, self._names)) if self._names else list(self._joints)
        for joint in self._joints:
            if names.count(joint) != 1:
                raise SampleError(
                    f'{self._msgtype} names joint {joint!r} {names.count(joint)} times: {names}'
                )
        if len(values) != len(names):
            raise SampleError(f'{self._msgtype} has {len(values)} torques for {len(names)} joints')
        return [names.index(joint) for joint in self._joints]
