"""A recorded run as NumPy arrays, from any rosbag2 bag."""

import logging
from collections.abc import Sequence
from pathlib import Path

from rosbags.interfaces import Connection

from lpv_bag.errors import BagError
from lpv_bag.rosbag.reading import BagReader, open_bag
from lpv_bag.run.rows import read_streams
from lpv_bag.run.streams import ALARM_TYPE, ALARMS, STREAMS, RecordedAlarm, RunRecord, stamp_of

__all__ = [
    'BagError',
    'BagReader',
    'CORRECTED',
    'RecordedAlarm',
    'RunRecord',
    'STREAMS',
    'find_connections',
    'find_topic',
    'load_run',
    'open_bag',
    'stamp_of',
]
CORRECTED = 'joint_states_corrected'
"""Last part of a topic's name that carries measurements with confirmed faults removed: an answer,
and never taken for the measurements."""
_LOG = logging.getLogger(__name__)
_NEEDED = {msgtype: ('header', *fields) for msgtype, fields in STREAMS.values()}
_NEEDED['sensor_msgs/msg/JointState'] += ('name',)
_NEEDED['lpv_msgs/msg/FaultEstimate'] += ('sensor_names',)
_ALARM = 'header event sensor_index sensor onset detected size bound kind confidence'
_NEEDED[ALARM_TYPE] = tuple(_ALARM.split())


def find_topic(
    reader: BagReader,
    msgtype: str,
    name: str,
    wanted: str | None = None,
    namespace: str | None = None,
) -> Connection:
    """The one connection that carries a stream; BagError if none or several topics do.

    Of several topics of the type the one is preferred whose name ends with ``name``; ``wanted`` is
    a topic given by the user, and ``namespace`` takes only topics directly below it.
    """
    found = find_connections(reader, msgtype, name, wanted, namespace)
    if found:
        return found[0]
    place = f' below namespace {namespace}' if namespace is not None else ''
    there = ', '.join(sorted({f'{c.topic} ({c.msgtype})' for c in reader.connections}))
    raise BagError(
        f'{reader.paths[0]}: the bag has no topic {wanted or name!r} of type '
        f'{msgtype}{place}; it has {there or "no topic at all"}'
    )


def find_connections(
    reader: BagReader,
    msgtype: str,
    name: str,
    wanted: str | None = None,
    namespace: str | None = None,
) -> list[Connection]:
    """All connections of the one topic that carries a stream, as `find_topic`; empty without it.

    A topic has several connections if several publishers with different QoS wrote to it.
    """
    found = [c for c in reader.connections if c.msgtype == msgtype]
    if namespace is not None:
        parent = '/' + namespace.strip('/')
        found = [c for c in found if (c.topic.rsplit('/', 1)[0] or '/') == parent]
    if wanted:
        found = [c for c in found if c.topic == wanted]
    else:
        found = [c for c in found if c.topic.rsplit('/', 1)[-1] != CORRECTED]
        found = [c for c in found if c.topic.rsplit('/', 1)[-1] == name] or found
    topics = sorted({c.topic for c in found})
    if len(topics) > 1:
        raise BagError(
            f'{reader.paths[0]}: several topics carry {msgtype}: {", ".join(topics)}; '
            'the bag holds more than one arm, say which namespace or topic is meant'
        )
    if found:
        reader.check_definition(msgtype, _NEEDED.get(msgtype, ()))
    return found


def load_run(
    path: str | Path,
    namespace: str | None = None,
    joint_names: Sequence[str] | None = None,
    answers_only: bool = False,
) -> RunRecord:
    """Read a run.

    Parameters
    ----------
    path : str or pathlib.Path
        Bag: rosbag2 directory or single storage file.
    namespace : str, optional
        Namespace of the arm, in a bag with several.
    joint_names : sequence of str, optional
        Joints to take from joint_states, in this order; those of the first message if not given.
    answers_only : bool, optional
        Whether the bag may lack measurements.

    Raises
    ------
    BagError
        If the bag is unreadable, lacks measurements or one of the joints, or holds more than one
        arm.
    """
    with open_bag(path) as reader:
        if not answers_only:
            find_topic(reader, STREAMS['joint_states'][0], 'joint_states', namespace=namespace)
        types = {**{name: msgtype for name, (msgtype, _) in STREAMS.items()}, ALARMS: ALARM_TYPE}
        found = {
            name: find_connections(reader, msgtype, name, namespace=namespace)
            for name, msgtype in types.items()
        }
        chosen = {name: connections for name, connections in found.items() if connections}
        record = RunRecord(topics={name: c[0].topic for name, c in chosen.items()})
        for connection in reader.connections:
            before = record.counts.get(connection.topic, 0)
            record.counts[connection.topic] = before + connection.msgcount
        try:
            read_streams(reader, chosen, record, joint_names)
        except BagError as error:
            text = str(error)
            raise BagError(text if text.startswith(str(path)) else f'{path}: {text}') from None
        for warning in record.warnings:
            _LOG.warning('%s: %s', path, warning)
        record.warnings = [*reader.warnings, *record.warnings]
    return record
