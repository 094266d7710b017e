"""Sensors that are not what the arm file states: noise, steps, brakes, derived rates."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from parts import Swing

from lpv_core.decision.diagnosis import AlarmEvent, SensorState
from lpv_core.monitoring.message_fields import WARN, Findings, diagnostic_fields
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.observer.sampled_observer import Mode
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement

pytestmark = pytest.mark.slow

DT, START = 0.002, 1_000_000_000


class Recording:
    """Samples of an arm that swings, as lists of position, rate and effort."""

    def __init__(self, arm, duration, pace=1.0, noise=1.0, bits=0, seed=0):
        swing, rng = Swing(arm, pace), np.random.default_rng(seed)
        count = round(duration / DT)
        samples = [swing.sample(DT * k, DT) for k in range(count)]
        self.position, self.velocity, self.effort = (np.array(v) for v in zip(*samples))
        if bits:
            step = 2.0 * math.pi / 2**bits
            self.position = step * np.round(self.position / step)
        else:
            self.position += noise * arm.position_noise * white(swing, rng, count)
        self.velocity += noise * arm.velocity_noise * white(swing, rng, count)

    def diagnose(self, arm, gains):
        stamps = START + np.arange(len(self.position)) * round(1e9 * DT)
        monitor = SensorMonitor('test', arm, gains)
        return monitor.take_many(stamps, self.position, self.velocity, self.effort)


def white(swing, rng, count):
    """Noise of the physical sensors in joint coordinates."""
    draws = rng.standard_normal((count, 2))
    return np.array([swing.joints.joint_velocity_from_sensor(draw) for draw in draws])


def raised(answers):
    return [
        (row * DT, event.sensor_index, event.kind)
        for row, event in answers.events
        if event.event == AlarmEvent.RAISED
    ]


def messages(answers):
    """Statuses of the last report: observer and both sensors."""
    return [status['message'] for status in answers.reports[-1][1]]


# ------------------------------------------------------------------ noise


@pytest.mark.parametrize('noise', [1.5, 2.0])
def test_given_noise_above_what_is_stated_when_healthy_then_it_is_said_and_nothing_raised(
    real_arm, real_gains, noise
):
    answers = Recording(real_arm, 20.0, noise=noise).diagnose(real_arm, real_gains)
    assert raised(answers) == []
    for sensor, message in zip(real_arm.sensor_names, messages(answers)[1:]):
        found = float(message.split(f'noise of {sensor} is ')[1].split(' times')[0])
        assert found == pytest.approx(noise, rel=0.15)
    assert answers.reports[-1][1][1]['level'] == WARN


def test_given_stated_noise_when_healthy_then_nothing_is_said_of_it(real_arm, real_gains):
    answers = Recording(real_arm, 40.0).diagnose(real_arm, real_gains)
    said = {status['message'] for _, report in answers.reports for status in report}
    assert not any('noise' in message for message in said)


@pytest.mark.parametrize('noise', [1.0, 2.0])
def test_given_steps_when_noise_is_as_stated_or_twice_then_they_are_found_at_once(
    real_arm, real_gains, noise
):
    limit = 6.5 * math.sqrt(2.0) * real_arm.position_noise * noise
    recording = Recording(real_arm, 10.0, noise=noise)
    recording.position[2500:, 0] += 2.0 * limit
    found = raised(recording.diagnose(real_arm, real_gains))
    assert [sensor for _, sensor, _ in found] == [0]
    assert 5.0 < found[0][0] < 5.05


def test_given_a_reading_that_becomes_noisy_when_it_is_a_fault_then_it_is_one(real_arm, real_gains):
    recording = Recording(real_arm, 10.0)
    recording.position[2500:, 1] += 0.02 * np.random.default_rng(1).standard_normal(2500)
    found = raised(recording.diagnose(real_arm, real_gains))
    assert found[0][1] == 1 and 5.0 < found[0][0] < 5.2


def test_given_a_warning_when_the_level_is_small_then_its_message_names_the_contradiction(
    paper_arm,
):
    positions = {f'{name}_position': np.zeros(2) for name in ('compensated', 'measured')}
    state = SimpleNamespace(mode=Mode.OBSERVING, trustworthy=True, **positions)
    fault = SimpleNamespace(
        estimate=[0.01, 0.2], threshold=[0.1, 0.1], bound=[0.1, 0.1], state=[SensorState.WARN] * 2
    )
    findings = Findings(True, False, ({}, {}))
    observer, one, two = diagnostic_fields('node', paper_arm, state, fault, findings, {})
    assert observer['message'] == one['message']
    assert one['message'].startswith('inconsistent, cause unknown')
    assert two['message'] == 'above the threshold, not confirmed'


# ------------------------------------------------------------------ steps of encoders


@pytest.fixture(scope='module', params=[12, 17, 20])
def quantised(request, real_arm):
    """An arm with encoders of so many bits, as stated; its gains."""
    step = 2.0 * math.pi / 2**request.param
    arm = replace(real_arm, position_noise=step / math.sqrt(12.0))
    return arm, design(arm, load_requirement('real_arm')).gains, request.param


@pytest.mark.parametrize('pace', [0.0, 0.02])
def test_given_an_encoder_when_it_rests_or_is_slow_then_it_is_not_stuck(quantised, pace):
    arm, gains, bits = quantised
    answers = Recording(arm, 30.0, pace=pace, bits=bits).diagnose(arm, gains)
    assert raised(answers) == []


def test_given_an_encoder_when_it_is_stuck_and_the_arm_moves_then_it_is_found(quantised):
    arm, gains, bits = quantised
    recording = Recording(arm, 10.0, bits=bits)
    recording.position[2500:, 1] = recording.position[2500, 1]
    found = raised(recording.diagnose(arm, gains))
    assert found[0][:2] == (pytest.approx(5.1, abs=0.1), 1)


# ------------------------------------------------------------------ brakes


def braked(arm, position, effort, duration, noise=1.0, fault=(0.0, 0.0)):
    """An arm at rest."""
    recording = Recording(arm, duration, pace=0.0, noise=noise)
    recording.position += np.asarray(position) - Swing(arm, 0.0).position(0.0) + fault
    recording.effort = np.tile(np.asarray(effort, float), (len(recording.position), 1))
    return recording


def holding(arm, position):
    """Torque that holds the arm against gravity."""
    joints, constants = Swing(arm).joints, arm.constants()
    theta = joints.absolute_position(np.asarray(position))
    return joints.joint_torque(-constants.gravity * np.sin(theta))


POSES = [(1.9, 0.2), (1.2, -0.3), (1.0, 0.4)]


@pytest.mark.parametrize('position', POSES)
def test_given_brakes_without_measured_torque_when_the_arm_rests_then_no_sensor_is_faulty(
    paper_arm, paper_gains, position
):
    answers = braked(paper_arm, position, (0.0, 0.0), 15.0).diagnose(paper_arm, paper_gains)
    assert raised(answers) == []
    assert 'measured torques do not hold it' in messages(answers)[0]
    assert answers.state.trustworthy[-1]


@pytest.mark.parametrize('position', POSES)
def test_given_measured_torque_when_a_level_is_wrong_then_rest_does_not_hide_it(
    paper_arm, paper_gains, position
):
    effort = holding(paper_arm, position)
    recording = braked(paper_arm, position, effort, 20.0, fault=(0.3, 0.0))
    answers = recording.diagnose(paper_arm, paper_gains)
    assert 0 in {sensor for _, sensor, _ in raised(answers)}
    assert 'do not hold' not in messages(answers)[0]


def test_given_brakes_when_they_open_then_the_healthy_arm_goes_on_without_an_alarm(
    paper_arm, paper_gains
):
    rest, swing = Recording(paper_arm, 20.0, pace=0.0), Recording(paper_arm, 20.0)
    position, effort = swing.position[0], holding(paper_arm, swing.position[0])
    still = braked(paper_arm, position, (0.0, 0.0), 10.0)
    held = braked(paper_arm, position, effort, 10.0)
    rest.position = np.concatenate([still.position, held.position])
    rest.effort = np.concatenate([still.effort, held.effort])
    answers = rest.diagnose(paper_arm, paper_gains)
    assert raised(answers) == []
    assert messages(answers)[0] == 'observing'


# ------------------------------------------------------------------ derived rates


def derive(recording):
    recording.velocity = np.diff(recording.position, axis=0, prepend=recording.position[:1]) / DT


@pytest.mark.parametrize(('stated', 'warned'), [('independent', True), ('derived', False)])
def test_given_rates_from_the_encoders_when_they_contradict_the_arm_file_then_it_is_said(
    real_arm, real_gains, stated, warned
):
    recording = Recording(real_arm, 5.0, noise=0.01)
    derive(recording)
    arm = replace(real_arm, rates=stated)
    answers = recording.diagnose(arm, real_gains)
    said = f'rates of {arm.sensor_names[1]} are derived, the arm file states {stated}'
    assert (said in messages(answers)[2]) == warned


def test_given_a_warning_when_measurements_go_on_then_the_log_has_it_once(real_arm, real_gains):
    recording = Recording(real_arm, 5.0, noise=0.01)
    derive(recording)
    monitor = SensorMonitor('test', replace(real_arm, rates='independent'), real_gains)
    said = []
    for k in range(len(recording.position)):
        message = Message(real_arm, recording, k)
        said += monitor.take(START + k * round(1e9 * DT), message).warnings
    assert len([text for text in said if 'derived' in text]) == 2


class Message:
    """Fields of sensor_msgs/JointState."""

    def __init__(self, arm, recording, k):
        self.name = list(arm.joint_names)
        self.position = recording.position[k]
        self.velocity, self.effort = recording.velocity[k], recording.effort[k]


@pytest.mark.parametrize('rates', ['independent', 'derived'])
def test_given_a_drift_when_rates_are_derived_then_position_and_rate_are_wrong_together(
    paper_arm, paper_gains, rates
):
    fault = Fault(paper_arm.sensor_names[0], 'drift', 2.0, 2.0, 0.0, 0.5)
    scenario = load_scenario(bringup_file('scenarios', 'two_faults'))
    scenario = replace(scenario, faults=(fault,), duration=5.0, noise=False)
    run = run_closed_loop(replace(paper_arm, rates=rates), paper_gains, scenario, 'off')
    error = (run.measured_velocity - run.velocity)[:, 0]
    expected = 0.5 if rates == 'derived' else 0.0
    np.testing.assert_allclose(error[1100:1900], expected, atol=1e-9)
    np.testing.assert_allclose(error[2100:], 0.0, atol=1e-9)
