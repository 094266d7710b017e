import math

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from lpv_msgs.msg import FaultEstimate, TorqueCommand
from lpv_node.serialized import SerializedMessage

STAMP = 3_000_000_007


def test_given_memory_when_it_changes_then_the_next_message_has_the_new_numbers_and_stamp():
    torque, stop = np.zeros(3), np.zeros(1, bool)
    numbers = {'torque': torque, 'safe_stop': stop}
    message = SerializedMessage('lpv_msgs/msg/TorqueCommand', '', numbers)
    first = message.at(1)
    torque[:], stop[0] = [1.5, -0.0, 1e-300], True
    second = deserialize_message(message.at(STAMP), TorqueCommand)
    assert (list(second.torque), second.safe_stop) == ([1.5, -0.0, 1e-300], True)
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (3, 7)
    assert list(deserialize_message(first, TorqueCommand).torque) == [0.0] * 3
    last = deserialize_message(message.at(2**70), TorqueCommand).header.stamp
    assert (last.sec, last.nanosec) == (2**31 - 1, 999999999), 'there is no later one'


@pytest.mark.parametrize('names', [['a'], ['ab', 'cde'], ['joint_ä', '', 'a' * 300, 'x']])
@pytest.mark.parametrize('frame', ['', 'b', 'some_arm'])
def test_given_names_of_any_length_when_serialised_then_the_middleware_reads_the_same(names, frame):
    count = len(names)
    numbers = {
        'estimate': np.array([math.nan, *range(1, count)]), 'bound': np.full(count, math.inf),
        'threshold': -np.arange(float(count)), 'state': np.arange(count, dtype=np.uint8),
        'alarm': np.arange(count) % 2 == 0,
    }  # fmt: skip
    kind = 'lpv_msgs/msg/FaultEstimate'
    data = SerializedMessage(kind, frame, numbers, sensor_names=names).at(STAMP)
    found = deserialize_message(data, FaultEstimate)
    assert (found.header.frame_id, found.sensor_names) == (frame, names)
    for name, values in numbers.items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_given_an_empty_sequence_or_another_type_when_serialised_then_it_fits_or_is_refused():
    numbers = {'position': np.ones(2), 'velocity': np.ones(2)}
    kind, names = 'sensor_msgs/msg/JointState', ['a', 'b']
    data = SerializedMessage(kind, '', numbers, name=names, effort=[]).at(STAMP)
    assert data[-4:] == bytes(4) and list(deserialize_message(data, JointState).effort) == []
    with pytest.raises(ValueError, match='16 bytes in the message, not 8'):
        narrow = {'torque': np.zeros(2, np.float32)}
        SerializedMessage('lpv_msgs/msg/TorqueCommand', '', narrow, safe_stop=False)
