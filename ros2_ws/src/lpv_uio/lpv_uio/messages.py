"""ROS messages of the observer's answers; none has a value that is NaN."""

import math
from typing import Any

import numpy as np

from lpv.bag.rosbag.interfaces import standard_types
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Mode, SensorState
from lpv_node.serialized import SerializedMessage

Fields = dict[str, Any]
_WITHOUT_NUMBER = {'size': 0.0, 'bound': math.inf, 'confidence': 0.0}
"""What an alarm says of itself in place of NaN: nothing is known."""


class OutputMessages:
    """Messages of one arm, whose name is the frame of every header.

    ``state``, ``fault`` and ``corrected`` are lpv_msgs/StateEstimate, lpv_msgs/FaultEstimate and
    sensor_msgs/JointState, made of the answer in ``record``, shape (1,).
    """

    def __init__(self, arm: SerialArm, answer_type: np.dtype) -> None:
        self._alarms = BagMessages(standard_types(), arm.name)
        self.record = np.zeros(1, answer_type)
        self._bytes = self.record.view(f'V{answer_type.itemsize}')
        self._words, self._last = self.record.view('f8'), np.zeros(1, answer_type)
        self._of_state = _number_places(answer_type, 'state')
        self._of_fault = _number_places(answer_type, 'fault')
        state, fault = _views(self.record['state']), _views(self.record['fault'])
        fault['alarm'] = fault['alarm'].view(bool)
        joints, sensors = list(arm.joint_names), list(arm.sensor_names)
        self.state = SerializedMessage('lpv_msgs/msg/StateEstimate', arm.name, state)
        self.fault = SerializedMessage(
            'lpv_msgs/msg/FaultEstimate', arm.name, fault, sensor_names=sensors
        )
        moving = {'position': state['compensated_position'], 'velocity': state['velocity']}
        self.corrected = SerializedMessage(
            'sensor_msgs/msg/JointState', arm.name, moving, name=joints, effort=[]
        )

    def fill(self, record: np.void) -> bool:
        """Copy an answer's record; whether all its numbers are finite, see `degrade`."""
        self._bytes[0] = record.tobytes()  # not field by field
        is_known = np.isfinite(self._words[self._of_state]).all()
        if not is_known or np.isnan(self._words[self._of_fault]).any():
            self.degrade()
            return False
        self._last[0] = self.record[0]
        return True

    def degrade(self) -> None:
        """Replace values that are not finite by the last ones.

        The estimate is then not trustworthy; it is stale where it is its own values, and so are
        sensors whose values are replaced.  An infinite bound or threshold is none: nothing is
        known.
        """
        state, fault = self.record['state'], self.record['fault']
        last_state, last_fault = self._last['state'], self._last['fault']
        wrong = False
        for name in state.dtype.names or ():
            if state[name].dtype.kind == 'f' and not (finite := np.isfinite(state[name])).all():
                state[name][~finite] = last_state[name][~finite]
                wrong = True
                state['mode'] = max(state['mode'][0], Mode.STALE)
        for name in fault.dtype.names or ():
            if fault[name].dtype.kind == 'f' and (missing := np.isnan(fault[name])).any():
                fault[name][missing] = last_fault[name][missing]
                fault['state'][missing] = SensorState.STALE
                wrong = True
        if wrong:
            state['trustworthy'] = False

    def alarm(self, stamp: int, fields: Fields) -> bytes:
        """lpv_msgs/FaultAlarm with a stamp [ns] and fields, for a publisher."""
        known = {
            name: _WITHOUT_NUMBER[name] if isinstance(value, float) and math.isnan(value) else value
            for name, value in fields.items()
        }
        return self._alarms.cdr('lpv_msgs/msg/FaultAlarm', stamp, known)


def _views(record: np.ndarray) -> Fields:
    """Memory of the fields of a record, shape (1,)."""
    fields = {name: record[name] for name in record.dtype.names or ()}
    return {name: value[0] if value.ndim > 1 else value for name, value in fields.items()}


def _number_places(kind: np.dtype, part: str) -> np.ndarray:
    """Places of the float64 numbers of a part of a record, in words of eight bytes."""
    record = np.zeros(1, kind)
    for name, values in _views(record[part]).items():
        if values.dtype == np.float64:
            record[part][name] = 1.0
    return np.flatnonzero(record.view('f8'))
