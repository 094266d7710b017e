"""The bag that a replay writes: copies of recorded messages, and answers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.message_blocks import Block, record, split
from lpv_bag.replay.answer_records import RecordTemplate, as_fields
from lpv_bag.replay.session import Batch
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.rosbag.writing import BagWriter, padded_cdr, qos_profile
from lpv_bag.run.measurements import MEASUREMENT_TYPE
from lpv_bag.run.record import CORRECTED
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.message_fields import alarm_fields
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.diagnosis.alarms import Mode
from lpv_core.support.errors import ConfigError

OUTPUTS = {
    'state': ('state_estimate', 'lpv_msgs/msg/StateEstimate'),
    'fault': ('fault_estimate', 'lpv_msgs/msg/FaultEstimate'),
    'corrected': (CORRECTED, MEASUREMENT_TYPE),
    'alarm': ('fault_alarm', 'lpv_msgs/msg/FaultAlarm'),
}
"""Last parts and types of the topics of answers."""
DIAGNOSTICS, _DIAGNOSTICS_TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'
MARK = 'lpv_replay'
"""Key of the bag's custom data by which results of replays are known."""


class ReplayWriter:
    """Writes the new bag."""

    def __init__(
        self,
        path: str | Path,
        monitor: SerialSensorMonitor,
        prefix: str,
        preset: str,
        copied: Sequence[Connection],
    ) -> None:
        self._monitor, arm = monitor, monitor.arm
        own = {f'{prefix}/{name}': msgtype for name, msgtype in OUTPUTS.values()}
        mark = {MARK: f'arm {arm.name} {arm.sha256()[:12]}'}
        self._bag = BagWriter(path, preset, custom_data=mark)
        self.copied = {c.topic for c in copied if c.topic not in own}
        for connection in copied:
            if connection.topic in self.copied:
                self._bag.copy_topic(connection)
        for topic, msgtype in (*own.items(), (DIAGNOSTICS, _DIAGNOSTICS_TYPE)):
            if topic not in self.copied:
                latched = topic.endswith('/fault_alarm')
                self._bag.add_topic(topic, msgtype, [qos_profile(True, latched, 50)])
        self._messages = BagMessages(self._bag.typestore, arm.name)
        self._channels = {
            kind: self._bag.channel(f'{prefix}/{name}') for kind, (name, _) in OUTPUTS.items()
        }
        zero = np.zeros(1, monitor.answer_type)[0]
        joints = [0.0] * len(arm.joint_names)
        names = {'sensor_names': list(arm.sensor_names)}
        examples = {
            'state': self._messages.make(OUTPUTS['state'][1], 0, as_fields(zero['state'])),
            'fault': self._messages.make(OUTPUTS['fault'][1], 0, as_fields(zero['fault']) | names),
            'corrected': self._messages.joint_state(0, arm.joint_names, joints, joints, []),
        }
        self._templates = {
            kind: RecordTemplate(
                self._bag.typestore, message, OUTPUTS[kind][1], self._channels[kind]
            )
            for kind, message in examples.items()
        }

    def copies(
        self, reader: BagReader, connections: Sequence[Connection], batch: Batch
    ) -> list[Block]:
        """Messages of a block that are copied: all but earlier answers of the same monitor."""
        block, own = batch.block, f'{self._monitor.name}: '.encode()
        channels = np.array(
            [self._bag.channel(c.topic) if c.topic in self.copied else -1 for c in connections]
        )[block.connection]
        for i, connection in enumerate(connections):
            if connection.topic == DIAGNOSTICS and connection.topic in self.copied:
                for k in np.flatnonzero(block.connection == i).tolist():
                    data = block.message(k)
                    if own in data:
                        status = reader.deserialize(data, connection.msgtype).status
                        if status and status[0].name.encode().startswith(own):
                            channels[k] = -1
        found = []
        for row, message in batch.changed.items():  # by injected faults; its size may differ now
            k = int(batch.positions[row])
            if channels[k] >= 0:
                data = padded_cdr(self._bag.typestore, message, MEASUREMENT_TYPE)
                head = record(int(channels[k]), int(block.time[k]), data)
                found.append(split(np.frombuffer(head, np.uint8))[0])
                channels[k] = -1
        kept = channels >= 0
        return [block.chosen(kept).copied(channels[kept]), *found] if kept.any() else found

    def write(self, batch: Batch, copies: list[Block], answers: Answers, result: Any) -> None:
        """Write copies and answers of one block."""
        with result.stage('encoding'):
            parts = [*copies, *self._encoded(batch, answers)]
        with result.stage('writing'):
            self._bag.write_chunk(*parts)

    def _encoded(self, batch: Batch, answers: Answers) -> list[Block | np.ndarray]:
        stamp, time = batch.measured.stamp, batch.block.time[batch.positions]
        state, found = answers.state, []
        corrected = {'position': state.compensated_position, 'velocity': state.velocity}
        for kind, chosen, values in (
            ('state', answers.answered, state),
            ('fault', answers.has_fault, answers.fault),
            ('corrected', answers.answered & (state.mode < Mode.STALE), corrected),
        ):
            some = slice(None) if chosen.all() else chosen
            picked = (
                {name: array[some] for name, array in values.items()}
                if isinstance(values, dict)
                else values[some]
            )
            found.append(self._templates[kind].fill(time[some], stamp[some], picked))
        texts = b''
        for row, event in answers.events:
            message = self._messages.make(OUTPUTS['alarm'][1], int(stamp[row]), alarm_fields(event))
            data = padded_cdr(self._bag.typestore, message, OUTPUTS['alarm'][1])
            texts += record(self._channels['alarm'], int(time[row]), data)
        for row, status in answers.reports:
            message = self._messages.diagnostics(int(stamp[row]), status)
            data = padded_cdr(self._bag.typestore, message, _DIAGNOSTICS_TYPE)
            texts += record(self._bag.channel(DIAGNOSTICS), int(time[row]), data)
        return [*found, split(np.frombuffer(texts, np.uint8))[0]]

    def close(self) -> None:
        """Finish the bag."""
        missing = self._bag.close()
        if missing:
            raise ConfigError(
                'bag', f'cannot be written as a whole: {missing} is missing', str(self._bag.path)
            )
