"""Puts the fields of lpv_core.monitoring.message_fields into ROS messages."""

from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState

from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate
from lpv_node.sequences import doubles
from lpv_node.stamps import set_stamp

Fields = dict[str, Any]
M = TypeVar('M', StateEstimate, FaultEstimate, FaultAlarm, JointState)


class OutputMessages:
    """Messages of one arm; those of the fast topics are reused from call to call.

    Parameters
    ----------
    frame_id : str
        Of every header: the arm's name.
    """

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._state, self._fault = self._headed(StateEstimate()), self._headed(FaultEstimate())
        self._corrected = self._headed(JointState())

    def _headed(self, message: M) -> M:
        message.header.frame_id = self._frame_id
        return message

    def state(self, stamp: int, fields: Fields) -> StateEstimate:
        """lpv_msgs/StateEstimate with a stamp [ns] and fields."""
        return _fill(self._state, stamp, fields)

    def fault(self, stamp: int, fields: Fields) -> FaultEstimate:
        """lpv_msgs/FaultEstimate with a stamp [ns] and fields."""
        return _fill(self._fault, stamp, fields)

    def corrected(self, stamp: int, fields: Fields) -> JointState:
        """sensor_msgs/JointState with a stamp [ns] and fields."""
        return _fill(self._corrected, stamp, fields)

    def alarm(self, stamp: int, fields: Fields) -> FaultAlarm:
        """A new lpv_msgs/FaultAlarm with a stamp [ns] and fields."""
        message = self._headed(FaultAlarm())
        times = {name: fields[name] for name in ('onset', 'detected')}
        _fill(message, stamp, {k: v for k, v in fields.items() if k not in times})
        for name, value in times.items():
            set_stamp(getattr(message, name), value)
        return message

    @staticmethod
    def diagnostics(stamp: int, status: list[Fields]) -> DiagnosticArray:
        """A new diagnostic_msgs/DiagnosticArray with a stamp [ns] and statuses."""
        array = DiagnosticArray(
            status=[
                DiagnosticStatus(
                    **{
                        **fields,
                        'level': bytes([fields['level']]),
                        'values': [KeyValue(key=k, value=v) for k, v in fields['values'].items()],
                    }
                )
                for fields in status
            ]
        )
        set_stamp(array.header.stamp, stamp)
        return array


def _fill(message: M, stamp: int, fields: Fields) -> M:
    set_stamp(message.header.stamp, stamp)
    for name, value in fields.items():
        setattr(message, name, doubles(value) if isinstance(value, np.ndarray) else value)
    return message
