"""Nodes that are killed and restarted while the others run: safe state, then recovery."""

import os
import signal
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import ros

pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from lpv_core.gains import save_gains  # noqa: E402
from lpv_msgs.msg import GroundTruth, JointReference, StateEstimate, TorqueCommand  # noqa: E402
from lpv_node.qos import stream  # noqa: E402

pytestmark = pytest.mark.ros

BRINGUP = Path(__file__).resolve().parents[1] / 'ros2_ws' / 'src' / 'lpv_bringup'
ARM = f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
# In motion from the first second on: a node that dies leaves a moving arm behind.
MOVING = '''
name: moving
duration: 600.0
path:
  waypoints:
    - {t: 0.2, x: -0.8451, y: 1.5893}
    - {t: 6.0, x: 0.0, y: 1.58}
    - {t: 12.0, x: 0.8451, y: 1.5893}
'''
SAFE = 0.5
"""Longest time from the death of a node to a braked arm [s]: timeouts of 0.2 s, and slack."""
RECOVERY = 1.0
"""Longest time from a node's first data to commands that follow the path again [s]."""


class Rig:
    """A running graph, and what is heard from it with the time of hearing."""

    def __init__(self, running, client, gains, folder, lockstep):
        self.running, self.client = running, client
        self._gains, self._folder, self._lockstep = gains, folder, lockstep
        scenario = folder / 'moving.yaml'
        scenario.write_text(MOVING)
        self._own = {'simulator': [ARM, f'scenario_file:={scenario}'], 'uio': [ARM],
                     'tracker': [ARM, f'scenario_file:={scenario}']}
        self.nodes, self._starts = {}, {}
        self.heard = {}
        qos = stream(True) if lockstep else qos_profile_sensor_data
        for kind, topic in ((TorqueCommand, 'torque_command'), (StateEstimate, 'state_estimate'),
                            (GroundTruth, 'ground_truth'), (JointState, 'joint_states'),
                            (JointReference, 'reference')):
            self.heard[topic] = self._listen(kind, topic, qos)

    def _listen(self, kind, topic, qos):
        received = []
        self.client.node.create_subscription(
            kind, topic, lambda m: received.append((time.monotonic(), m)), qos)
        return received

    def start(self, name, *parameters):
        files = [self._gains] if name in ('uio', 'tracker') else []
        self._starts[name] = count = self._starts.get(name, 0) + 1
        own = self._own.get(name) or [f'output:={self._folder / "bag"}{count}']
        line = ros.command(name, *own, f'lockstep:={str(self._lockstep).lower()}', *parameters,
                           files=files)
        self.nodes[name] = self.running.start(f'{name}{count}', line)

    def kill(self, name):
        """SIGKILL; the time of death."""
        node = self.nodes.pop(name)
        os.killpg(node.process.pid, signal.SIGKILL)
        node.process.wait(10)
        self.running.nodes.remove(node)
        return time.monotonic()

    def since(self, topic, moment):
        return [(t, m) for t, m in self.heard[topic] if t > moment]

    def moves(self, moment):
        """Whether the arm has been moved by a command since."""
        return (any(not m.safe_stop for _, m in self.since('torque_command', moment))
                and any(np.abs(m.velocity).max() > 0.01
                        for _, m in self.since('ground_truth', moment)))

    def spin(self, seconds):
        self.client.wait(lambda: False, seconds)


@pytest.fixture(scope='module')
def gains_file(paper_gains, tmp_path_factory):
    path = tmp_path_factory.mktemp('gains') / 'gains.yaml'
    save_gains(paper_gains, path)
    return path


@contextmanager
def rig_on(folder, gains, lockstep=False):
    domain = ros.next_domain()
    with ros.graph(folder / 'log', domain) as running, ros.client(domain) as client:
        yield Rig(running, client, gains, folder, lockstep)


def assert_braked(rig, death):
    """The arm stands still from SAFE after the death on."""
    rig.spin(SAFE + 0.3)
    truths = rig.since('ground_truth', death + SAFE)
    assert len(truths) > 50
    assert all(np.all(np.asarray(m.velocity) == 0.0) for _, m in truths)


def assert_recovers(rig, name, data_topic):
    """Within RECOVERY of the first data the arm is moved again."""
    moment = time.monotonic()
    rig.start(name)
    assert rig.client.wait(lambda: rig.moves(moment)), f'no recovery of {name}'
    first = rig.since(data_topic, moment)[0][0]
    good = next(t for t, m in rig.since('torque_command', moment) if not m.safe_stop)
    assert good - first < RECOVERY
    rig.spin(1.0)


def steps_of_reference(rig):
    return np.abs(np.diff([m.position for _, m in rig.heard['reference']], axis=0))


