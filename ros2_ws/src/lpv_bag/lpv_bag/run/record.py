"""A recorded run as NumPy arrays, from any rosbag2 bag."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lpv_bag.rosbag.definitions import check_definition
from lpv_bag.rosbag.errors import BagError
from lpv_bag.rosbag.reading import BagReader, open_bag
from lpv_bag.run.rows import RunRows
from lpv_bag.run.stream_blocks import read_streams
from lpv_bag.run.streams import ALARM_TYPE, ALARMS, STREAMS, RecordedAlarm, stamp_of
from lpv_core.observer.sampled_observer import NANOSECONDS

__all__ = [
    'BagError',
    'BagReader',
    'RecordedAlarm',
    'RunRecord',
    'STREAMS',
    'find_connections',
    'find_topic',
    'load_run',
    'open_bag',
    'stamp_of',
]
_LOG = logging.getLogger(__name__)
_NEEDED = {msgtype: ('header', *fields) for msgtype, fields in STREAMS.values()}
_NEEDED['sensor_msgs/msg/JointState'] += ('name',)
_NEEDED['lpv_msgs/msg/FaultEstimate'] += ('sensor_names',)
_NEEDED[ALARM_TYPE] = (
    'header',
    'event',
    'sensor_index',
    'sensor',
    'onset',
    'detected',
    'size',
    'bound',
    'kind',
    'confidence',
)


@dataclass
class RunRecord:
    """One run.

    Rows of a stream are in the order of their header stamps; of several messages with the same
    stamp the last one counts.
    """

    # header stamps [ns] by stream name of `STREAMS`, increasing; absent streams are missing; shape
    # (n,)
    stamps: dict = field(default_factory=dict)
    # fields by stream name, one row a stamp; units as in the message definitions
    streams: dict = field(default_factory=dict)
    alarms: list = field(default_factory=list)  # alarm events in the order of their stamps
    counts: dict = field(default_factory=dict)  # messages in the bag by topic, of all topics
    topics: dict = field(default_factory=dict)  # topic by stream name
    joint_names: tuple = ()  # joints of the columns of joint_states
    sensor_names: tuple = ()  # sensors of the columns of fault_estimate; empty without that stream
    # what is wrong with the bag or its messages, and was put up with
    warnings: list = field(default_factory=list)

    def get(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stream's own stamps.

        Parameters
        ----------
        stream, name : str
            Stream and field.

        Returns
        -------
        ndarray or None
            One row a stamp; None if the stream is absent.
        """
        return self.streams[stream][name] if stream in self.streams else None

    def aligned(self, stream: str, name: str) -> np.ndarray | None:
        """Field of a stream on the stamps of joint_states.

        Parameters
        ----------
        stream, name : str
            Stream and field.

        Returns
        -------
        ndarray or None
            One row a measurement, NaN where the stream has no message with that stamp; None if
            the stream is absent.
        """
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
    def time(self):
        """Time of each measurement since the first one [s], shape (n,)."""
        return self.seconds(self.stamps['joint_states'])

    def seconds(self, stamps) -> float | np.ndarray:
        """Time since the first measurement.

        Parameters
        ----------
        stamps : int or ndarray of int64
            [ns].

        Returns
        -------
        float or ndarray
            [s].
        """
        # The difference of integers is exact; epoch seconds as floats would lose 100 ns.
        return (stamps - self.stamps['joint_states'][0]) / NANOSECONDS


def find_topic(
    reader: BagReader,
    msgtype: str,
    name: str,
    wanted: str | None = None,
    required: bool = True,
    namespace: str | None = None,
):
    """The one connection that carries a stream.

    Parameters
    ----------
    reader : BagReader
        Open bag.
    msgtype : str
        Message type.
    name : str
        Last part of the usual topic name, preferred among several of the type.
    wanted : str, optional
        Topic given by the user.
    required : bool, optional
        Whether absence is an error.
    namespace : str, optional
        Only topics directly below it, e.g. ``/lpv``.

    Returns
    -------
    rosbags connection or None
        The connection.

    Raises
    ------
    BagError
        If a required stream is missing, or several topics carry it.
    """
    found = find_connections(reader, msgtype, name, wanted, required, namespace)
    return found[0] if found else None


def find_connections(reader, msgtype, name, wanted=None, required: bool = True, namespace=None):
    """All connections of the one topic that carries a stream.

    A topic has several connections if several publishers with different QoS wrote to it.
    """
    found = [c for c in reader.connections if c.msgtype == msgtype]
    if namespace is not None:
        parent = '/' + namespace.strip('/')
        found = [c for c in found if (c.topic.rsplit('/', 1)[0] or '/') == parent]
    if wanted:
        found = [c for c in found if c.topic == wanted]
    elif len(found) > 1:
        found = [c for c in found if c.topic.rsplit('/', 1)[-1] == name] or found
    topics = sorted({c.topic for c in found})
    if len(topics) > 1:
        raise BagError(
            f'{reader.paths[0]}: several topics carry {msgtype}: {", ".join(topics)}; '
            'the bag holds more than one arm, say which namespace or topic is meant'
        )
    if required and not found:
        place = f' below namespace {namespace}' if namespace is not None else ''
        there = ', '.join(sorted({f'{c.topic} ({c.msgtype})' for c in reader.connections}))
        raise BagError(
            f'{reader.paths[0]}: the bag has no topic {wanted or name!r} of type '
            f'{msgtype}{place}; it has {there or "no topic at all"}'
        )
    if found:
        check_definition(reader, msgtype, _NEEDED.get(msgtype, ()))
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

    Returns
    -------
    RunRecord
        Its arrays.

    Raises
    ------
    BagError
        If the bag is unreadable, lacks measurements or one of the joints, or holds more than one
        arm.
    """
    with open_bag(path) as reader:
        chosen = {}
        for name, (msgtype, _) in (*STREAMS.items(), (ALARMS, (ALARM_TYPE, ()))):
            found = find_connections(
                reader,
                msgtype,
                name,
                namespace=namespace,
                required=name == 'joint_states' and not answers_only,
            )
            if found:
                chosen[name] = found
        record = RunRecord(topics={name: c[0].topic for name, c in chosen.items()})
        for connection in reader.connections:
            record.counts[connection.topic] = (
                record.counts.get(connection.topic, 0) + connection.msgcount
            )
        rows = RunRows(record, joint_names)
        read_streams(reader, chosen, rows)
        record.warnings += reader.warnings
    try:
        rows.finish(answers_only)
    except BagError as error:
        raise BagError(f'{path}: {error}') from None
    for text in rows.warnings:
        _LOG.warning('%s: %s', path, text)
    record.warnings += rows.warnings
    return record
