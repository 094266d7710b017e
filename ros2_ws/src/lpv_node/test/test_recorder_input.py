import os
import socket
import subprocess
import sys

import pytest
import rclpy
import ros
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from lpv.bag.rosbag.interfaces import message_text
from lpv.bag.rosbag.live import ros_qos
from lpv_node.managed import ManagedNode
from lpv_node.recorder import input as recorder_input
from lpv_node.recorder.input import RecorderInput, Selection, enlarge_sockets

pytestmark = pytest.mark.ros
TOPIC = '/lpv/joint_states'


class Senders:
    """Publishers of one topic, whose messages are named in the order in which they were sent."""

    def __init__(self, client):
        self.client, self._sent = client, 0
        # The recorder does not listen to itself: its node has another one beside it.
        self.node = rclpy.create_node('sender', context=client.node.context, namespace='/lpv')
        wanted = Selection(frozenset({TOPIC, '/lpv/torque'}))
        self.input = RecorderInput(client.node, wanted, message_text)
        self.heard = []

    def add(self, reliable, latched):
        qos = ros_qos(reliable, latched, 100)
        return self.node.create_publisher(JointState, 'joint_states', qos)

    def send(self, *publishers):
        for publisher in publishers:
            publisher.publish(JointState(name=[f'message {self._sent}']))
            self._sent += 1

    def look(self):
        self.input.search()
        self.heard += self.input.poll()

    def wait(self, condition):
        assert self.client.wait(lambda: self.look() or condition())

    def names(self):
        self.wait(lambda: len(self.heard) >= self._sent)
        self.client.wait(self.look, 0.3)
        return sorted(int(heard.data.split(b'message ')[1].split(b'\0')[0]) for heard in self.heard)


@pytest.fixture
def senders():
    with ros.client(ros.next_domain(), name='recorder') as client:
        made = Senders(client)
        yield made
        made.input.close()
        made.node.destroy_node()


def test_given_publishers_with_lower_qos_when_they_come_later_then_all_is_heard_once(senders):
    every = []
    for offer in ((True, True), (True, False), (False, False)):
        every.append(senders.add(*offer))
        # Each is heard by its own subscription, and by those with a lower one.
        count = len(every)
        senders.wait(lambda p=every[-1]: p.get_subscription_count() == 1)
        senders.wait(lambda p=every[0], n=count: p.get_subscription_count() == n)
        for _ in range(20):
            senders.send(*every)
    assert senders.names() == list(range(20 * (1 + 2 + 3))) and senders.input.refused == {}
    offers = {bytes(p.endpoint_gid): p for p in senders.node.get_publishers_info_by_topic(TOPIC)}
    assert {heard.publisher for heard in senders.heard} == set(offers)
    # The recorder subscribes three times, and is one to who counts the subscribers of a publisher.
    assert ManagedNode._matched(senders.node, every[0]) == 1
    senders.client.listen(JointState, 'joint_states', 10)
    senders.wait(lambda: every[0].get_subscription_count() == 4)
    assert ManagedNode._matched(senders.node, every[0]) == 2


def test_given_a_publisher_with_history_beside_one_without_when_heard_then_it_is_whole(senders):
    latched, fleeting = senders.add(True, True), senders.add(False, False)
    senders.send(latched, latched)  # nobody listens yet
    assert senders.client.wait(lambda: senders.node.count_publishers(TOPIC) == 2)
    senders.wait(lambda: fleeting.get_subscription_count() == 1)
    senders.wait(lambda: latched.get_subscription_count() == 2)
    senders.send(latched, fleeting, latched)
    assert senders.names() == list(range(5))


def test_given_a_remapped_recorder_when_all_is_recorded_then_topics_are_those_of_the_graph(senders):
    given, sender = ['--ros-args', '-r', f'{TOPIC}:=/elsewhere'], senders.add(True, False)
    node = rclpy.create_node('remapped', context=senders.node.context, cli_args=given)
    recorded = RecorderInput(node, Selection(frozenset()), message_text)
    try:
        found = []
        assert senders.client.wait(lambda: found.extend(recorded.search()) or found)
        senders.client.wait(lambda: found.extend(recorded.search()), 0.3)
        assert TOPIC in [name for name, *_ in found] and sender.get_subscription_count() == 1
    finally:
        recorded.close()
        node.destroy_node()


def test_given_messages_without_a_sender_when_one_offers_less_then_it_is_told(senders, monkeypatch):
    """As in distributions before Kilted."""
    monkeypatch.setattr(recorder_input, '_TELLS_PUBLISHERS', False)
    reliable = senders.add(True, False)
    senders.wait(lambda: reliable.get_subscription_count() == 1)
    senders.add(False, False)
    senders.wait(lambda: 'lower quality' in senders.input.refused.get(TOPIC, ''))
    senders.send(reliable)
    assert senders.names() == [0]


def test_given_types_that_cannot_be_recorded_when_found_then_others_are_heard(senders):
    senders.client.node.create_publisher(String, 'torque', 10)  # no other type in this process
    with ros.client(senders.node.context.get_domain_id()) as other:
        for kind, topic in ((JointState, 'torque'), (GetParameters.Event, 'joint_states')):
            other.node.create_publisher(kind, topic, 10)  # no file defines the second one
        senders.wait(lambda: len(senders.input.refused) == 2)
        joints = senders.add(True, False)
        senders.wait(lambda: joints.get_subscription_count() == 1)
        senders.send(joints)
        assert senders.names() == [0] and 'incompatible' in senders.input.refused['/lpv/torque']


def test_given_sockets_when_enlarged_then_they_hold_more_and_stay_open():
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket() as other:
        before = [s.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for s in (one, other)]
        opened = os.listdir('/proc/self/fd')
        enlarge_sockets()
        assert os.listdir('/proc/self/fd') == opened
        after = [s.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for s in (one, other)]
    assert after[0] > before[0] and after[1] == before[1]


def test_given_an_rclpy_with_other_modules_when_nodes_are_imported_then_none_misses_its_own():
    """As of distributions after Kilted: some of what it has is elsewhere, or named otherwise."""
    moved = 'rclpy.topic_endpoint_info', 'rclpy._rclpy_pybind11', 'rclpy.experimental'
    nodes = 'lpv_arm_sim', 'lpv_node.recorder', 'lpv_node.view', 'lpv_tracker', 'lpv_uio'
    code = 'import sys, rclpy, rclpy.lifecycle, rclpy.parameter_service, rclpy.executors\n'
    code += f'sys.modules.update(dict.fromkeys({moved}))\n'
    code += ''.join(f'import {name}.node\n' for name in nodes)
    code += 'from lpv_node.managed import make_executor\nrclpy.init()\nmake_executor()\n'
    subprocess.run([sys.executable, '-c', code], check=True)
