"""Writing of rosbag2 bags: MCAP storage with metadata.yaml, in the ros2 profile."""

from pathlib import Path

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lpv_bag.interfaces import add_type, make_typestore
from lpv_core.errors import ConfigError

_FOREVER = QosTime(2147483647, 4294967295)


def qos_profile(reliable, transient_local, depth):
    """Offered QoS as stored beside a topic.

    Parameters
    ----------
    reliable, transient_local : bool
        Policies; best effort and volatile otherwise.
    depth : int
        History depth.

    Returns
    -------
    rosbags.interfaces.Qos
        The profile.
    """
    return Qos(
        QosHistory.KEEP_LAST, depth,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE,
        _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)


class BagWriter:
    """A bag that is written topic by topic.

    Parameters
    ----------
    path : str or pathlib.Path
        Directory to create.

    Raises
    ------
    ConfigError
        If it exists already or cannot be made.
    """

    def __init__(self, path):
        self.path = Path(path)
        self.typestore = make_typestore()
        try:
            self._writer = Writer(self.path, version=Writer.VERSION_LATEST,
                                  storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise ConfigError('bag', f'cannot be written: {error}', str(path)) from error
        self._connections = {}
        self.counts = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def check_type(self, msgtype):
        """Make sure that a type's definition can be stored.

        Parameters
        ----------
        msgtype : str
            Message type.

        Raises
        ------
        ConfigError
            If its definition is not installed.
        """
        add_type(self.typestore, msgtype)

    def add_topic(self, topic, msgtype, profiles=()):
        """Announce a topic.

        Parameters
        ----------
        topic : str
            Full name.
        msgtype : str
            Message type.
        profiles : sequence of rosbags.interfaces.Qos, optional
            Offered QoS of its publishers.
        """
        self.check_type(msgtype)
        self._connections[topic] = self._writer.add_connection(
            topic, msgtype, typestore=self.typestore, offered_qos_profiles=list(profiles))
        self.counts[topic] = 0

    def copy_topic(self, connection):
        """Announce a topic as another bag has it, with its own message definition.

        Parameters
        ----------
        connection : rosbags.interfaces.Connection
            Of the other bag; further connections of one topic are the same topic here.
        """
        if connection.topic in self._connections:
            return
        definition, digest, ext = connection.msgdef.data, connection.digest, connection.ext
        known = {}
        if definition:
            known = {'msgdef': definition, 'rihs01': digest or self._hash(connection)}
        else:  # bags of older distributions carry no definitions
            self.check_type(connection.msgtype)
        self._connections[connection.topic] = self._writer.add_connection(
            connection.topic, connection.msgtype, typestore=self.typestore, **known,
            serialization_format=ext.serialization_format,
            offered_qos_profiles=ext.offered_qos_profiles)
        self.counts[connection.topic] = 0

    def _hash(self, connection):
        """Type hash by the bag's own definition, which single files do not store."""
        typestore = get_typestore(Stores.EMPTY)
        typestore.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return typestore.hash_rihs01(connection.msgtype)

    def write_raw(self, topic, timestamp, data):
        """Write a serialised message.

        Parameters
        ----------
        topic : str
            Announced topic.
        timestamp : int
            Log time [ns].
        data : bytes
            CDR.
        """
        self._writer.write(self._connections[topic], timestamp, data)
        self.counts[topic] += 1

    def write(self, topic, timestamp, message):
        """Serialise and write a message of this bag's typestore.

        Parameters
        ----------
        topic : str
            Announced topic.
        timestamp : int
            Log time [ns].
        message : object
            Message of ``typestore.types``.
        """
        msgtype = self._connections[topic].msgtype
        data = bytes(self.typestore.serialize_cdr(message, msgtype))
        # DDS pads samples to four bytes, and so does a recorder: bags can then be compared.
        self.write_raw(topic, timestamp, data + bytes(-len(data) % 4))

    def close(self):
        """Finish file and metadata; may be called again."""
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close()
