from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hostile import RECOVERY, Output, Refused, forge, node_of, run_cases, set_parameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from lpv.core.control.watchdog import StopReason
from lpv.core.serial_arm.certificate.loop_gains import NO_CERTIFICATE
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp
from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand
from lpv_tracker.node import TrackerNode

pytestmark = pytest.mark.ros
IN_REAL_TIME = pytest.mark.parametrize('node', [{'lockstep': 'false'}], indirect=True)
STEP = 2_000_000
PLACES = {'paper': [0.1, 0.2], 'ur10': [0.0, -1.6, 1.5, -1.4, -1.5, 0.0]}
"""Of an arm on its path."""


def tracker(*files, arm='ur10', scenario=None, lockstep='true', **parameters):
    names = {'arm_file': arm, 'scenario_file': scenario or {'paper': 'two_faults'}.get(arm, arm)}
    return node_of(TrackerNode, *files, lockstep=lockstep, **names, **parameters)


@pytest.fixture
def node(request):
    """A tracker of the paper's arm, or as a test asks; `answers` feeds it."""
    options = {'arm': 'paper', **getattr(request, 'param', {})}
    files = [bringup_file('gains', 'paper')] if options['arm'] == 'paper' else []
    with tracker(*files, **options) as node:
        node.sent = node._command_out = Output(TorqueCommand)
        node.references = node._reference_out = Output(JointReference)
        yield node


def estimate(place, stamp, trustworthy=True, correction=0.0):
    """Of an arm at rest, whose first reading is corrected."""
    message = StateEstimate(trustworthy=trustworthy)
    message.position = message.compensated_position = message.measured_position = place
    message.velocity = message.measured_velocity = [0.0] * len(place)
    message.measured_position[0] += correction
    set_stamp(message.header.stamp, stamp)
    return message


def answers(node, numbers, offset=0.0, **options):
    """Safe stops that answer so many estimates of an arm beside its path."""
    known, place = len(node.sent.sent), np.array(PLACES[node._arm.name]) + offset
    for number in numbers:
        node._on_estimate(estimate(place, 10**9 + number * STEP, **options))
    return [message.safe_stop for message in node.sent.sent[known:]]


def test_given_estimates_when_trustworthy_then_each_is_answered_and_the_arm_stops_at_others(node):
    assert answers(node, (1, 2, 2)) == [False] * 3  # in lockstep an answer is repeated
    assert answers(node, (3,), trustworthy=False) == [True]
    assert answers(node, (4,)) == [False]
    for field in ('position', 'velocity', 'measured_velocity'):
        message = estimate(PLACES['paper'], 10**10)
        setattr(message, field, [0.0] * 3)
        node._on_estimate(message)
    assert len(node.sent.sent) == 5
    assert node._refusals.counts == {'estimate with another number of joints than the arm': 3}


def test_given_an_observer_that_counts_turns_anew_when_joints_are_endless_then_the_arm_goes_on(
    node,
):
    node._endless[:] = True
    assert answers(node, (1, 2)) == [False] * 2
    assert answers(node, (3, 4), offset=np.array([2.0, -4.0]) * np.pi) == [False] * 2
    torque = np.array([message.torque for message in node.sent.sent])
    assert np.abs(np.diff(torque[1:], axis=0)).max() < 1.0


@pytest.mark.parametrize('node', [{'arm': 'ur10'}], indirect=True)
def test_given_a_serial_arm_when_estimated_then_torques_carry_it_until_it_is_far_off(node):
    assert answers(node, (1, 2, 3)) == [False] * 3
    shoulder, elbow = node.sent.sent[0].torque[1:3]
    assert 20.0 < abs(shoulder) < 120.0 and 5.0 < abs(elbow) < 80.0
    assert answers(node, range(4, 42), offset=0.8)[-1] and node._watchdog.latched
    assert list(node.sent.last.torque) == [0.0] * 6


POSITIONS = {'off': 'measured_position', 'confirmed': 'compensated_position', 'always': 'position'}


