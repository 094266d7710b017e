"""A recorded run as NumPy arrays, from any rosbag2 bag."""

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv.bag.errors import BagError
from lpv.bag.rosbag.metadata import encoding_of
from lpv.bag.rosbag.reading import BagReader, open_bag
from lpv.bag.run.decoder import Columns, Decoder, Table
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, Mode, subject
from lpv.core.support.errors import SampleError
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds

_STATE = 'position velocity compensated_position measured_position measured_velocity mode'
# Stream: (message type, array fields); the name is the last part of the topic's usual name.
STREAMS: dict[str, tuple[str, tuple[str, ...]]] = {
    name: (msgtype, tuple(fields.split()))
    for name, msgtype, fields in (
        ('joint_states', 'sensor_msgs/msg/JointState', 'position velocity effort'),
        ('torque_command', 'lpv_msgs/msg/TorqueCommand', 'torque safe_stop'),
        ('state_estimate', 'lpv_msgs/msg/StateEstimate', _STATE),
        ('fault_estimate', 'lpv_msgs/msg/FaultEstimate', 'estimate bound threshold state alarm'),
        ('reference', 'lpv_msgs/msg/JointReference', 'position velocity acceleration tip_position'),
        ('ground_truth', 'lpv_msgs/msg/GroundTruth', 'position velocity torque fault disturbance'),
    )
}
"""Streams of arrays; ground_truth and reference are absent in recordings of a real arm."""

SCALARS = ('safe_stop', 'mode', 'disturbance')
"""Fields with one value a message; the others have one for each joint or sensor."""
CORRECTED = 'joint_states_corrected'
"""Name of a topic of measurements without confirmed faults: an answer, no measurements."""
ALARMS, ALARM_TYPE = 'fault_alarm', 'lpv_msgs/msg/FaultAlarm'
DIAGNOSTICS, DIAGNOSTICS_TYPE = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'
_ENOUGH = 20
"""Messages that tell what a topic carries, where several nodes publish on it."""
_OTHERS = 'is not in joint_states'
"""Why a message of other joints, as of a gripper, is left out without a warning."""
_LOG = logging.getLogger(__name__)
_TYPES = {**{name: msgtype for name, (msgtype, _) in STREAMS.items()}, ALARMS: ALARM_TYPE}
_NEEDED = {msgtype: ('header', *fields) for msgtype, fields in STREAMS.values()}
_NEEDED['sensor_msgs/msg/JointState'] += ('name',)
_NEEDED['lpv_msgs/msg/FaultEstimate'] += ('sensor_names',)
_ALARM = 'event sensor_index sensor onset detected size bound kind confidence'
_NEEDED[ALARM_TYPE] = ('header', *_ALARM.split())


@dataclass(frozen=True)
class RecordedAlarm(Alarm):
    """An alarm event with the stamp of the measurement that decided."""

    stamp: int = 0  # [ns]


def alarms_of(events: Iterable[Any]) -> list[list[Any]]:
    """Events of each alarm, `Alarm` of any kind, in the order in which the alarms began."""
    found: list[list[Any]] = []
    running: dict[tuple[int, str], list[Any]] = {}  # of each sensor and subject
    for event in events:
        if event.kind == 'dropout' and event.event == AlarmEvent.UPDATED:
            continue  # beside another alarm: no event tells its end
        key = event.sensor_index, subject(event.kind)
        own = running.pop(key, None)
        if own is None or event.event == AlarmEvent.RAISED:
            found.append(own := [])
        own.append(event)
        if event.event != AlarmEvent.CLEARED:
            running[key] = own
    return found


