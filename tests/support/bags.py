"""Small bags that tests of reading and recovery share."""

import numpy as np

from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter, qos_profile

JOINT_STATE = 'sensor_msgs/msg/JointState'
START, STEP = 10**9, 2_000_000
JOINTS = '/joint_states'
CHATTER = '/chatter'


def write_small(path, count=20, **options):
    """A bag of some measurements and, every fifth step, a text; a chunk every 10 ms."""
    options = {'preset': 'zstd_fast', 'chunk_time': 10_000_000, **options}
    known, names = options.pop('known', None), options.pop('names', ('a', 'b'))
    with BagWriter(path, **options) as writer:
        messages = BagMessages(writer.typestore, 'arm')
        writer.add_topic(JOINTS, JOINT_STATE, [qos_profile(True, False, 10)])
        writer.add_topic(CHATTER, 'std_msgs/msg/String')
        for k in range(count):
            stamp = START + k * STEP
            measured = messages.joint_state(stamp, names, [k, 1.0], [2.0, 3.0], [4.0, 5.0])
            writer.write(JOINTS, stamp, measured)
            if k % 5 == 0:
                text = writer.typestore.types['std_msgs/msg/String'](f'hello {k}')
                writer.write(CHATTER, stamp, text)
        writer.close(known)
    return path


def write_measurements(path, names, time, position, velocity, effort, topic=JOINTS):
    """A bag of measurements of joints; times in s, None for what is not measured."""
    with BagWriter(path, 'none') as writer:
        messages = BagMessages(writer.typestore, 'base')
        writer.add_topic(topic, JOINT_STATE)
        for k, stamp in enumerate(np.round(1e9 * np.asarray(time)).astype(int).tolist()):
            vectors = ([] if v is None else v[k] for v in (position, velocity, effort))
            writer.write(topic, stamp, messages.joint_state(stamp, names, *vectors))
    return path


def contents(path):
    """Topic, log time and bytes of all messages of a bag, and the warnings."""
    with open_bag(path) as reader:
        found = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        return found, list(reader.warnings)


def storage(bag):
    """The one MCAP file of a bag."""
    (file,) = bag.glob('*.mcap')
    return file
