"""Puts the fields of lpv.core.monitoring.message_fields into messages of a bag's typestore."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from lpv.bag.rosbag.metadata import qos_profile
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.support.timestamps import NANOSECONDS

_DTYPES = {'state': np.uint8, 'alarm': np.bool_}


class BagMessages:
    """Message factory of one typestore."""

    def __init__(self, typestore: Typestore, frame_id: str) -> None:
        self._types, self._frame_id = typestore.types, frame_id

    def time(self, nanoseconds: int) -> Any:
        """builtin_interfaces/Time of a stamp [ns]."""
        return self._types['builtin_interfaces/msg/Time'](*divmod(nanoseconds, NANOSECONDS))

    def header(self, stamp: int, frame_id: str | None = None) -> Any:
        """std_msgs/Header of a stamp [ns]."""
        frame_id = self._frame_id if frame_id is None else frame_id
        return self._types['std_msgs/msg/Header'](self.time(stamp), frame_id)

    def make(self, msgtype: str, stamp: int, fields: dict[str, Any]) -> object:
        """A message with a header."""
        values = {}
        for name, value in fields.items():
            if name in ('onset', 'detected'):
                value = self.time(value)
            elif not np.isscalar(value) and name not in ('name', 'sensor_names'):
                value = np.array(value, dtype=_DTYPES.get(name, float))
            values[name] = value
        return self._types[msgtype](header=self.header(stamp), **values)

    def diagnostics(self, stamp: int, status: list[dict[str, Any]]) -> Any:
        """DiagnosticArray of statuses as of `lpv.core.monitoring.message_fields`."""
        status_type = self._types['diagnostic_msgs/msg/DiagnosticStatus']
        pair = self._types['diagnostic_msgs/msg/KeyValue']
        return self._types['diagnostic_msgs/msg/DiagnosticArray'](
            self.header(stamp, ''),
            [
                status_type(
                    **{**fields, 'values': [pair(k, v) for k, v in fields['values'].items()]}
                )
                for fields in status
            ],
        )

    def joint_state(
        self,
        stamp: int,
        names: Iterable[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> Any:
        """sensor_msgs/JointState."""
        values = {'position': position, 'velocity': velocity, 'effort': effort}
        return self.make('sensor_msgs/msg/JointState', stamp, {'name': list(names), **values})


def write_joint_states(
    writer: BagWriter, topic: str, names: Iterable[str], samples: Iterable[tuple[Any, ...]]
) -> int:
    """Write stamps [ns], positions, rates and efforts on a new topic; how many messages."""
    writer.add_topic(topic, 'sensor_msgs/msg/JointState', [qos_profile(True, False, 10)])
    messages, joints, count = BagMessages(writer.typestore, 'base_link'), list(names), 0
    for stamp, *values in samples:
        writer.write(topic, stamp, messages.joint_state(stamp, joints, *values))
        count += 1
    return count
