"""Makes messages, of nodes as of bags, from fields as of lpv.core.monitoring.message_fields."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from lpv.bag.rosbag.interfaces import padded_cdr
from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS

_DTYPES = {'state': np.uint8, 'alarm': np.bool_}


class BagMessages:
    """Message factory of one typestore."""

    def __init__(self, typestore: Typestore, frame_id: str) -> None:
        self._typestore, self._types, self._frame_id = typestore, typestore.types, frame_id

    def time(self, nanoseconds: int) -> Any:
        """builtin_interfaces/Time of a stamp [ns], the last one of its type if it is later."""
        parts = divmod(min(nanoseconds, LAST_STAMP), NANOSECONDS)
        return self._types['builtin_interfaces/msg/Time'](*parts)

    def header(self, stamp: int, frame_id: str | None = None) -> Any:
        """std_msgs/Header of a stamp [ns]."""
        frame_id = self._frame_id if frame_id is None else frame_id
        return self._types['std_msgs/msg/Header'](self.time(stamp), frame_id)

    def cdr(self, msgtype: str, stamp: int, fields: Mapping[str, Any]) -> bytes:
        """CDR of a message with a header."""
        return padded_cdr(self._typestore, self.make(msgtype, stamp, fields), msgtype)

    def make(self, msgtype: str, stamp: int, fields: Mapping[str, Any]) -> object:
        """A message with a header."""
        values = {}
        for name, value in fields.items():
            if name in ('onset', 'detected'):
                value = self.time(value)
            elif not np.isscalar(value) and name not in ('name', 'sensor_names'):
                value = np.array(value, dtype=_DTYPES.get(name, float))
            values[name] = value
        return self._types[msgtype](header=self.header(stamp), **values)

    def diagnostics(self, stamp: int, status: Iterable[Mapping[str, Any]]) -> bytes:
        """CDR of a DiagnosticArray of statuses as of `lpv.core.monitoring.message_fields`."""
        status_type = self._types['diagnostic_msgs/msg/DiagnosticStatus']
        pair = self._types['diagnostic_msgs/msg/KeyValue']
        found = []
        for fields in status:
            values = [pair(key, str(value)) for key, value in fields['values'].items()]
            found.append(status_type(**{**fields, 'values': values}))
        kind = 'diagnostic_msgs/msg/DiagnosticArray'
        message = self._types[kind](self.header(stamp, ''), found)
        return padded_cdr(self._typestore, message, kind)

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
