"""Answers of the tracker node to single estimates, without a graph."""

from types import SimpleNamespace

import numpy as np
import pytest
from hostile import Output, node_of
from places import BRINGUP

from lpv.core.serial_arm.certificate.conditions import NO_CERTIFICATE
from lpv.core.support.errors import ConfigError
from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand
from lpv_tracker.node import TrackerNode

pytestmark = pytest.mark.ros

PLACES = {'paper': [0.1, 0.2], 'ur10': [0.0, -1.6, 1.5, -1.4, -1.5, 0.0]}
"""Of an arm on its path."""


def tracker(arm, *files, scenario=None, **parameters):
    """A configured tracker of a shipped arm, in lockstep if not said otherwise."""
    scenario = scenario or {'paper': 'two_faults'}.get(arm, arm)
    given = {
        'arm_file': BRINGUP / 'arms' / f'{arm}.yaml',
        'scenario_file': BRINGUP / 'scenarios' / f'{scenario}.yaml',
        'lockstep': 'true',
    }
    return node_of(TrackerNode, 'tracker', *files, **{**given, **parameters})


@pytest.fixture
def node(request):
    """A tracker of the paper's arm, or as a test asks; `answers` feeds it."""
    options = {'arm': 'paper', **getattr(request, 'param', {})}
    files = [BRINGUP / 'gains' / 'paper.yaml'] if options['arm'] == 'paper' else []
    with tracker(options.pop('arm'), *files, **options) as node:
        node.sent = node._command_out = Output(TorqueCommand)
        node._reference_out = Output(JointReference)
        yield node


def estimate(node, number, trustworthy=True, offset=0.0, correction=0.0):
    """Of an arm at rest beside its path, whose first reading is corrected."""
    place = np.array(PLACES[node._arm.name]) + offset
    zeros = [0.0] * len(place)
    message = StateEstimate(
        trustworthy=trustworthy, position=place, compensated_position=place,
        measured_position=place, velocity=zeros, measured_velocity=zeros)  # fmt: skip
    message.measured_position[0] += correction
    message.header.stamp.sec, message.header.stamp.nanosec = 1, number * 2_000_000
    return message


def answers(node, numbers, **options):
    """Safe stops that answer so many estimates."""
    known = len(node.sent.sent)
    for number in numbers:
        node._on_estimate(estimate(node, number, **options))
    return [message.safe_stop for message in node.sent.sent[known:]]


def test_given_estimates_when_trustworthy_then_each_is_answered_and_the_arm_stops_at_others(node):
    assert answers(node, (1, 2, 2)) == [False] * 3  # in lockstep an answer is repeated
    assert answers(node, (3,), trustworthy=False) == [True]
    assert answers(node, (4,)) == [False]


@pytest.mark.parametrize('node', [{'arm': 'ur10'}], indirect=True)
def test_given_a_serial_arm_when_estimated_then_torques_carry_it_until_it_is_far_off(node):
    assert answers(node, (1, 2, 3)) == [False] * 3
    shoulder, elbow = node.sent.sent[0].torque[1:3]
    assert 20.0 < abs(shoulder) < 120.0 and 5.0 < abs(elbow) < 80.0
    assert answers(node, range(4, 42), offset=0.8)[-1] and node._watchdog.latched
    assert list(node.sent.last.torque) == [0.0] * 6


@pytest.mark.parametrize(
    ('node', 'field'),
    [
        ({'compensation': '"off"'}, 'measured_position'),
        ({'compensation': 'confirmed'}, 'compensated_position'),
        ({'compensation': 'always'}, 'position'),
    ],
    indirect=['node'],
)
def test_given_a_mode_of_compensation_when_estimated_then_the_loop_uses_its_position(node, field):
    message = estimate(node, 1)
    for k, name in enumerate(('position', 'measured_position', 'compensated_position')):
        setattr(message, name, np.array(PLACES['paper']) + 0.001 * k)
    node._on_estimate(message)
    np.testing.assert_array_equal(node._position, getattr(message, field))


def test_given_an_estimate_of_three_joints_when_it_comes_then_it_is_refused(node):
    for field in ('position', 'velocity', 'measured_velocity'):
        message = estimate(node, 1)
        setattr(message, field, [0.0] * 3)
        node._on_estimate(message)
    assert node.sent.sent == []
    assert node._refusals.counts == {'estimate with another number of joints than the arm': 3}


@pytest.mark.parametrize('node', [{'lockstep': 'false'}], indirect=True)
@pytest.mark.parametrize(('pause', 'known'), [(400, False), (400, True), (1, False)])
def test_given_a_fault_when_forgotten_in_a_silence_then_the_arm_waits(node, pause, known):
    """A restarted observer knows no faults; one that saw the end of the fault was not silent."""
    assert not answers(node, range(1, 10), correction=0.2)[-1]
    stops = answers(node, range(9 + pause, 30 + pause), correction=0.2 * known)[-1]
    assert stops == (pause > 1 and not known)
    if stops:
        assert 'forgotten' in node._stop_text()
        node._on_resume(None, SimpleNamespace())
        assert not answers(node, range(30 + pause, 40 + pause))[-1]


# ------------------------------------------------------------------ files of serial arms


@pytest.mark.parametrize(('scenario', 'field'), [('two_faults', 'lpv'), ('panda', 'path.start')])
def test_given_a_scenario_of_another_arm_when_configured_then_the_field_is_named(scenario, field):
    with pytest.raises(ConfigError, match=field), tracker('ur10', scenario=scenario):
        pass


def test_given_gains_or_a_bandwidth_when_configured_then_what_they_guarantee_is_told(tmp_path):
    with tracker('ur10', BRINGUP / 'gains' / 'ur10.yaml') as node:
        assert 'holds for joint rates to 0.6' in node._certificate
    with tracker('ur10', bandwidth=40.0) as node:
        assert node._certificate == NO_CERTIFICATE and node._tolerated < 0.015


@pytest.mark.parametrize(
    ('name', 'old', 'new', 'reason'),
    [
        ('ur10', 'bandwidth: 10.0', 'bandwidth: 8.0', 'does not hold'),
        ('ur10', 'model_error: 0.05', 'model_error: 0.04', 'numbers are those of the design'),
        ('ur10', '      model_error: 0.05\n', '', 'loop.model_error: is not set'),
        ('panda', '/**', '/**', 'is for another arm'),
    ],
)
def test_given_a_false_certificate_when_read_then_it_is_refused(tmp_path, name, old, new, reason):
    text = (BRINGUP / 'gains' / f'{name}.yaml').read_text(encoding='utf-8')
    assert old in text
    (tmp_path / 'gains.yaml').write_text(text.replace(old, new), encoding='utf-8')
    with pytest.raises(ConfigError, match=reason), tracker('ur10', tmp_path / 'gains.yaml'):
        pass
