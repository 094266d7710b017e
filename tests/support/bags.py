"""Small bags that tests share: of our writer, of the mcap package, and of rosbags."""

import numpy as np
from bag_messages import CHATTER, JOINT_STATE, JOINTS, START, STEP, TOPICS, TYPESTORE, text
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import qos_profile
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter

KINDS = {
    **{kind.name.lower(): {'compression': kind} for kind in CompressionType},
    'no chunks': {'use_chunking': False},
    'no checksums': {'compression': CompressionType.NONE, 'enable_crcs': False},
}
"""Kinds of MCAP files: options of their writer."""


def write_bag(path, entries, types, known=None, depth=10, **options):
    """A bag of topic, time and message, or its bytes, of each entry; types by topic."""
    with BagWriter(path, **options) as writer:
        for topic, msgtype in types.items():
            writer.add_topic(topic, msgtype, [qos_profile(True, False, depth)])
        for topic, time, content in entries:
            write = writer.write_raw if isinstance(content, bytes) else writer.write
            write(topic, time, content)
        writer.close(known)
    return path


def write_small(path, count=20, names=('a', 'b'), **options):
    """A bag of some measurements and, every fifth step, a text; a chunk every 10 ms."""
    messages, entries = BagMessages(TYPESTORE, 'arm'), []
    for k, stamp in enumerate(range(START, START + count * STEP, STEP)):
        measured = messages.joint_state(stamp, names, [k, 1.0], [2.0, 3.0], [4.0, 5.0])
        entries.append((JOINTS, stamp, measured))
        if k % 5 == 0:
            entries.append((CHATTER, stamp, text(f'hello {k}')))
    options = {'preset': 'zstd_fast', 'chunk_time': 10_000_000, **options}
    return write_bag(path, entries, TOPICS, **options)


def write_measurements(path, names, time, position, velocity, effort, topic=JOINTS):
    """A bag of measurements of joints; times in s, None for what is not measured."""
    stamps = np.round(1e9 * np.asarray(time)).astype(int).tolist()
    vectors = ([[]] * len(stamps) if v is None else v for v in (position, velocity, effort))
    with BagWriter(path, 'none') as writer:
        writer.write_joint_states(topic, names, zip(stamps, *vectors))
    return path


def write_by_mcap(path, content, chunk_size=4000, **options):
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


def write_by_rosbags(path, entries, plugin=StoragePlugin.SQLITE3, compression=None):
    writer = RosbagsWriter(path, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        known = {}
        for topic, time, data in entries:
            if topic not in known:
                known[topic] = writer.add_connection(topic, JOINT_STATE, typestore=TYPESTORE)
            writer.write(known[topic], time, data)
    return path


def contents(path):
    """Topic, log time and bytes of all messages of a bag, and the warnings."""
    with open_bag(path) as reader:
        found = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        return found, list(reader.warnings)


def decoded(path, topic, **limits):
    with AnyReader([path]) as reader:
        found = reader.messages(reader.topics[topic].connections, **limits)
        return [reader.deserialize(data, c.msgtype) for c, _, data in found]


def storage(bag):
    (file,) = bag.glob('*.mcap')
    return file
