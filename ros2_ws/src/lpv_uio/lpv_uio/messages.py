"""ROS messages of the observer's answers."""

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from lpv_core.serial_arm.any_arm import Arm
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate
from lpv_node.serialized import SerializedMessage
from lpv_node.stamps import set_stamp

Fields = dict[str, Any]


class OutputMessages:
    """Messages of one arm.

    Parameters
    ----------
    arm : ArmParameters or SerialArm
        Its name is the frame of every header.
    answer_type : numpy.dtype
        Of the monitor's answers.

    Attributes
    ----------
    record : ndarray, shape (1,)
        The answer that `state`, `fault` and `corrected` are made of.
    state, fault, corrected : SerializedMessage
        lpv_msgs/StateEstimate, lpv_msgs/FaultEstimate and sensor_msgs/JointState.
    """

    def __init__(self, arm: Arm, answer_type: np.dtype) -> None:
        self._frame_id, self.record = arm.name, np.zeros(1, answer_type)
        self._bytes = self.record.view(f'V{answer_type.itemsize}')
        state, fault = _views(self.record['state']), _views(self.record['fault'])
        fault['alarm'] = fault['alarm'].view(bool)
        joints, sensors = list(arm.joint_names), list(arm.sensor_names)
        self.state = SerializedMessage(StateEstimate(header=self._header()), state)
        self.fault = SerializedMessage(
            FaultEstimate(header=self._header(), sensor_names=sensors), fault
        )
        self.corrected = SerializedMessage(
            JointState(header=self._header(), name=joints),
            {'position': state['compensated_position'], 'velocity': state['velocity']},
        )

    def fill(self, record: np.void) -> None:
        """Copy an answer's record."""
        self._bytes[0] = record.tobytes()  # not field by field

    def _header(self) -> Header:
        return Header(frame_id=self._frame_id)

    def alarm(self, stamp: int, fields: Fields) -> FaultAlarm:
        """A new lpv_msgs/FaultAlarm with a stamp [ns] and fields."""
        message = FaultAlarm(header=self._header())
        set_stamp(message.header.stamp, stamp)
        for name, value in fields.items():
            if name in ('onset', 'detected'):
                set_stamp(getattr(message, name), value)
            else:
                setattr(message, name, value)
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


def _views(record: np.ndarray) -> Fields:
    """Memory of the fields of a record, shape (1,)."""
    fields = {name: record[name] for name in record.dtype.names or ()}
    return {name: value[0] if value.ndim > 1 else value for name, value in fields.items()}
