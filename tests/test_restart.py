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
SAFE = 500_000_000
"""Longest time from the death of a node to a braked arm [ns]: timeouts of 0.2 s, and slack."""
RECOVERY = 1_000_000_000
"""Longest time from a node's first data to commands that follow the path again [ns]."""


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Rig:
    """A running graph, and what is heard from it."""

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
            self.heard[topic] = client.listen(kind, topic, qos)

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
        return time.time_ns()

    def since(self, topic, moment):
        """Messages stamped after a moment; in real time stamps are of the same clock."""
        return [m for m in self.heard[topic] if stamp_of(m) > moment]

    def moves(self, moment):
        """Whether the arm has been moved by a command since."""
        return (any(not m.safe_stop for m in self.since('torque_command', moment))
                and any(np.abs(m.velocity).max() > 0.01
                        for m in self.since('ground_truth', moment)))

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
    assert rig.client.wait(lambda: len(rig.since('ground_truth', death + SAFE)) > 50)
    for truth in rig.since('ground_truth', death + SAFE):
        assert np.all(np.asarray(truth.velocity) == 0.0)


def assert_no_command(rig, death):
    """The last that the tracker said was to stop, and that soon."""
    rig.spin(1.0)
    assert rig.since('torque_command', death)[-1].safe_stop
    assert rig.since('torque_command', death + SAFE) == []


def assert_recovers(rig, name, data_topic):
    """Within RECOVERY of the first data the arm is moved again."""
    moment = time.time_ns()
    rig.start(name)
    assert rig.client.wait(lambda: rig.moves(moment), 120.0), f'no recovery of {name}'
    first = stamp_of(rig.since(data_topic, moment)[0])
    good = next(m for m in rig.since('torque_command', moment) if not m.safe_stop)
    assert stamp_of(good) - first < RECOVERY
    rig.spin(1.0)


def test_given_real_time_when_each_node_is_killed_then_the_arm_brakes_and_goes_on_with_the_new_one(
        tmp_path, gains_file):
    with rig_on(tmp_path, gains_file) as rig:
        for name in ('recorder', 'uio', 'tracker', 'simulator'):
            rig.start(name)
        begin = time.time_ns()
        assert rig.client.wait(lambda: rig.moves(begin), 120.0), 'the arm does not start'
        rig.spin(2.0)

        death = rig.kill('uio')
        assert_braked(rig, death)
        assert_no_command(rig, death)
        assert_recovers(rig, 'uio', 'state_estimate')
        # The path's clock stood still: the reference goes on where the arm was left.
        before = [m for m in rig.heard['reference'] if stamp_of(m) < death][-1]
        after = rig.since('reference', death + SAFE)[0]
        np.testing.assert_allclose(after.position, before.position, atol=0.1)
        np.testing.assert_allclose(after.velocity, 0.0, atol=0.05)

        death = rig.kill('recorder')  # nobody else minds
        rig.spin(0.3)
        assert rig.moves(death)
        rig.start('recorder')

        death = rig.kill('tracker')
        assert_braked(rig, death)
        assert rig.since('torque_command', death + SAFE) == []
        assert_recovers(rig, 'tracker', 'torque_command')

        death = rig.kill('simulator')
        assert_no_command(rig, death)
        assert_recovers(rig, 'simulator', 'ground_truth')
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
    # No leap of the arm in all that: 0.35 rad/s along the path, 0.5 rad/s in an approach.
    assert max(np.abs(m.velocity).max() for m in rig.heard['ground_truth']) < 0.8
    assert max(np.abs(m.velocity).max() for m in rig.heard['reference']) < 0.6
    assert_recorded(tmp_path / 'bag2', rig)


def assert_recorded(bag, rig):
    """The second recorder has everything from its start on, in a bag of its own."""
    with AnyReader([bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts['/lpv/torque_command'] > 100
    assert counts['/lpv/joint_states'] > 500


def assert_advances(rig, count=50):
    """The lockstep goes on: so many new samples."""
    known = len(rig.heard['joint_states'])
    assert rig.client.wait(lambda: len(rig.heard['joint_states']) > known + count), 'stuck'


def assert_waits(rig):
    """Nobody answers, and no step is made."""
    rig.spin(0.2)
    last = stamp_of(rig.heard['joint_states'][-1])
    rig.spin(0.5)
    assert stamp_of(rig.heard['joint_states'][-1]) == last


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
        measured = [stamp_of(m) for m in rig.heard['joint_states']]
        # No sample was left out; one was repeated for each newcomer, or a few.
        assert set(np.diff(measured)) == {0, 2_000_000}
        rig.kill('simulator')
        rig.start('simulator')
        log = tmp_path / 'log' / 'uio2.log'
        assert rig.client.wait(lambda: 'lockstep starts anew' in log.read_text()), 'no restart'
        assert_advances(rig)
        for name in tuple(rig.nodes):
            rig.kill(name)  # an orderly end would wait for the dead to acknowledge


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
        begin = time.time_ns()
        assert rig.client.wait(lambda: rig.moves(begin))
        # Ended for good, a node is silent but alive.
        answer = rig.client.call(ChangeState, 'uio/change_state', transition=Transition(
            id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
        assert answer.success
        assert rig.client.wait(lambda: rig.client.node.count_publishers('state_estimate') == 0)
        assert rig.client.wait(lambda: rig.heard['torque_command'][-1].safe_stop)
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