@pytest.mark.parametrize('node', [{'compensation': repr(m)} for m in POSITIONS], indirect=True)
def test_given_a_mode_of_compensation_when_estimated_then_the_loop_uses_its_position(node):
    message = estimate(PLACES['paper'], 10**9)
    for k, name in enumerate(('position', 'measured_position', 'compensated_position')):
        setattr(message, name, np.array(PLACES['paper']) + 0.001 * k)
    node._on_estimate(message)
    field = POSITIONS[node.get_parameter('compensation').value]
    np.testing.assert_array_equal(node._position, getattr(message, field))


@IN_REAL_TIME
@pytest.mark.parametrize(('correction', 'scale', 'pause', 'known'), [
    (0.2, 1.0, 400, False), (0.2, 1.0, 400, True), (0.2, 1.0, 1, False),
    (0.03, 0.03, 400, False),  # much of a quill that moves by 0.2 m
])  # fmt: skip
def test_given_a_fault_forgotten_in_silence_then_it_waits(node, correction, scale, pause, known):
    """A restarted observer knows no faults; one that saw the end of the fault was not silent."""
    node._scales = np.array([scale, 1.0])
    assert not answers(node, range(1, 10), correction=correction)[-1]
    stops = answers(node, range(9 + pause, 30 + pause), correction=correction * known)[-1]
    assert stops == (pause > 1 and not known)
    if stops:
        assert 'forgotten' in node._stop_text()
        node._on_resume(None, SimpleNamespace())
        assert not answers(node, range(30 + pause, 40 + pause))[-1]


@IN_REAL_TIME
def test_given_a_loop_on_readings_when_a_fault_is_forgotten_then_it_goes_on(node):
    node.set_parameters([Parameter('compensation', value='off')])
    assert not answers(node, range(1, 10), correction=0.2)[-1]
    assert not answers(node, range(409, 430))[-1]


@IN_REAL_TIME
@pytest.mark.parametrize('switches', [['confirmed', 'confirmed'], ['off', 'confirmed']])
def test_given_a_correction_when_parameters_are_set_then_torques_do_not_leap(node, switches):
    torques, turns = [], dict(zip((60, 160), switches))
    for number in range(1, 350):
        if number in turns:
            [done] = node.set_parameters([Parameter('compensation', value=turns[number])])
            assert done.successful
        last = node.references.last
        place = PLACES['paper'] if last is None else np.array(last.position)
        message = estimate(place, 10**9 + number * STEP)
        message.compensated_position[0] += 0.1 * (number >= 50)  # found, and faded in
        node._on_estimate(message)
        torques.append(node.sent.last.torque)
        assert not node.sent.last.safe_stop
    correction = node._correction.position - node._measured
    np.testing.assert_allclose(correction, [0.1, 0.0], atol=1e-9)
    assert np.abs(np.diff(torques, axis=0)).max() < 35.0  # 28 N m of the fault itself


@IN_REAL_TIME
def test_given_clocks_set_back_when_estimates_end_then_the_arm_is_stopped(node, monkeypatch):
    def at(nanoseconds):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=nanoseconds))

    past, stops = at(node.get_clock().now().nanoseconds - 3600 * 10**9), []
    monkeypatch.setattr(node, '_steady', at(1000 * 10**9))
    assert not answers(node, range(1, 10))[-1]
    monkeypatch.setattr(node, 'get_clock', lambda: past)
    for seconds in (1000, 0, 1):
        monkeypatch.setattr(node, '_steady', at(seconds * 10**9))
        node._check_silence()
        stops.append(node.sent.last.safe_stop)
    assert stops == [False, False, True]


@IN_REAL_TIME
@pytest.mark.parametrize(('ahead', 'said'), [(0.0, '12.0'), (60.0, 'of another clock')])
def test_given_stamps_of_another_clock_then_it_says_that_latency_is_not_watched(node, ahead, said):
    now = 10**9 + STEP + 12_000_000 + round(ahead * 1e9)
    node.get_clock = lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=now))
    assert answers(node, (1,)) == [False]
    assert said in node._status_values()['latency [ms]']


