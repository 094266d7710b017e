"""The bag that a replay writes: copies of recorded messages, and answers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Connection
from rosbags.typesys.store import Typestore

from lpv.bag.blocks.cdr_layout import Layout
from lpv.bag.blocks.message_blocks import RECORD, Block, record, split
from lpv.bag.rosbag.interfaces import padded_cdr
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import qos_profile
from lpv.bag.rosbag.reading import BagReader
from lpv.bag.rosbag.writing import BagWriter
from lpv.bag.run.measurements import MEASUREMENT_TYPE, Measurements
from lpv.bag.run.record import CORRECTED, DIAGNOSTICS, DIAGNOSTICS_TYPE
from lpv.core.monitoring.answers import Answers
from lpv.core.monitoring.message_fields import alarm_fields
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.support.timestamps import NANOSECONDS

OUTPUTS = {
    'state_estimate': 'lpv_msgs/msg/StateEstimate',
    'fault_estimate': 'lpv_msgs/msg/FaultEstimate',
    CORRECTED: MEASUREMENT_TYPE,
    'fault_alarm': 'lpv_msgs/msg/FaultAlarm',
}
"""Last parts and types of the topics of answers."""
MARK = 'lpv_replay'
"""Key of the bag's custom data by which results of replays are known."""


class Batch(NamedTuple):
    """A block of messages, and the measurements in it."""

    connections: Sequence[Connection]  # that the block counts
    block: Block
    measured: Measurements
    rejected: np.ndarray  # places of those without use
    changed: dict[int, Any]  # messages with injected faults, by place


class ReplayWriter:
    """Writes a new bag, ``bag``, which its user closes."""

    def __init__(
        self, path: str | Path, monitor: SerialSensorMonitor, preset: str, copied: list[Connection]
    ) -> None:
        self._name, arm = monitor.name, monitor.arm
        prefix = self._name.rsplit('/', 1)[0]
        own = {f'{prefix}/{name}': msgtype for name, msgtype in OUTPUTS.items()}
        mark = {MARK: f'arm {arm.name} {arm.sha256()[:12]}'}
        self.bag = BagWriter(path, preset, custom_data=mark)
        self.copied = frozenset(c.topic for c in copied if c.topic not in own)
        for connection in copied:
            if connection.topic in self.copied:
                self.bag.copy_topic(connection)
        for topic, msgtype in (*own.items(), (DIAGNOSTICS, DIAGNOSTICS_TYPE)):
            if topic not in self.copied:
                latched = topic.endswith('/fault_alarm')
                self.bag.add_topic(topic, msgtype, [qos_profile(True, latched, 50)])
        self._messages = BagMessages(self.bag.typestore, arm.name)
        self._channels = {name: self.bag.channel(f'{prefix}/{name}') for name in OUTPUTS}
        zero, joints = np.zeros(1, monitor.answer_type)[0], [0.0] * len(arm.joint_names)
        state, fault = ({n: zero[part][n].tolist() for n in zero[part].dtype.names}
                        for part in ('state', 'fault'))  # fmt: skip
        fault['sensor_names'] = list(arm.sensor_names)
        examples = (
            self._messages.make(OUTPUTS['state_estimate'], 0, state),
            self._messages.make(OUTPUTS['fault_estimate'], 0, fault),
            self._messages.joint_state(0, arm.joint_names, joints, joints, []),
        )
        self._templates = [
            RecordTemplate(self.bag.typestore, message, OUTPUTS[name], self._channels[name])
            for name, message in zip(OUTPUTS, examples)
        ]

    def copies(self, reader: BagReader, batch: Batch) -> list[Block]:
        """Messages of a block that are copied: all but earlier answers of the same monitor."""
        (connections, block), own = batch[:2], f'{self._name}: '.encode()
        channels = np.array(
            [self.bag.channel(c.topic) if c.topic in self.copied else -1 for c in connections]
        )[block.connection]
        for i, connection in enumerate(connections):
            if connection.topic == DIAGNOSTICS and connection.topic in self.copied:
                for k in np.flatnonzero(block.connection == i).tolist():
                    data = block.message(k)
                    if own in data:
                        status = reader.deserialize(data, connection.msgtype).status
                        if status and status[0].name.encode().startswith(own):
                            channels[k] = -1
        changed = b''
        for k, message in batch.changed.items():  # by injected faults; its size may differ now
            if channels[k] >= 0:
                data = padded_cdr(self.bag.typestore, message, MEASUREMENT_TYPE)
                changed += record(int(channels[k]), int(block.time[k]), data)
                channels[k] = -1
        kept = channels >= 0
        return [block.chosen(kept).copied(channels[kept]), split(changed)[0]]

    def write(self, batch: Batch, copies: list[Block], answers: Answers) -> None:
        """Write copies and answers of one block."""
        state, found = answers.state, list[np.ndarray]()
        stamp, time = batch.measured.stamp, batch.block.time[batch.measured.places]
        corrected = {'position': state.compensated_position, 'velocity': state.velocity}
        parts = state, answers.fault, corrected
        is_new = answers.answered & (state.mode < Mode.STALE)
        which = answers.answered, answers.has_fault, is_new
        for template, chosen, values in zip(self._templates, which, parts):
            some = slice(None) if chosen.all() else chosen
            found.append(template.fill(time[some], stamp[some], values, some))
        texts = b''
        for row, event in answers.events:
            fields = alarm_fields(event)
            data = self._messages.cdr(OUTPUTS['fault_alarm'], int(stamp[row]), fields)
            texts += record(self._channels['fault_alarm'], int(time[row]), data)
        for row, status in answers.reports:
            data = self._messages.diagnostics(int(stamp[row]), status)
            texts += record(self.bag.channel(DIAGNOSTICS), int(time[row]), data)
        self.bag.write_chunk(*copies, *found, split(texts)[0])