@dataclass
class RunRecord:
    """One run; streams are in the order of stamps, of which the last message counts."""

    # header stamps by stream name of `STREAMS`, increasing; absent streams are missing [ns]
    stamps: dict[str, np.ndarray] = field(default_factory=dict)
    # fields by stream name, one row per stamp; units as in the message definitions
    streams: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    alarms: list[RecordedAlarm] = field(default_factory=list)  # in the order of their stamps
    counts: Counter[str] = field(default_factory=Counter)  # messages in the bag by topic, of all
    topics: dict[str, str] = field(default_factory=dict)  # topic by stream name
    joint_names: tuple[str, ...] = ()  # joints of the columns of joint_states
    sensor_names: tuple[str, ...] = ()  # columns of fault_estimate; empty without that stream
    warnings: list[str] = field(default_factory=list)  # tolerated defects of bag and messages

    def get(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stream's own stamps; None if the stream is absent."""
        return self.streams[stream][name] if stream in self.streams else None

    def aligned(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stamps of joint_states, else NaN; None without the stream."""
        values = self.get(stream, name)
        if values is None:
            return None
        base, stamps = self.stamps['joint_states'], self.stamps[stream]
        nearest = np.minimum(np.searchsorted(stamps, base), len(stamps) - 1)
        match = stamps[nearest] == base
        result = np.full((len(base), *values.shape[1:]), np.nan)
        result[match] = values[nearest[match]]
        return result

    @property
    def time(self) -> np.ndarray:
        """Time of each measurement since the first one [s], shape (n,)."""
        return self.seconds(self.stamps['joint_states'])

    def seconds(self, stamps: int | np.ndarray) -> Any:
        """Time of stamps [ns] since the first measurement [s]."""
        # The difference of integers is exact; epoch seconds as floats would lose 100 ns.
        return (stamps - self.stamps['joint_states'][0]) / NANOSECONDS


def find_topic(
    reader: BagReader, name: str, wanted: str | None = None, joints: Sequence[str] | None = None
) -> str:
    """The topic that carries a stream, as of `find_connections`; BagError without it."""
    found = find_connections(reader, name, wanted, joints=joints)
    if found:
        return found[0].topic
    there = ', '.join(sorted({f'{c.topic} ({c.msgtype})' for c in reader.connections}))
    text = f'the bag has no topic {wanted or name!r} of type {_TYPES[name]}'
    raise BagError(f'{reader.path}: {text}; it has {there or "no topic at all"}')


def find_connections(
    reader: BagReader,
    name: str,  # of the stream, and end of the topic that is preferred
    wanted: str | None = None,  # topic that the user gives
    namespace: str | None = None,  # directly below which topics are
    joints: Sequence[str] | None = None,  # of the arm; topics of others, a gripper's, do not count
) -> list[Connection]:
    """All connections of the one topic that carries a stream; BagError if several topics do."""
    msgtype = _TYPES[name]
    found = [c for c in reader.connections if c.msgtype == msgtype]
    if namespace is not None:
        parent = '/' + namespace.strip('/')
        found = [c for c in found if (c.topic.rsplit('/', 1)[0] or '/') == parent]
    if wanted:
        found = [c for c in found if c.topic == wanted]
    else:
        found = [c for c in found if c.topic.rsplit('/', 1)[-1] != CORRECTED]
        several = len({c.topic for c in found}) > 1
        carried = {c.topic: _joints_of(reader, c) for c in found if several}
        found = [c for c in found if {*(joints or ())} <= {*carried.get(c.topic, ())}] or found
        found = [c for c in found if c.topic.rsplit('/', 1)[-1] == name] or found
        if len(topics := sorted({c.topic for c in found})) > 1:
            raise _ambiguous(reader, msgtype, {topic: carried[topic] for topic in topics})
    if found:
        if (encoding := encoding_of(found[0])) != 'cdr':
            what = f'messages of {found[0].topic} are encoded as {encoding!r}, not as cdr'
            raise BagError(f'{reader.path}: {what}')
        reader.check_definition(msgtype, _NEEDED[msgtype])
    return found


def _ambiguous(reader: BagReader, msgtype: str, carried: dict[str, list[str]]) -> BagError:
    """Error where several topics carry a stream: which, and with which joints."""
    what, topics, (first, *_) = msgtype, list(carried), carried.values()
    if any({*joints} != {*first} for joints in carried.values()):
        topics = [f'{topic} ({", ".join(own) or "no joint"})' for topic, own in carried.items()]
    elif first:
        what = f'the joints {", ".join(first)}'
    text = f'several topics carry {what}: {", ".join(topics)}'
    return BagError(f'{reader.path}: {text}; choose that of the measurements (--topic)')


def _joints_of(reader: BagReader, connection: Connection) -> list[str]:
    """Joints that the first messages of a topic name; none of another type than JointState."""
    if connection.msgtype != STREAMS['joint_states'][0]:
        return []
    messages = islice(reader.messages([connection]), _ENOUGH)
    decoded = (reader.deserialize(data, connection.msgtype) for *_, data in messages)
    return list(dict.fromkeys(name for message in decoded for name in message.name))


def arm_namespace(reader: BagReader, measured: str) -> str:
    """Namespace of an arm's nodes: that of its measurements, unless a driver has another one."""
    own, own_type = measured.rpartition('/')[0], STREAMS['joint_states'][0]
    topics = [(*c.topic.rpartition('/')[::2], c.msgtype) for c in reader.connections]
    nodes = {place for place, _, msgtype in topics if msgtype.startswith('lpv_msgs/')}
    others = {place for place, name, msgtype in topics if msgtype == own_type and name != CORRECTED}
    found = nodes - others
    return found.pop() if own not in nodes and len(found) == 1 else own


def load_run(
    path: str | Path,
    topic: str | None = None,  # of the measurements, in a bag with several
    joint_names: Sequence[str] | None = None,  # and their order; those of the first message if None
    answers_only: bool = False,  # the bag may lack measurements
) -> RunRecord:
    """Read a run; BagError if it lacks measurements or a joint, or holds several arms."""
    with open_bag(path) as reader:
        name, measured = 'joint_states', topic
        if not answers_only:
            measured = find_topic(reader, name, topic, joint_names)
        namespace = None if topic is None else arm_namespace(reader, topic)
        found = {name: find_connections(reader, name, measured, joints=joint_names)}
        for other in [one for one in _TYPES if one != name]:
            found[other] = find_connections(reader, other, namespace=namespace)
        chosen = {name: connections for name, connections in found.items() if connections}
        record = RunRecord(topics={name: c[0].topic for name, c in chosen.items()})
        for connection in reader.connections:
            record.counts[connection.topic] += connection.msgcount
        _read_streams(reader, chosen, record, joint_names or ())
        for warning in record.warnings:
            _LOG.warning('%s: %s', path, warning)
        record.warnings = [*reader.warnings, *record.warnings]
    return record


class _Stream:
    """What is read of one stream; messages whose arrays do not fit are left out and counted."""

    def __init__(self, reader: BagReader, name: str, joints: Sequence[str]) -> None:
        self.joints, self._count = tuple(joints), len(joints)
        self.sensors: tuple[str, ...] = ()
        self.parts: list[Table] = []
        self._name, (msgtype, self.fields) = name, STREAMS[name]
        self._lengths: dict[str, int] = {}
        choose = self._of_joints if name == 'joint_states' else self._fitting
        self.decoder = Decoder(reader, msgtype, self.fields, choose)

    def _of_joints(self, message: Any) -> Columns:
        """Drivers sort joints as they like; messages of others only (a gripper's) do not count."""
        names = list(message.name)
        self.joints = self.joints or tuple(names)
        for name in self.joints:
            if name not in names:
                there = ', '.join(names) or 'no joint'
                raise SampleError(f'joint {name!r} {_OTHERS}, which has {there}')
        JointOrder(self.joints).pick(message)  # refuses arrays of other sizes
        return [names.index(name) for name in self.joints], len(names)

    def _fitting(self, message: Any) -> Columns:
        """All arrays are for the same joints, and as long as in the messages before."""
        arrays = {name: getattr(message, name) for name in self.fields if name not in SCALARS}
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

    def fill(self, record: RunRecord) -> None:
        """Rows by stamp into a record; of one stamp the last message counts."""
        name, topic, warn = self._name, record.topics[self._name], record.warnings.append
        if self.parts:
            stamps = np.concatenate([part[1] for part in self.parts])
            table = {f: np.concatenate([p[2][f] for p in self.parts]) for f in self.fields}
            if name == 'state_estimate':  # without an estimate its values mean nothing
                known = table['mode'][:, 0] != Mode.NO_ESTIMATE
                stamps, table = stamps[known], {f: v[known] for f, v in table.items()}
            # np.unique gives the first of equal ones: reversed, that is the last message.
            kept, last = np.unique(stamps[::-1], return_index=True)
            if len(kept):
                rows = len(stamps) - 1 - last
                values = {f: v[rows, 0] if f in SCALARS else v[rows] for f, v in table.items()}
                record.stamps[name], record.streams[name] = kept, values
            if count := int(np.sum(stamps[1:] < np.maximum.accumulate(stamps)[:-1])):
                text = f'time goes backwards {count} times, messages are sorted by their stamps'
                warn(f'{topic}: {text}')
            if count := len(stamps) - len(kept):
                text = 'messages have the stamp of another one, the last one of each stamp counts'
                warn(f'{topic}: {count} {text}')
        rejected = self.decoder.rejected.items()
        if count := sum(often for why, often in rejected if _OTHERS not in why):
            warn(f'{topic}: {count} messages whose number of joints does not fit are left out')


def _read_streams(
    reader: BagReader, chosen: dict[str, list[Connection]], record: RunRecord, joints: Sequence[str]
) -> None:
    """Fill a record with all messages of some streams; BagError if measurements are missing."""
    pairs = [(name, c) for name, connections in chosen.items() for c in connections]
    streams = {name: _Stream(reader, name, joints) for name in chosen if name != ALARMS}
    alarms: dict[tuple[int, int, int, str], RecordedAlarm] = {}
    for block in reader.blocks([connection for _, connection in pairs]):
        names = np.array([list(chosen).index(name) for name, _ in pairs])[block.connection]
        for i, name in enumerate(chosen):
            positions = np.flatnonzero(names == i)
            if name != ALARMS and len(positions):
                rows = streams[name].decoder.read(block, positions)
                streams[name].parts += [rows] if rows is not None else []
            for k in positions.tolist() if name == ALARMS else ():
                alarm = _alarm(reader, block.message(k))
                # Latched events are delivered again to late subscribers.
                key = alarm.stamp, alarm.sensor_index, alarm.event, subject(alarm.kind)
                alarms[key] = alarm
    for stream in streams.values():
        stream.fill(record)
    record.alarms = [alarms[key] for key in sorted(alarms)]
    if 'fault_estimate' in streams:
        record.sensor_names = streams['fault_estimate'].sensors
    if 'joint_states' in streams:
        record.joint_names = streams['joint_states'].joints
        count, topic = len(record.stamps.get('joint_states', ())), record.topics['joint_states']
        if count == 0:
            missing = next(iter(streams['joint_states'].decoder.rejected), '')
            raise BagError(f'{reader.path}: ' + (missing or f'{topic} holds no message'))
        if count == 1:
            text = f'all messages of {topic} have the same stamp, or there is one only'
            raise BagError(f'{reader.path}: {text}')


def _alarm(reader: BagReader, data: bytes) -> RecordedAlarm:
    message = reader.deserialize(data, ALARM_TYPE)
    if message.event not in list(AlarmEvent):
        raise BagError(f'{reader.path}: fault_alarm: unknown event {message.event}')
    fields = {name: getattr(message, name) for name in _ALARM.split()}
    fields |= {name: to_nanoseconds(fields[name]) for name in ('onset', 'detected')}
    fields['event'] = AlarmEvent(message.event)
    return RecordedAlarm(**fields, stamp=to_nanoseconds(message.header.stamp))


@dataclass(frozen=True)
class NodeReport:
    """One status of a node."""

    stamp: int  # [ns]
    message: str  # its text


def node_reports(path: str | Path, namespace: str) -> dict[str, list[NodeReport]]:
    """Reports of one namespace's nodes by stamp, of ``observer``, ``tracking`` and ``drives``."""
    found: dict[str, list[NodeReport]] = {}
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.msgtype == DIAGNOSTICS_TYPE]
        for connection, _, data in reader.messages(connections) if connections else ():
            message = reader.deserialize(data, connection.msgtype)
            stamp = to_nanoseconds(message.header.stamp)
            for status in message.status:
                parent, _, name = status.name.rpartition('/')
                _, colon, part = name.partition(': ')
                if parent == namespace.rstrip('/') and colon:
                    found.setdefault(part, []).append(NodeReport(stamp, status.message))
    return {part: sorted(reports, key=lambda r: r.stamp) for part, reports in found.items()}
