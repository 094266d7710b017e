"""The bag that a replay writes: copies of recorded messages, and answers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.chunk_assembly import Buffer, ChunkAssembly
from lpv_bag.blocks.chunk_writing import ChunkBagWriter
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.replay.answer_records import (
    ALARM_TYPE,
    DIAGNOSTICS_TYPE,
    FAULT_TYPE,
    STATE_TYPE,
    AnswerEncoder,
    is_corrected,
    padded_cdr,
)
from lpv_bag.replay.session import Batch, ReplayResult
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.offered_qos import qos_profile
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.measurements import MEASUREMENT_TYPE
from lpv_bag.run.record import CORRECTED
from lpv_core.monitoring.answers import Answers
from lpv_core.monitoring.factory import Monitor
from lpv_core.monitoring.message_fields import alarm_fields
from lpv_core.support.errors import ConfigError

OUTPUTS = {
    'state': ('state_estimate', STATE_TYPE),
    'fault': ('fault_estimate', FAULT_TYPE),
    'corrected': (CORRECTED, MEASUREMENT_TYPE),
    'alarm': ('fault_alarm', ALARM_TYPE),
}
"""Last parts and types of the topics of answers."""
DIAGNOSTICS = '/diagnostics'
MARK = 'lpv_replay'
"""Key of the bag's custom data by which results of replays are known."""
_COPY, _STATE, _FAULT, _CORRECTED, _OTHERS = range(5)
_SLOTS = 5


class ReplayWriter:
    """Writes the new bag."""

    def __init__(self, path: str | Path, monitor: Monitor, prefix: str, preset: str) -> None:
        self._monitor, self._prefix = monitor, prefix
        self._own = {f'{prefix}/{name}': msgtype for name, msgtype in OUTPUTS.values()}
        self._bag = ChunkBagWriter(
            path, preset, {MARK: f'arm {monitor.arm.name} {monitor.arm.sha256()[:12]}'}
        )
        self._copied: set[str] = set()
        self._buffer = Buffer()

    def announce(self, connections: Sequence[Connection], copy: bool) -> None:
        """Announce topics."""
        for connection in connections if copy else ():
            if connection.topic not in self._own:
                self._bag.copy_topic(connection)
                self._copied.add(connection.topic)
        for topic, msgtype in (*self._own.items(), (DIAGNOSTICS, DIAGNOSTICS_TYPE)):
            if topic not in self._copied:
                latched = topic.endswith('/fault_alarm')
                self._bag.add_topic(topic, msgtype, [qos_profile(True, latched, 50)])
        channels = {
            kind: self._bag.channel(f'{self._prefix}/{name}') for kind, (name, _) in OUTPUTS.items()
        }
        channels['diagnostics'] = self._bag.channel(DIAGNOSTICS)
        arm = self._monitor.arm
        self._encoder = AnswerEncoder(
            BagMessages(self._bag.typestore, arm.name), self._bag.typestore, self._monitor, channels
        )

    def is_copied(self, connection: Connection) -> bool:
        """Whether messages of a connection are copied."""
        return connection.topic in self._copied

    def choose(
        self, reader: BagReader, connections: Sequence[Connection], block: Block
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which messages of a block are copied, and to which channels."""
        channels = np.array(
            [self._bag.channel(c.topic) if self.is_copied(c) else -1 for c in connections]
        )[block.connection]
        for i, connection in enumerate(connections):
            if connection.topic == DIAGNOSTICS and self.is_copied(connection):
                for k in np.flatnonzero(block.connection == i):
                    status = reader.deserialize(block.message(int(k)), connection.msgtype).status
                    if status and status[0].name.startswith(f'{self._monitor.name}: '):
                        channels[k] = -1
        copied = np.flatnonzero(channels >= 0)
        return copied, channels[copied]

    def write(self, batch: Batch, answers: Answers, result: ReplayResult) -> None:
        """Write copies and answers of one block."""
        with result.stage('encoding'):
            data, index = self._assemble(batch, answers)
        with result.stage('writing'):
            if index:
                self._bag.write_chunk(data, index)

    def _assemble(self, batch: Batch, answers: Answers) -> tuple[np.ndarray, dict[int, Any]]:
        block, stamp = batch.block, batch.measured.stamp
        time = block.time[batch.positions]
        # Without copies only measurements need places.
        rows = batch.positions if len(batch.copied) else np.arange(len(stamp))
        assembly = ChunkAssembly(
            _SLOTS * (len(block) if len(batch.copied) else len(stamp)), self._buffer
        )
        self._add_copies(assembly, batch)
        for rank, chosen, encode in (
            (_STATE, answers.answered, self._encoder.state),
            (_FAULT, answers.has_fault, self._encoder.fault),
            (_CORRECTED, is_corrected(answers), self._encoder.corrected),
        ):
            some = slice(None) if chosen.all() else chosen
            assembly.add_rows(_SLOTS * rows[some] + rank, encode(time, stamp, answers, some))
        channels = self._encoder.channels
        for row, event in answers.events:
            assembly.add_message(
                _SLOTS * rows[row] + _OTHERS,
                channels['alarm'],
                int(time[row]),
                self._encoder.alarm(int(stamp[row]), alarm_fields(event)),
            )
        for row, status in answers.reports:
            assembly.add_message(
                _SLOTS * rows[row] + _OTHERS,
                channels['diagnostics'],
                int(time[row]),
                self._encoder.diagnostics(int(stamp[row]), status),
            )
        return assembly.finish()

    def _add_copies(self, assembly: ChunkAssembly, batch: Batch) -> None:
        copied, channels = batch.copied, batch.channels
        if batch.changed and len(copied):
            # Messages that were changed by injected faults, and whose size may differ now.
            changed = {int(batch.positions[row]): message for row, message in batch.changed.items()}
            for i in np.flatnonzero(np.isin(copied, list(changed))):
                data = padded_cdr(self._bag.typestore, changed[int(copied[i])], MEASUREMENT_TYPE)
                assembly.add_message(
                    _SLOTS * copied[i] + _COPY,
                    int(channels[i]),
                    int(batch.block.time[copied[i]]),
                    data,
                )
            left = ~np.isin(copied, list(changed))
            copied, channels = copied[left], channels[left]
        assembly.add_copies(_SLOTS * copied + _COPY, batch.block, copied, channels)

    def close(self) -> None:
        """Finish the bag."""
        missing = self._bag.close()
        if missing:
            raise ConfigError(
                'bag', f'cannot be written as a whole: {missing} is missing', str(self._bag.path)
            )

    def abandon(self) -> None:
        """Close files, whatever they hold."""
        self._bag.close()
