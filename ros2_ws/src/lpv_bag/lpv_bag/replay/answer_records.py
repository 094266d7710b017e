"""Answers as records of messages, thousands at once, byte for byte as one by one."""

from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from lpv_bag.blocks.cdr_layout import Layout
from lpv_bag.blocks.chunk_writing import OFFSETS, RECORD, record_head
from lpv_bag.blocks.mcap_blocks import RECORD_HEADER
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.run.measurements import MEASUREMENT_TYPE
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.factory import Monitor
from lpv_core.observer.sampled_observer import Mode
from lpv_core.support.timestamps import NANOSECONDS

STATE_TYPE, FAULT_TYPE = 'lpv_msgs/msg/StateEstimate', 'lpv_msgs/msg/FaultEstimate'
ALARM_TYPE = 'lpv_msgs/msg/FaultAlarm'
DIAGNOSTICS_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


def padded_cdr(typestore: Typestore, message: object, msgtype: str) -> bytes:
    """CDR of a message, padded to four bytes."""
    data = bytes(typestore.serialize_cdr(message, msgtype))
    return data + bytes(-len(data) % 4)


class RecordTemplate:
    """Records of one message type in which only the header stamp and numbers change.

    All numbers have to be given in every call, or in none: memory is used again.
    """

    def __init__(self, typestore: Typestore, message: object, msgtype: str, channel: int) -> None:
        data = padded_cdr(typestore, message, msgtype)
        layout = Layout(data, msgtype, typestore)
        self._record = record_head(channel, 0, len(data)) + data
        fields = {name: (RECORD[name], OFFSETS[name]) for name in OFFSETS}
        for name, field in layout.fields.items():
            if not field.count:
                continue
            # Vectors as one piece: one copy in place of one for every element.
            size = np.dtype(field.dtype).itemsize * field.count
            fields[name] = (np.dtype(f'V{size}'), RECORD_HEADER + field.offset)
        self._dtype = np.dtype(
            {
                'names': list(fields),
                'formats': [f[0] for f in fields.values()],
                'offsets': [f[1] for f in fields.values()],
                'itemsize': len(self._record),
            }
        )
        self._fields, self._records = layout.fields, np.empty(0, self._dtype)

    def fill(
        self, time: np.ndarray, stamp: np.ndarray, values: dict[str, np.ndarray] | np.ndarray
    ) -> np.ndarray:
        """Records of messages."""
        if len(self._records) < len(time):
            size = len(self._record)
            self._records = np.full(
                len(time), np.frombuffer(self._record, f'V{size}')[0], f'V{size}'
            ).view(self._dtype)
        records = self._records[: len(time)]
        records['log_time'] = records['publish_time'] = time
        seconds = stamp // NANOSECONDS
        self._set(records, 'header.stamp.sec', seconds)
        self._set(records, 'header.stamp.nanosec', stamp - seconds * NANOSECONDS)
        if isinstance(values, dict):
            for name, array in values.items():
                self._set(records, name, array)
        else:
            self._copy(np.asarray(values), records)
        return records

    def _set(self, records: np.ndarray, name: str, array: np.ndarray) -> None:
        values = np.ascontiguousarray(array, self._fields[name].dtype)
        records[name] = np.frombuffer(values, self._dtype[name]) if len(values) else ()

    def _copy(self, values: np.ndarray, records: np.ndarray) -> None:
        """Copy fields; those that are contiguous in both layouts are copied as one piece."""
        runs: list[list[int]] = []
        for name, (kind, start, *_) in (values.dtype.fields or {}).items():
            field = self._fields[name]
            to = RECORD_HEADER + field.offset
            if kind.itemsize != np.dtype(field.dtype).itemsize * field.count:
                raise ValueError(f'{name} has another size in the message')
            if runs and (runs[-1][0] + runs[-1][2], runs[-1][1] + runs[-1][2]) == (start, to):
                runs[-1][2] += kind.itemsize
            else:
                runs.append([start, to, kind.itemsize])
        for start, to, size in runs:
            _piece(records, to, size)['piece'] = _piece(values, start, size)['piece']


def _piece(array: np.ndarray, offset: int, size: int) -> np.ndarray:
    """View of some bytes of each element of a structured array."""
    return array.view(
        np.dtype(
            {
                'names': ['piece'],
                'formats': [f'V{size}'],
                'offsets': [offset],
                'itemsize': array.dtype.itemsize,
            }
        )
    )


def is_corrected(answers: Answers) -> np.ndarray:
    """Rows with corrected joint states, as `lpv_core.monitoring.message_fields.corrected_fields`.

    The result has shape (n,).
    """
    return answers.answered & (answers.state.mode < Mode.STALE)


class AnswerEncoder:
    """Encodes the answers of one monitor."""

    def __init__(
        self,
        messages: BagMessages,
        typestore: Typestore,
        monitor: Monitor,
        channels: dict[str, int],
    ) -> None:
        self._messages, self._typestore, self.channels = messages, typestore, channels
        self._answer_type, arm = monitor.answer_type, monitor.arm
        self._state = self._template(STATE_TYPE, 'state', {})
        self._fault = self._template(FAULT_TYPE, 'fault', {'sensor_names': list(arm.sensor_names)})
        zero = [0.0] * len(arm.joint_names)
        self._corrected = RecordTemplate(
            typestore,
            messages.joint_state(0, arm.joint_names, zero, zero, []),
            MEASUREMENT_TYPE,
            channels['corrected'],
        )

    def _template(self, msgtype: str, kind: str, fields: dict[str, Any]) -> RecordTemplate:
        zero = np.zeros(1, self._answer_type[kind])[0]
        fields = {**fields, **{name: zero[name].tolist() for name in zero.dtype.names}}
        return RecordTemplate(
            self._typestore, self._messages.make(msgtype, 0, fields), msgtype, self.channels[kind]
        )

    def state(
        self, time: np.ndarray, stamp: np.ndarray, answers: Answers, chosen: slice | np.ndarray
    ) -> np.ndarray:
        """Records of lpv_msgs/StateEstimate for some rows of the answers."""
        return self._state.fill(time[chosen], stamp[chosen], answers.state[chosen])

    def fault(
        self, time: np.ndarray, stamp: np.ndarray, answers: Answers, chosen: slice | np.ndarray
    ) -> np.ndarray:
        """Records of lpv_msgs/FaultEstimate for some rows of the answers."""
        return self._fault.fill(time[chosen], stamp[chosen], answers.fault[chosen])

    def corrected(
        self, time: np.ndarray, stamp: np.ndarray, answers: Answers, chosen: slice | np.ndarray
    ) -> np.ndarray:
        """Records of sensor_msgs/JointState with confirmed faults removed, for some rows."""
        state = answers.state
        values = {
            'position': state.compensated_position[chosen],
            'velocity': state.velocity[chosen],
        }
        return self._corrected.fill(time[chosen], stamp[chosen], values)

    def alarm(self, stamp: int, fields: dict[str, Any]) -> bytes:
        """CDR of an lpv_msgs/FaultAlarm."""
        message = self._messages.make(ALARM_TYPE, stamp, fields)
        return padded_cdr(self._typestore, message, ALARM_TYPE)

    def diagnostics(self, stamp: int, status: list[dict[str, Any]]) -> bytes:
        """CDR of a diagnostic_msgs/DiagnosticArray."""
        message = self._messages.diagnostics(stamp, status)
        return padded_cdr(self._typestore, message, DIAGNOSTICS_TYPE)
