"""Hostile messages for the recorder: it stores them as they were sent, and goes on."""

import pytest
from hostile import damaged_bytes, forge, node_of, run_cases, set_parameters
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState

from lpv.bag.rosbag.message_loss import TopicCount
from lpv.bag.rosbag.writing import qos_profile
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import leading_stamp
from lpv_msgs.msg import FaultAlarm, StateEstimate
from lpv_node.recorder.input import Heard
from lpv_node.recorder.node import RecorderNode

pytestmark = [pytest.mark.ros, pytest.mark.fuzz]
TOPICS = {
    '/lpv/joint_states': JointState,
    '/lpv/state_estimate': StateEstimate,
    '/lpv/fault_alarm': FaultAlarm,
}


class Recorder:
    """A recorder that is given what would have been heard."""

    def __init__(self, node):
        self.node, self.sent, self._stamp = node, [], 10**18
        for topic, kind in TOPICS.items():
            package, name = kind.__module__.split('.')[0], kind.__name__
            node._types[topic] = f'{package}/msg/{name}'
            node._announced[topic] = qos_profile(True, False, 10)
            node._counts[topic] = TopicCount()

    def good(self, kind):
        """A message with the next stamp."""
        self._stamp += 2_000_000
        message = kind()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._stamp, 10**9)
        return message

    def hear(self, topic, data):
        """Take one message."""
        heard = Heard(self._stamp, topic, data, self._stamp, None, None, leading_stamp(data))
        self.node._take(self.node._writer, heard)
        self.sent.append((topic, data))

    def stored(self):
        """What the closed bag has."""
        path = self.node._writer.path
        self.node.end()
        with Reader(path) as reader:
            return [(c.topic, bytes(data)) for c, _, data in reader.messages()]


@pytest.fixture(params=['false', 'true'], ids=['real time', 'lockstep'])
def recorder(request, tmp_path):
    with node_of(RecorderNode, 'recorder', output=tmp_path / 'bag', lockstep=request.param) as node:
        yield Recorder(node)


def test_given_forged_and_damaged_messages_when_recorded_then_all_are_stored_as_sent(recorder):
    def case(rng):
        topic = str(rng.choice(list(TOPICS)))
        message, is_forged = recorder.good(TOPICS[topic]), rng.random() < 0.5
        data = serialize_message(forge(rng, message)) if is_forged else damaged_bytes(rng, message)
        recorder.hear(topic, data)

    run_cases(150, case)
    for topic, kind in TOPICS.items():
        recorder.hear(topic, serialize_message(recorder.good(kind)))
    stored = recorder.stored()
    assert len(stored) == len(recorder.sent)
    if not recorder.node.lockstep:  # where padding is zeroed
        assert stored == recorder.sent


def test_given_hostile_parameters_when_set_then_the_recorder_goes_on(recorder):
    assert run_cases(100, lambda rng: set_parameters(recorder.node, rng)).refused
    recorder.hear('/lpv/joint_states', serialize_message(recorder.good(JointState)))
    assert len(recorder.stored()) == 1


def test_given_a_gains_file_that_is_none_when_set_up_then_it_is_refused_without_a_bag(tmp_path):
    bag, gains = tmp_path / 'bag', tmp_path / 'gains'
    gains.write_text('gains: none')
    node = node_of(RecorderNode, 'recorder', output=bag, gains_file=gains)
    with pytest.raises(ConfigError, match='not a gains file'), node:
        pass
    assert not bag.exists()
