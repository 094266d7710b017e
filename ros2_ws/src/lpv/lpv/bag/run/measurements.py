"""Measurements of an arm from blocks of sensor_msgs/JointState, and torques of several types."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lpv.bag.blocks.message_blocks import Block
from lpv.bag.rosbag.reading import BagReader
from lpv.bag.run.decoder import Columns, Decoder, value_at
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.support.errors import SampleError

MEASUREMENT_TYPE = 'sensor_msgs/msg/JointState'
EFFORT_TYPES = {
    'lpv_msgs/msg/TorqueCommand': ('torque', None),
    'sensor_msgs/msg/JointState': ('effort', 'name'),
    'std_msgs/msg/Float64MultiArray': ('data', None),
    'trajectory_msgs/msg/JointTrajectoryPoint': ('effort', None),
    'trajectory_msgs/msg/JointTrajectory': ('points.0.effort', 'joint_names'),
}
"""Fields of torques and of joint names by type; without names, as the arm file orders joints."""


class Measurements(NamedTuple):
    """Measurements of a block, joints in the order of the arm file; NaN where one is missing."""

    places: np.ndarray  # in the block, shape (n,)
    stamp: np.ndarray  # header stamps, shape (n,) [ns]
    position: np.ndarray  # shape (n, joints) [rad]
    velocity: np.ndarray  # likewise [rad/s]
    effort: np.ndarray  # likewise [N m]


class MeasurementReader:
    """Reads measurements of one arm; those without use are counted in ``rejected``."""

    def __init__(self, reader: BagReader, joint_names: Sequence[str]) -> None:
        self._count, self._order = len(joint_names), JointOrder(joint_names)
        fields = ('position', 'velocity', 'effort')
        self._decoder = Decoder(reader, MEASUREMENT_TYPE, fields, self._columns)
        self.rejected = self._decoder.rejected

    def _columns(self, message: Any) -> Columns:
        self._order.pick(message)
        return list(self._order.indices(message.name)), len(message.name)

    def read(self, block: Block, positions: np.ndarray) -> Measurements:
        """Measurements at some positions of a block."""
        found = self._decoder.read(block, positions)
        if found is None:
            return Measurements(*np.zeros((2, 0), np.int64), *np.zeros((3, 0, self._count)))
        return Measurements(*found[:2], *found[2].values())


class EffortReader:
    """The latest torques before each measurement; messages without use are in ``rejected``."""

    def __init__(self, reader: BagReader, msgtype: str, joints: Sequence[str]) -> None:
        self._msgtype, self._joints, self._order = msgtype, tuple(joints), JointOrder(joints)
        self._path, self._names = EFFORT_TYPES[msgtype]
        self._decoder = Decoder(reader, msgtype, [self._path], self._columns)
        self._latest = np.full((1, len(self._joints)), math.nan)
        self.rejected = self._decoder.rejected

    def before(self, block: Block, positions: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Torques that were the latest ones at each measurement."""
        found = self._decoder.read(block, positions)
        places, values = (positions[:0], self._latest) if found is None else (
            found[0], np.concatenate([self._latest, found[2][self._path]]))  # fmt: skip
        self._latest = values[-1:].copy()
        return values[np.searchsorted(places, measured)]

    def _columns(self, message: Any) -> Columns:
        """Columns of the arm's torques in a message."""
        try:
            values = value_at(message, self._path)
        except IndexError:
            text = f'{self._msgtype} holds no torques: {self._path} is missing'
            raise SampleError(text) from None
        names = getattr(message, self._names) if self._names else self._joints
        if len(values) != len(names):
            raise SampleError(f'{self._msgtype} has {len(values)} torques for {len(names)} joints')
        return list(self._order.indices(names)), -1
