"""Bags of other writers: files by the mcap package, and bags by rosbags."""

from bags import CHATTER, JOINT_STATE, JOINTS
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from lpv.bag.rosbag.interfaces import make_typestore

STRING = 'std_msgs/msg/String'
TOPICS = {JOINTS: JOINT_STATE, CHATTER: STRING}
TYPESTORE = make_typestore()
KINDS = {
    'none': {'compression': CompressionType.NONE},
    'lz4': {'compression': CompressionType.LZ4},
    'zstd': {'compression': CompressionType.ZSTD},
    'no chunks': {'use_chunking': False},
    'no checksums': {'compression': CompressionType.NONE, 'enable_crcs': False},
}
"""Kinds of MCAP files: options of their writer."""


def cdr(message, msgtype=JOINT_STATE, **order):
    """Bytes of a message, padded as DDS does; of ``little_endian`` order, or not."""
    data = bytes(TYPESTORE.serialize_cdr(message, msgtype, **order))
    return data + bytes(-len(data) % 4)


def text(words):
    return cdr(TYPESTORE.types[STRING](words), STRING)


def write_by_mcap(path, content, chunk_size=4000, **options):
    """A file of topic, time and bytes of each message."""
    with open(path, 'wb') as file:
        writer = McapWriter(file, chunk_size=chunk_size, **options)
        writer.start(profile='ros2', library='test')
        channels = {}
        for topic, msgtype in TOPICS.items():
            definition = TYPESTORE.generate_msgdef(msgtype, ros_version=2)[0]
            schema = writer.register_schema(msgtype, 'ros2msg', definition.encode())
            channels[topic] = writer.register_channel(topic, 'cdr', schema)
        for topic, time, data in content:
            writer.add_message(channels[topic], log_time=time, publish_time=time - 1, data=data)
        writer.finish()
    return path


def write_by_rosbags(path, entries, plugin=StoragePlugin.SQLITE3):
    """A bag of measurements: topic, time and bytes of each."""
    with RosbagsWriter(path, version=9, storage_plugin=plugin) as writer:
        known = {}
        for topic, time, data in entries:
            if topic not in known:
                known[topic] = writer.add_connection(topic, JOINT_STATE, typestore=TYPESTORE)
            writer.write(known[topic], time, data)
    return path