def test_given_real_time_when_each_node_is_killed_then_the_arm_brakes_and_goes_on_with_the_new_one(
        tmp_path, gains_file):
    with rig_on(tmp_path, gains_file) as rig:
        for name in ('recorder', 'uio', 'tracker', 'simulator'):
            rig.start(name)
        begin = time.monotonic()
        assert rig.client.wait(lambda: rig.moves(begin), 120.0), 'the arm does not start'
        rig.spin(2.0)

        death = rig.kill('uio')
        assert_braked(rig, death)
        assert rig.since('torque_command', death)[-1][1].safe_stop
        assert_recovers(rig, 'uio', 'state_estimate')
        # The path's clock stood still: the reference goes on where the arm was left.
        assert steps_of_reference(rig).max() < 0.02

        death = rig.kill('recorder')  # nobody else minds
        rig.spin(0.3)
        assert rig.moves(death)
        rig.start('recorder')

        death = rig.kill('tracker')
        assert_braked(rig, death)
        assert rig.since('torque_command', death + SAFE) == []
        assert_recovers(rig, 'tracker', 'torque_command')

        death = rig.kill('simulator')
        rig.spin(SAFE + 0.3)
        assert rig.since('torque_command', death)[-1][1].safe_stop
        assert rig.since('torque_command', death + SAFE) == []
        assert_recovers(rig, 'simulator', 'ground_truth')
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
    # No leap of the arm in all that: 0.35 rad/s along the path, 0.5 rad/s in an approach.
    assert max(np.abs(m.velocity).max() for _, m in rig.heard['ground_truth']) < 0.8
    assert max(np.abs(m.velocity).max() for _, m in rig.heard['reference']) < 0.6
    assert_recorded(tmp_path / 'bag2', rig)


def assert_recorded(bag, rig):
    """The second recorder has everything from its start on, in a bag of its own."""
    with AnyReader([bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts['/lpv/torque_command'] > 100
    assert counts['/lpv/joint_states'] > 500


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def assert_advances(rig, count=50):
    """The lockstep goes on: so many new samples."""
    known = len(rig.heard['joint_states'])
    assert rig.client.wait(lambda: len(rig.heard['joint_states']) > known + count), 'stuck'


def assert_waits(rig):
    """Nobody answers, and no step is made."""
    rig.spin(0.2)
    last = stamp_of(rig.heard['joint_states'][-1][1])
    rig.spin(0.5)
    assert stamp_of(rig.heard['joint_states'][-1][1]) == last


def test_given_lockstep_when_each_node_is_killed_then_time_waits_and_goes_on_with_the_new_one(
        tmp_path, gains_file):
    with rig_on(tmp_path, gains_file, lockstep=True) as rig:
        for name in ('uio', 'tracker', 'simulator'):
            rig.start(name)
        assert_advances(rig)
        for name in ('uio', 'tracker'):
            rig.kill(name)
            assert_waits(rig)
            rig.start(name)
            assert_advances(rig)
        measured = [stamp_of(m) for _, m in rig.heard['joint_states']]
        # No sample was left out; one was repeated for each newcomer, or a few.
        assert set(np.diff(measured)) == {0, 2_000_000}
        rig.kill('simulator')
        rig.start('simulator')
        rig.heard['joint_states'].clear()
        assert rig.client.wait(lambda: any(  # the first sample, after what was still queued
            stamp_of(m) == 1_000_000_000 for _, m in rig.heard['joint_states']))
        assert_advances(rig)
        for name in tuple(rig.nodes):
            rig.kill(name)  # an orderly end would wait for the dead to acknowledge
    assert 'lockstep starts anew' in (tmp_path / 'log' / 'uio2.log').read_text()


def test_given_a_node_when_configured_twice_then_it_publishes_and_serves_once(
        tmp_path, gains_file):
    with rig_on(tmp_path, gains_file) as rig:
        for name in ('tracker', 'simulator', 'uio'):
            rig.start(name, 'autostart:=false')
        topics = {'tracker': 'torque_command', 'arm_sim': 'joint_states', 'uio': 'state_estimate'}
        for name, topic in topics.items():
            for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
                               Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP,
                               Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
                answer = rig.client.call(ChangeState, f'{name}/change_state',
                                         transition=Transition(id=transition))
                assert answer.success, (name, transition)
            assert rig.client.wait(lambda t=topic: rig.client.node.count_publishers(t) == 1), name
        services = [n for n, _ in rig.client.node.get_service_names_and_types()]
        assert services.count('/lpv/arm_sim/inject_fault') == 1
        begin = time.monotonic()
        assert rig.client.wait(lambda: rig.moves(begin))
        # Ended for good, a node is silent but alive.
        answer = rig.client.call(ChangeState, 'uio/change_state', transition=Transition(
            id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
        assert answer.success
        assert rig.client.wait(lambda: rig.client.node.count_publishers('state_estimate') == 0)
        rig.spin(SAFE)
        assert rig.heard['torque_command'][-1][1].safe_stop
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
