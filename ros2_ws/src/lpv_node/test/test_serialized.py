"""Messages that are serialised once and then filled in place."""

import math

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from lpv_msgs.msg import FaultEstimate, TorqueCommand
from lpv_node.serialized import SerializedMessage

STAMP = 3_000_000_007


def test_given_memory_when_it_changes_then_the_next_message_has_the_new_numbers_and_stamp():
    torque, stop = np.zeros(3), np.zeros(1, bool)
    message = SerializedMessage(TorqueCommand(), {'torque': torque, 'safe_stop': stop})
    first = message.at(1)
    torque[:], stop[0] = [1.5, -0.0, 1e-300], True
    second = deserialize_message(message.at(STAMP), TorqueCommand)
    assert (list(second.torque), second.safe_stop) == ([1.5, -0.0, 1e-300], True)
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (3, 7)
    assert list(deserialize_message(first, TorqueCommand).torque) == [0.0] * 3


@pytest.mark.parametrize('names', [['a'], ['ab', 'cde'], ['joint_ä', '', 'a' * 300, 'x']])
@pytest.mark.parametrize('frame', ['', 'b', 'some_arm'])
def test_given_names_of_any_length_when_serialised_then_the_middleware_reads_the_same(names, frame):
    count = len(names)
    numbers = {
        'estimate': np.array([math.nan, *range(1, count)]),
        'bound': np.full(count, math.inf),
        'threshold': -np.arange(float(count)),
        'state': np.arange(count, dtype=np.uint8),
        'alarm': np.arange(count) % 2 == 0,
    }
    message = FaultEstimate(header=Header(frame_id=frame), sensor_names=names)
    found = deserialize_message(SerializedMessage(message, numbers).at(STAMP), FaultEstimate)
    assert (found.header.frame_id, found.sensor_names) == (frame, names)
    for name, values in numbers.items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_given_an_empty_sequence_or_another_type_when_serialised_then_it_fits_or_is_refused():
    numbers = {'position': np.ones(2), 'velocity': np.ones(2)}
    data = SerializedMessage(JointState(name=['a', 'b']), numbers).at(STAMP)
    assert data[-4:] == bytes(4) and list(deserialize_message(data, JointState).effort) == []
    with pytest.raises(ValueError, match='16 bytes in the message, not 8'):
        SerializedMessage(TorqueCommand(), {'torque': np.zeros(2, np.float32)})


@pytest.mark.parametrize(('stamp', 'expected'), [(STAMP, (3, 7)), (2**70, (2**31 - 1, 999999999))])
def test_given_a_clock_when_serialised_then_its_time_is_the_stamp(stamp, expected):
    found = deserialize_message(SerializedMessage(Clock(), {}, 'clock').at(stamp), Clock)
    assert (found.clock.sec, found.clock.nanosec) == expected
