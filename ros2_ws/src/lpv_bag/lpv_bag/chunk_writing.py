"""MCAP storage for bags that are written a chunk at a time."""

import struct
import zlib

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import StoragePlugin, Writer

PRESETS = {'none': None, 'zstd_fast': 1, 'zstd_small': 9}
"""Compression levels by name, as the storage presets of rosbag2 are called."""

_MAGIC = b'\x89MCAP0\r\n'
_CHUNK_HEADER = struct.Struct('<BQQQQI')
_INDEX_ENTRY = np.dtype([('time', '<u8'), ('offset', '<u8')])
_PENDING = 1 << 20

RECORD = np.dtype([('kind', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'),
                   ('log_time', '<u8'), ('publish_time', '<u8')])
"""Head of a message's record."""


def record_head(channel, time, size):
    """Head of a message's record.

    Parameters
    ----------
    channel : int
        Id of the channel.
    time : int
        Log time [ns].
    size : int
        Of the message [bytes].

    Returns
    -------
    bytes
        To be followed by the message.
    """
    return struct.pack('<BQHIQQ', Opcode.MESSAGE, size + 22, channel, 0, time, time)


class ChunkStorage:
    """Storage plugin for rosbags' ``Writer``: single messages, and chunks that are ready.

    Parameters
    ----------
    path : pathlib.Path
        Folder of the bag.
    compression : object
        rosbags' compression mode, which is not used: see `preset`.

    Attributes
    ----------
    preset : str
        Key of `PRESETS`; to be set before the first chunk.
    """

    def __init__(self, path, compression):
        self.path = path / f'{path.name}.mcap'
        self.preset = 'none'
        self._file = self.path.open('xb')
        self._schemas, self._channels, self._indexes = [], [], []
        self._counts, self._first, self._last = {}, 2**63 - 1, 0
        self._pending, self._pending_rows = bytearray(), []
        self._file.write(_MAGIC)
        self._record(Header(profile='ros2', library='lpv_bag'))

    def add_msgtype(self, connection):
        """Store the definition of a message type."""
        encoding = ('ros2msg' if connection.msgdef.format == MessageDefinitionFormat.MSG
                    else 'ros2idl')
        self._schemas.append(Schema(
            id=len(self._schemas) + 1, name=connection.msgtype, encoding=encoding,
            data=connection.msgdef.data.encode()))
        self._record(self._schemas[-1])

    def add_connection(self, connection, offered_qos_profiles):
        """Store a topic; the connection's id is that of its channel."""
        schema = next(s.id for s in self._schemas if s.name == connection.msgtype)
        metadata = {'offered_qos_profiles': offered_qos_profiles,
                    'topic_type_hash': connection.digest}
        self._channels.append(Channel(
            id=connection.id, topic=connection.topic, schema_id=schema, metadata=metadata,
            message_encoding=connection.ext.serialization_format))
        self._counts[connection.id] = 0
        self._record(self._channels[-1])

    def write(self, connection, timestamp, data):
        """Write one message."""
        self._pending_rows.append((connection.id, timestamp, len(self._pending)))
        self._pending += record_head(connection.id, timestamp, len(data))
        self._pending += data
        if len(self._pending) >= _PENDING:
            self._flush()

    def _flush(self):
        if self._pending_rows:
            data, table = self._pending, np.array(self._pending_rows, np.int64)
            self._pending, self._pending_rows = bytearray(), []
            self.write_chunk(data, {int(c): table[table[:, 0] == c, 1:].T
                                    for c in np.unique(table[:, 0])})

    def write_chunk(self, data, index):
        """Write a chunk.

        Parameters
        ----------
        data : bytes-like
            Records of messages.
        index : dict of int to tuple of two ndarray of int64
            Log times [ns] and offsets into ``data`` of the messages of each channel.
        """
        self._flush()
        first = min(int(times.min()) for times, _ in index.values())
        last = max(int(times.max()) for times, _ in index.values())
        level = PRESETS[self.preset]
        packed = data if level is None else zstandard.ZstdCompressor(level=level).compress(data)
        name = b'' if level is None else b'zstd'
        start = self._file.tell()
        self._file.write(_CHUNK_HEADER.pack(
            Opcode.CHUNK, 40 + len(name) + len(packed), first, last, len(data), zlib.crc32(data)))
        self._file.write(struct.pack('<I', len(name)) + name + struct.pack('<Q', len(packed)))
        self._file.write(packed)
        end = self._file.tell()
        offsets = {}
        for channel, (times, places) in index.items():
            offsets[channel] = self._file.tell()
            entries = np.empty(len(times), _INDEX_ENTRY)
            entries['time'], entries['offset'] = times, places
            self._file.write(struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 6 + entries.nbytes,
                                         channel, entries.nbytes))
            self._file.write(entries)
            self._counts[channel] += len(times)
        self._first, self._last = min(self._first, first), max(self._last, last)
        self._indexes.append(ChunkIndex(
            chunk_length=end - start, chunk_start_offset=start, compression=name.decode(),
            compressed_size=len(packed), message_end_time=last, message_index_length=(
                self._file.tell() - end), message_index_offsets=offsets,
            message_start_time=first, uncompressed_size=len(data)))

    def close(self, version, metadata):
        """Write summary and footer, and close the file."""
        self._flush()
        position = self._file.tell()
        self._record(Metadata(name='rosbag2', metadata={'serialized_metadata': metadata}))
        about = MetadataIndex(offset=position, length=self._file.tell() - position,
                              name='rosbag2')
        self._record(DataEnd(data_section_crc=0))
        self._summary(about)
        self._file.write(_MAGIC)
        self._file.close()

    def _summary(self, about):
        total = sum(self._counts.values())
        statistics = Statistics(
            message_count=total, schema_count=len(self._schemas),
            channel_count=len(self._channels), attachment_count=0, metadata_count=1,
            chunk_count=len(self._indexes), message_start_time=self._first if total else 0,
            message_end_time=self._last, channel_message_counts=self._counts)
        start, groups = self._file.tell(), []
        for opcode, records in ((Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
                                (Opcode.CHUNK_INDEX, self._indexes),
                                (Opcode.METADATA_INDEX, [about]),
                                (Opcode.STATISTICS, [statistics])):
            position = self._file.tell()
            for record in records:
                self._record(record)
            if records:
                groups.append(SummaryOffset(group_opcode=opcode, group_start=position,
                                            group_length=self._file.tell() - position))
        offsets = self._file.tell()
        for group in groups:
            self._record(group)
        self._record(Footer(summary_start=start, summary_offset_start=offsets, summary_crc=0))

    def _record(self, record):
        builder = RecordBuilder()
        record.write(builder)
        self._file.write(builder.end())

    def abort(self):
        """Close without index."""
        self._file.close()


class ChunkWriter(Writer):
    """rosbags' writer, which takes care of metadata.yaml, with `ChunkStorage`."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: ChunkStorage}

    def write_chunk(self, data, index):
        """Write a chunk; parameters as those of `ChunkStorage.write_chunk`."""
        self.storage.write_chunk(data, index)
        for channel, (times, _) in index.items():
            self.counts[channel] += len(times)
            self.min_timestamp = min(self.min_timestamp, int(times.min()))
            self.max_timestamp = max(self.max_timestamp, int(times.max()))
