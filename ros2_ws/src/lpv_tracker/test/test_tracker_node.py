"""Answers of the tracker node to single estimates, without a graph."""

from types import SimpleNamespace

import pytest
from places import BRINGUP

rclpy = pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

import ros  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402

from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand  # noqa: E402
from lpv_tracker.node import TrackerNode  # noqa: E402

pytestmark = pytest.mark.ros


class Publisher:
    """Keeps what is published."""

    def __init__(self, kind):
        self.kind, self.sent = kind, []

    def publish(self, data):
        self.sent.append(deserialize_message(data, self.kind))

    @property
    def safe_stops(self):
        return [message.safe_stop for message in self.sent]


@pytest.fixture
def node(request):
    """A configured tracker, in lockstep if not said otherwise; its commands are ``node.sent``."""
    files = {
        'arm_file': BRINGUP / 'arms' / 'paper.yaml',
        'scenario_file': BRINGUP / 'scenarios' / 'two_faults.yaml',
        'lockstep': str(getattr(request, 'param', True)).lower(),
    }
    words = [word for name, value in files.items() for word in ('-p', f'{name}:={value}')]
    words += ['--params-file', str(BRINGUP / 'gains' / 'paper.yaml')]
    rclpy.init(args=['--ros-args', *words], domain_id=ros.next_domain())
    tracker = TrackerNode()
    tracker.setup()
    tracker.sent = tracker._command_out = Publisher(TorqueCommand)
    tracker._reference_out = Publisher(JointReference)
    yield tracker
    tracker.destroy_node()
    rclpy.shutdown()


def estimate(number, trustworthy=True):
    names = ('position', 'velocity', 'compensated_position', 'measured_position')
    message = StateEstimate(trustworthy=trustworthy, measured_velocity=[0.0, 0.0])
    for name in names:
        setattr(message, name, [0.0, 0.0] if name == 'velocity' else [0.1, 0.2])
    message.header.stamp.sec, message.header.stamp.nanosec = 1, number * 2_000_000
    return message


def test_given_estimates_when_trustworthy_then_each_is_answered_by_a_torque(node):
    for number in (1, 2, 3):
        node._on_estimate(estimate(number))
    assert node.sent.safe_stops == [False, False, False]


def test_given_an_estimate_that_is_not_trustworthy_when_it_comes_then_the_arm_stops(node):
    node._on_estimate(estimate(1))
    node._on_estimate(estimate(2, trustworthy=False))
    node._on_estimate(estimate(3))
    assert node.sent.safe_stops == [False, True, False]


def test_given_the_same_estimate_again_when_in_lockstep_then_the_answer_is_repeated(node):
    node._on_estimate(estimate(1))
    node._on_estimate(estimate(1))
    assert node.sent.safe_stops == [False, False]


@pytest.mark.parametrize('field', ['position', 'velocity', 'measured_velocity'])
def test_given_an_estimate_of_three_joints_when_it_comes_then_it_is_refused(node, field):
    message = estimate(1)
    setattr(message, field, [0.0] * 3)
    node._on_estimate(message)
    assert node.sent.safe_stops == []
    assert list(node._refusals.counts) == ['estimate with another number of joints than the arm']


def answers(node, numbers, corrected, size=0.2):
    """Answers to estimates, with a correction of the first joint or without."""
    for number in numbers:
        message = estimate(number)
        message.measured_position[0] += size * corrected
        node._on_estimate(message)
    return node.sent.safe_stops[-1]


@pytest.mark.parametrize('node', [False], indirect=True)
@pytest.mark.parametrize(('pause', 'known'), [(400, False), (400, True), (1, False)])
def test_given_a_confirmed_fault_when_forgotten_during_a_silence_then_the_arm_waits_for_resume(
    node, pause, known
):
    """A restarted observer knows no faults; one that saw the end of the fault was not silent."""
    assert not answers(node, range(1, 10), corrected=True)
    stops = answers(node, range(9 + pause, 30 + pause), corrected=known)
    assert stops == (pause > 1 and not known)
    if stops:
        assert 'forgotten' in node._stop_text()
        node._on_resume(None, SimpleNamespace())
        assert not answers(node, range(30 + pause, 40 + pause), corrected=False)