@IN_REAL_TIME
def test_given_no_estimates_when_none_came_yet_or_they_end_then_it_is_said(node, monkeypatch):
    told = node._status.publisher = Output(DiagnosticArray)
    node._check_silence()
    assert told.last.status[0].message == 'safe stop: no estimates'
    assert answers(node, (1,), trustworthy=False) == [True]
    reasons = []
    for later in (500_000_000, 1_500_000_000):
        monkeypatch.setattr(node, 'elapsed', lambda later=later: node._received + later)
        node._check_silence()
        reasons.append(node._reason)
    assert reasons == [StopReason.NOT_TRUSTWORTHY, StopReason.SILENCE]


def test_given_gains_a_path_or_another_arms_scenario_when_configured_then_it_is_told(capfd):
    with tracker(bringup_file('gains', 'ur10')) as node:
        assert 'holds for joint rates to 0.6' in node._certificate
    with tracker(bandwidth=40.0) as node:
        assert node._certificate == NO_CERTIFICATE and node._tolerated < 0.015
    for scenario, field in {'two_faults': 'path.waypoints', 'panda': 'path.start'}.items():
        with pytest.raises(ConfigError, match=field), tracker(scenario=scenario):
            pass
    for share in (0.1, 0.7):  # the path is faster than the first
        capfd.readouterr()
        with tracker(max_speed=share):
            assert ('the path needs' in capfd.readouterr().err) == (share == 0.1)


class Driver:
    def __init__(self, node):
        self.node, self.stamp = node, 10**9
        self.start = node._path.sample(0.0).position

    def good(self):
        self.stamp += STEP
        last = self.node.references.last
        return estimate(self.start if last is None else np.array(last.position), self.stamp)

    def send(self, message):
        """Torques that answer an estimate; refusals are `Refused`."""
        node = self.node
        before = sum(node._refusals.counts.values())
        node._on_estimate(message)
        found = node.sent.take()
        for torque in (command['TorqueCommand.torque'] for command in found):
            assert np.all(np.abs(torque) <= node._arm.torque_limit), torque
        if not found or node.sent.last.safe_stop:
            counted = sum(node._refusals.counts.values()) > before
            raise Refused('counted' if counted else node._stop_text() or 'not continued')
        return found, node.references.take()

    def recover(self):
        """Time of good data until the arm is driven [ns]."""
        self.node._on_resume(Trigger.Request(), Trigger.Response())
        begin, stopped = self.stamp, True
        while stopped and self.stamp - begin < 2 * RECOVERY:
            self.node._on_estimate(self.good())
            stopped = self.node.sent.last.safe_stop
        return self.stamp - begin


@pytest.mark.fuzz
@IN_REAL_TIME
def test_given_hostile_input_when_followed_then_torques_are_within_limits_or_it_stops(node):
    driver = Driver(node)

    def case(rng):
        assert driver.recover() <= RECOVERY
        if rng.random() < 0.5:  # a start from anywhere, not a leap on the way
            node._stop(StopReason.SILENCE)
        return driver.send(forge(rng, driver.good()))

    assert run_cases(250, case).refused and driver.recover() <= RECOVERY
    assert run_cases(100, lambda rng: set_parameters(node, rng)).refused
    assert driver.recover() <= RECOVERY


@IN_REAL_TIME
@pytest.mark.parametrize('field', ['position', 'velocity', 'compensated_position'])
def test_given_an_estimate_that_leaps_when_repeated_then_the_arm_stops(node, field):
    driver = Driver(node)
    for size in (10.0, -10.0, 1e3, 1e6, 1e150, 1e300, 1.7e308):
        stopped = 0
        assert driver.recover() == STEP
        for _ in range(100):
            message = driver.good()
            setattr(message, field, [size, -size])
            try:
                driver.send(message)
            except Refused:
                stopped += 1
        believed = field == 'velocity' and abs(size) <= min(node._arm.velocity_limit)
        # The loop is not closed on positions.
        assert stopped > 50 or believed or field == 'position', size
        assert driver.recover() <= RECOVERY
