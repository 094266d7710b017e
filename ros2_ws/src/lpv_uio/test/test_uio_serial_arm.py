"""The observer's node on a serial arm, without a graph."""

import numpy as np
import pytest
from places import BRINGUP
from serial_bags import crane_file, crane_run, record_crane

rclpy = pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

import ros  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from lpv_bag.replay.replay import Replay  # noqa: E402
from lpv_bag.rosbag.reading import open_bag  # noqa: E402
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor  # noqa: E402
from lpv_core.serial_arm.arm_file import load_arm  # noqa: E402
from lpv_core.serial_arm.simulation import EncoderFault  # noqa: E402
from lpv_core.support.errors import ConfigError  # noqa: E402
from lpv_uio.node import UioNode  # noqa: E402

pytestmark = pytest.mark.ros


TOPICS = {
    '/lpv/state_estimate': 'state',
    '/lpv/fault_estimate': 'fault',
    '/lpv/joint_states_corrected': 'corrected',
    '/lpv/fault_alarm': 'alarm',
    '/diagnostics': 'diagnostics',
}


class Publisher:
    """Keeps what is published, as bytes."""

    def __init__(self):
        self.sent = []

    def publish(self, message):
        self.sent.append(message if isinstance(message, bytes) else serialize_message(message))


@pytest.fixture
def make_node(tmp_path):
    """A function that makes a node for the serial arm, with some parameter files."""
    nodes = []

    def make(*files):
        words = ['-r', '__ns:=/lpv', '-p', f'arm_file:={crane_file(tmp_path)}']
        words += ['-p', 'lockstep:=true']
        for file in files:
            words += ['--params-file', str(file)]
        rclpy.init(args=['--ros-args', *words], domain_id=ros.next_domain())
        nodes.append(UioNode())
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


def answers(node, bag):
    """What a node publishes on a bag's measurements, by topic."""
    outputs = {name: Publisher() for name in TOPICS.values()}
    for name, publisher in outputs.items():
        setattr(node, f'_{name}_out', publisher)
    with open_bag(bag) as reader:
        for _, _, data in reader.messages():
            node._on_measurement(deserialize_message(data, JointState))
    return {name: publisher.sent for name, publisher in outputs.items()}


def test_given_a_serial_arm_when_observed_then_the_node_publishes_the_bytes_of_a_replay(
    make_node, tmp_path
):
    run = crane_run(faults=[EncoderFault(1, 'bias', 0.6, 0.05)])
    bag = record_crane(tmp_path / 'bag', run)
    node = make_node()
    node.setup()
    sent = answers(node, bag)
    assert len(sent['alarm']) == 1 and len(sent['corrected']) == len(run.stamps)
    monitor = SerialSensorMonitor('/uio', load_arm(crane_file(tmp_path)))
    Replay(monitor, estimates_only=True).run(bag, tmp_path / 'out')
    with open_bag(tmp_path / 'out') as reader:
        for topic, name in TOPICS.items():
            [connection] = [c for c in reader.connections if c.topic == topic]
            expected = [data for _, _, data in reader.messages([connection])]
            types, kind = reader.typestore_of(connection.msgtype), connection.msgtype
            # Gaps between the fields of rclpy's messages hold anything.
            found = [types.serialize_cdr(reader.deserialize(d, kind), kind) for d in sent[name]]
            assert [bytes(one) + bytes(-len(one) % 4) for one in found] == expected, name


def test_given_gains_when_a_node_of_a_serial_arm_starts_then_it_says_why_not(make_node):
    with pytest.raises(ConfigError, match='lpv: is missing'):
        make_node(BRINGUP / 'gains' / 'paper.yaml').setup()


def test_given_a_measurement_of_another_arm_when_it_comes_then_it_is_refused(make_node):
    node = make_node()
    node.setup()
    zeros = [0.0, 0.0]
    node._on_measurement(
        JointState(name=['joint1', 'joint2'], position=zeros, velocity=zeros, effort=zeros)
    )
    assert node._monitor.rejected == 1
    assert np.isnan(node._torque).all() and len(node._torque) == 3
