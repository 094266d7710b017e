"""A recorded run: its streams, the messages they come from, and its alarms."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lpv.core.serial_arm.diagnosis.alarms import Alarm
from lpv.core.support.timestamps import NANOSECONDS

# Stream: (message type, array fields); the name is the last part of the topic's usual name.
STREAMS: dict[str, tuple[str, tuple[str, ...]]] = {
    name: (msgtype, tuple(fields.split()))
    for name, msgtype, fields in (
        ('joint_states', 'sensor_msgs/msg/JointState', 'position velocity effort'),
        ('torque_command', 'lpv_msgs/msg/TorqueCommand', 'torque safe_stop'),
        (
            'state_estimate',
            'lpv_msgs/msg/StateEstimate',
            'position velocity compensated_position measured_position measured_velocity mode',
        ),
        ('fault_estimate', 'lpv_msgs/msg/FaultEstimate', 'estimate bound threshold state alarm'),
        ('reference', 'lpv_msgs/msg/JointReference', 'position velocity acceleration tip_position'),
        ('ground_truth', 'lpv_msgs/msg/GroundTruth', 'position velocity torque fault disturbance'),
    )
}
"""Streams of arrays; ground_truth and reference are absent in recordings of a real arm."""

SCALARS = ('safe_stop', 'mode', 'disturbance')
"""Fields with one value a message; the others have one for each joint or sensor."""


@dataclass(frozen=True)
class RecordedAlarm(Alarm):
    """An alarm event with the stamp of the measurement that decided."""

    stamp: int = 0  # [ns]


@dataclass
class RunRecord:
    """One run; streams are in the order of stamps, of which the last message counts."""

    # header stamps by stream name of `STREAMS`, increasing; absent streams are missing [ns]
    stamps: dict[str, np.ndarray] = field(default_factory=dict)
    # fields by stream name, one row per stamp; units as in the message definitions
    streams: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    alarms: list[RecordedAlarm] = field(default_factory=list)  # in the order of their stamps
    counts: Counter[str] = field(default_factory=Counter)  # messages in the bag by topic, of all
    topics: dict[str, str] = field(default_factory=dict)  # topic by stream name
    joint_names: tuple[str, ...] = ()  # joints of the columns of joint_states
    sensor_names: tuple[str, ...] = ()  # columns of fault_estimate; empty without that stream
    warnings: list[str] = field(default_factory=list)  # tolerated defects of bag and messages

    def get(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stream's own stamps; None if the stream is absent."""
        return self.streams[stream][name] if stream in self.streams else None

    def aligned(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stamps of joint_states, else NaN; None without the stream."""
        values = self.get(stream, name)
        if values is None:
            return None
        base, stamps = self.stamps['joint_states'], self.stamps[stream]
        nearest = np.minimum(np.searchsorted(stamps, base), len(stamps) - 1)
        match = stamps[nearest] == base
        result = np.full((len(base), *values.shape[1:]), np.nan)
        result[match] = values[nearest[match]]
        return result

    @property
    def time(self) -> np.ndarray:
        """Time of each measurement since the first one [s], shape (n,)."""
        return self.seconds(self.stamps['joint_states'])

    def seconds(self, stamps: int | np.ndarray) -> Any:
        """Time of stamps [ns] since the first measurement [s]."""
        # The difference of integers is exact; epoch seconds as floats would lose 100 ns.
        return (stamps - self.stamps['joint_states'][0]) / NANOSECONDS
