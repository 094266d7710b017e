"""Rows of a run's streams as they are read, and the arrays that are made of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.errors import BagError
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.decoder import Decoder
from lpv_bag.run.streams import ALARMS, SCALARS, STREAMS, RecordedAlarm, RunRecord, stamp_of
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent, Mode
from lpv_core.support.errors import SampleError

Rows = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]
"""Positions in a block, header stamps [ns], and values by field."""


class StreamReader:
    """Reads the messages of one stream; those whose arrays do not fit are left out and counted."""

    def __init__(self, reader: BagReader, name: str, joints: Sequence[str] = ()) -> None:
        self.joints, self._count = tuple(joints), len(joints)
        self.missing: tuple[str, str] | None = None  # a joint that a message does not have, and all
        self.sensors: tuple[str, ...] = ()
        self.misfits = 0
        self._name, (msgtype, self._fields) = name, STREAMS[name]
        self._lengths: dict[str, int] = {}
        self._decoder = Decoder(reader, msgtype, self._fields, self._columns)

    def _columns(self, message: Any) -> Any:
        """Columns that are taken of a message's arrays; None for messages of other joints.

        Drivers sort joints as they like, and have more.  A message of other joints only (a
        gripper's, on the same topic) is not about this arm.
        """
        if self._name != 'joint_states':
            return self._fitting(message)
        names = list(message.name)
        self.joints = self.joints or tuple(names)
        absent = [name for name in self.joints if name not in names]
        if absent:
            self.missing = (absent[0], ', '.join(names) or 'no joint')
            return None
        return [names.index(name) for name in self.joints], len(names)

    def _fitting(self, message: Any) -> tuple[slice, int]:
        """All arrays are for the same joints, and as long as in the messages before."""
        arrays = {name: getattr(message, name) for name in self._fields if name not in SCALARS}
        if self._name == 'fault_estimate':
            arrays['sensor_names'] = message.sensor_names
        found = {name: len(array) for name, array in arrays.items()}
        joints = {length for name, length in found.items() if name != 'tip_position'}
        if len(joints) > 1 or (self._count and joints != {self._count}):
            raise SampleError(f'{self._name} has arrays of {sorted(joints)} values')
        if (self._lengths or found) != found:
            raise SampleError(f'{self._name} has arrays of other lengths than before')
        self._lengths = found
        self.sensors = self.sensors or tuple(arrays.get('sensor_names', ()))
        return slice(None), -1

    def read(self, block: Block, positions: np.ndarray) -> Rows | None:
        """Messages at some positions of a block, or None."""
        parts = []
        for part in self._decoder.read(block, positions):
            if isinstance(part.learnt, SampleError):
                self.misfits += 1
            elif part.learnt is not None:
                chosen = {name: _picked(name, v, *part.learnt) for name, v in part.values.items()}
                parts.append((positions[part.rows], part.stamps, chosen))
        if not parts:
            return None
        places, stamps = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        found = {name: np.concatenate([part[2][name] for part in parts]) for name in self._fields}
        if self._name == 'state_estimate':  # without an estimate its values mean nothing
            known = found['mode'] != Mode.NO_ESTIMATE
            places, stamps = places[known], stamps[known]
            found = {name: values[known] for name, values in found.items()}
        return places, stamps, found


def _picked(name: str, values: np.ndarray, columns: Any, width: int) -> np.ndarray:
    """Columns of a field; NaN where a JointState has none of a kind."""
    if name in SCALARS:
        return values[:, 0].astype(float)
    if width in (-1, values.shape[1]):
        return values[:, columns].astype(float)
    return np.full((len(values), len(columns)), np.nan)


def read_streams(
    reader: BagReader,
    chosen: dict[str, list[Connection]],
    record: RunRecord,
    joint_names: Sequence[str] | None,
) -> None:
    """Fill a record with all messages of some streams; BagError if measurements are missing."""
    pairs = [(name, c) for name, connections in chosen.items() for c in connections]
    streams = {
        name: StreamReader(reader, name, joint_names or ()) for name in chosen if name != ALARMS
    }
    parts: dict[str, list[Rows]] = {name: [] for name in streams}
    alarms: dict[tuple[int, int, int], RecordedAlarm] = {}
    number = 0
    for block in reader.blocks([connection for _, connection in pairs]):
        for i, (name, connection) in enumerate(pairs):
            positions = np.flatnonzero(block.connection == i)
            if name != ALARMS and len(positions):
                rows = streams[name].read(block, positions)
                if rows is not None:
                    parts[name].append((number + rows[0], *rows[1:]))
            for k in positions.tolist() if name == ALARMS else ():
                alarm = _alarm(reader.deserialize(block.message(k), connection.msgtype))
                # Latched events are delivered again to late subscribers.
                alarms[alarm.stamp, alarm.sensor_index, alarm.event] = alarm
        number += len(block)
    warnings = []
    for name, stream in streams.items():
        if any(len(rows[1]) for rows in parts[name]):
            warnings += _fill(record, name, parts[name])
        if stream.misfits:
            warnings.append(
                f'{record.topics[name]}: {stream.misfits} messages whose number of joints does '
                'not fit are left out'
            )
    record.alarms = [alarms[key] for key in sorted(alarms)]
    if 'fault_estimate' in streams:
        record.sensor_names = streams['fault_estimate'].sensors
    if 'joint_states' in streams:
        record.joint_names = streams['joint_states'].joints
        _check_measurements(record, streams['joint_states'].missing)
    record.warnings += warnings


def _fill(record: RunRecord, name: str, parts: list[Rows]) -> list[str]:
    """Rows by stamp into the record; of one stamp the last message counts."""
    order = np.argsort(np.concatenate([part[0] for part in parts]), kind='stable')
    stamps = np.concatenate([part[1] for part in parts])[order]
    # np.unique gives the first of equal ones: reversed, that is the last message.
    record.stamps[name], last = np.unique(stamps[::-1], return_index=True)
    rows = order[len(order) - 1 - last]
    record.streams[name] = {
        field: np.concatenate([part[2][field] for part in parts])[rows]
        for field in STREAMS[name][1]
    }
    warnings, topic = [], record.topics[name]
    backwards = int(np.sum(stamps[1:] < np.maximum.accumulate(stamps)[:-1]))
    if backwards:
        warnings.append(
            f'{topic}: time goes backwards {backwards} times, messages are sorted by their stamps'
        )
    if len(stamps) > len(last):
        warnings.append(
            f'{topic}: {len(stamps) - len(last)} messages have the stamp of another one, the last '
            'one of each stamp counts'
        )
    return warnings


def _check_measurements(record: RunRecord, missing: tuple[str, str] | None) -> None:
    count, topic = len(record.stamps.get('joint_states', ())), record.topics['joint_states']
    if count == 0 and missing:
        raise BagError(f'joint {missing[0]!r} is not in joint_states, which has {missing[1]}')
    if count == 0:
        raise BagError(f'{topic} holds no message')
    if count == 1:
        raise BagError(f'all messages of {topic} have the same stamp, or there is one only')


def _alarm(message: Any) -> RecordedAlarm:
    try:
        event = AlarmEvent(message.event)
    except ValueError as error:
        raise BagError(f'fault_alarm: unknown event {message.event}') from error
    return RecordedAlarm(
        event,
        int(message.sensor_index),
        message.sensor,
        stamp_of(message.onset),
        stamp_of(message.detected),
        float(message.size),
        float(message.bound),
        message.kind,
        float(message.confidence),
        stamp_of(message.header.stamp),
    )
