"""Topics, types, times and messages of small bags."""

from lpv.bag.rosbag.interfaces import standard_types

JOINT_STATE, STRING = 'sensor_msgs/msg/JointState', 'std_msgs/msg/String'
JOINTS, CHATTER = '/joint_states', '/chatter'
START, STEP = 10**9, 2_000_000
TOPICS = {JOINTS: JOINT_STATE, CHATTER: STRING}
TYPESTORE = standard_types()


def cdr(message, msgtype=JOINT_STATE, **order):
    """Bytes of a message, padded as DDS does; of ``little_endian`` order, or not."""
    data = bytes(TYPESTORE.serialize_cdr(message, msgtype, **order))
    return data + bytes(-len(data) % 4)


def text(words):
    return cdr(TYPESTORE.types[STRING](words), STRING)
