"""Answers of the tracker node of a serial arm to single estimates, without a graph."""

from types import SimpleNamespace

import numpy as np
import pytest
from places import BRINGUP

rclpy = pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

import ros  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402

from lpv_core.serial_arm.certificate.conditions import NO_CERTIFICATE  # noqa: E402
from lpv_core.support.errors import ConfigError  # noqa: E402
from lpv_msgs.msg import StateEstimate, TorqueCommand  # noqa: E402
from lpv_tracker.node import TrackerNode  # noqa: E402

pytestmark = pytest.mark.ros

START = np.array([0.0, -1.6, 1.5, -1.4, -1.5, 0.0])


class Publisher:
    """Keeps the commands that are published."""

    def __init__(self):
        self.torques, self.safe_stops = [], []

    def publish(self, data):
        message = deserialize_message(data, TorqueCommand)
        self.torques.append(list(message.torque))
        self.safe_stops.append(message.safe_stop)


def start_node(scenario, *words):
    """A tracker of the UR10 in lockstep, not configured yet."""
    files = ('arm_file', BRINGUP / 'arms' / 'ur10.yaml'), ('scenario_file', scenario)
    given = [word for name, value in files for word in ('-p', f'{name}:={value}')]
    rclpy.init(
        args=['--ros-args', '-p', 'lockstep:=true', *given, *words], domain_id=ros.next_domain()
    )
    return TrackerNode()


@pytest.fixture
def node():
    """A configured tracker; its commands are in ``node.sent``."""
    tracker = start_node(BRINGUP / 'scenarios' / 'ur10.yaml')
    tracker.setup()
    tracker.sent = tracker._command_out = Publisher()
    tracker._reference_out = SimpleNamespace(publish=lambda data: None)
    yield tracker
    tracker.destroy_node()
    rclpy.shutdown()


def estimate(number, offset=0.0):
    message = StateEstimate(trustworthy=True)
    for name in ('position', 'compensated_position', 'measured_position'):
        setattr(message, name, (START + offset).tolist())
    message.velocity = message.measured_velocity = [0.0] * 6
    message.header.stamp.sec, message.header.stamp.nanosec = 1, number * 2_000_000
    return message


def test_given_an_arm_at_rest_on_its_path_when_estimated_then_the_torques_carry_it(node):
    for number in (1, 2, 3):
        node._on_estimate(estimate(number))
    assert node.sent.safe_stops == [False] * 3
    shoulder, elbow = node.sent.torques[0][1:3]
    assert 20.0 < abs(shoulder) < 120.0 and 5.0 < abs(elbow) < 80.0


def test_given_an_arm_far_from_its_reference_when_estimated_then_it_is_stopped_for_good(node):
    node._on_estimate(estimate(1))
    for number in range(2, 40):
        node._on_estimate(estimate(number, 0.8))
    assert node.sent.safe_stops[-1] and node._watchdog.latched
    assert node.sent.torques[-1] == [0.0] * 6


@pytest.mark.parametrize(('scenario', 'field'), [('two_faults', 'lpv'), ('panda', 'path.start')])
def test_given_a_scenario_of_another_arm_when_configured_then_the_field_is_named(scenario, field):
    tracker = start_node(BRINGUP / 'scenarios' / f'{scenario}.yaml')
    try:
        with pytest.raises(ConfigError, match=field):
            tracker.setup()
    finally:
        tracker.destroy_node()
        rclpy.shutdown()


def test_given_a_bandwidth_when_configured_then_the_latency_that_it_tolerates_is_known():
    tracker = start_node(BRINGUP / 'scenarios' / 'ur10.yaml', '-p', 'bandwidth:=40.0')
    try:
        tracker.setup()
        assert tracker._tolerated < 0.015
    finally:
        tracker.destroy_node()
        rclpy.shutdown()


def configured(gains):
    """A tracker of the UR10 with a parameter file, configured; ConfigError passes."""
    tracker = start_node(BRINGUP / 'scenarios' / 'ur10.yaml', '--params-file', str(gains))
    try:
        tracker.setup()
        return tracker._certificate
    finally:
        tracker.destroy_node()
        rclpy.shutdown()


def test_given_certified_gains_when_configured_then_the_region_is_told():
    assert 'holds for joint rates to 0.6' in configured(BRINGUP / 'gains' / 'ur10.yaml')


def test_given_a_bandwidth_only_when_configured_then_no_certificate_is_claimed(tmp_path):
    gains = tmp_path / 'gains.yaml'
    gains.write_text('/**: {ros__parameters: {bandwidth: 12.0}}\n', encoding='utf-8')
    assert configured(gains) == NO_CERTIFICATE


@pytest.mark.parametrize(
    ('name', 'old', 'new', 'reason'),
    [
        ('ur10', 'bandwidth: 10.0', 'bandwidth: 8.0', 'does not hold'),
        ('ur10', 'model_error: 0.05', 'model_error: 0.04', 'numbers are those of the design'),
        ('ur10', '      model_error: 0.05\n', '', 'loop.model_error: is not set'),
        ('panda', '', '', 'is for another arm'),
    ],
)
def test_given_a_certificate_that_does_not_hold_when_configured_then_it_is_refused(
    tmp_path, name, old, new, reason
):
    text = (BRINGUP / 'gains' / f'{name}.yaml').read_text(encoding='utf-8')
    assert old in text
    gains = tmp_path / 'gains.yaml'
    gains.write_text(text.replace(old, new) if old else text, encoding='utf-8')
    with pytest.raises(ConfigError, match=reason):
        configured(gains)