class RecordTemplate:
    """Records of a type in which only header stamp and numbers change; memory is used again."""

    def __init__(self, typestore: Typestore, message: object, msgtype: str, channel: int) -> None:
        data = padded_cdr(typestore, message, msgtype)
        fields = Layout(data, msgtype, typestore).fields
        self._vectors = {name: vector for name, (vector, _) in fields.items() if vector.itemsize}
        self._record = record(channel, 0, data)
        places = {name: (kind, at) for name, (kind, at, *_) in (RECORD.fields or {}).items()}
        for name, vector in self._vectors.items():
            # Vectors as one piece: one copy in place of one for every element.
            places[name] = (np.dtype(f'V{vector.itemsize}'), RECORD.itemsize + fields[name][1])
        kinds, offsets = zip(*places.values())
        self._dtype = np.dtype(
            {'names': list(places), 'formats': list(kinds), 'offsets': list(offsets),
             'itemsize': len(self._record)}
        )  # fmt: skip
        self._records = np.empty(0, self._dtype)

    def fill(
        self, time: np.ndarray, stamp: np.ndarray, values: Any, chosen: Any = slice(None)
    ) -> np.ndarray:
        """Records of messages, from log times, header stamps, and chosen rows of fields by name."""
        if len(self._records) < len(time):
            one = np.frombuffer(self._record, f'V{len(self._record)}')  # what is no number, too
            self._records = np.repeat(one, len(time)).view(self._dtype)
        records = self._records[: len(time)]
        records['log_time'] = records['publish_time'] = time
        seconds = stamp // NANOSECONDS
        self._set(records, 'header.stamp.sec', seconds)
        self._set(records, 'header.stamp.nanosec', stamp - seconds * NANOSECONDS)
        for name in self._vectors:
            if not name.startswith('header.'):
                self._set(records, name, values[name][chosen])
        return records

    def _set(self, records: np.ndarray, name: str, array: np.ndarray) -> None:
        values = np.ascontiguousarray(array, self._vectors[name].base)
        if values.nbytes != len(records) * self._vectors[name].itemsize:
            raise ValueError(f'{name} has another size in the message')
        if len(values):
            records[name] = np.frombuffer(values, self._dtype[name])
