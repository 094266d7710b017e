"""Sensors that measure combinations of joints: the paper's arm with sensors of absolute angles."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import simulated, with_rates

from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.description import Uncertainty
from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv.core.serial_arm.sensor_map import map_rows

S = np.array(((1.0, 0.0), (1.0, 1.0)))
ONSET = 4.0
FAULTS = {
    'nothing': lambda time: 0.0 * time,
    'step': lambda time: 0.05 * (time >= ONSET),
    'drift': lambda time: 0.05 * np.maximum(time - ONSET, 0.0),
    'offset': lambda time: 0.3 + 0.0 * time,
}
"""Errors of a reading over time [rad]."""


@pytest.fixture
def arm(paper_arm):
    return with_rates(paper_arm, 'independent', uncertainty=Uncertainty(0.0, 0.0, 0.05))


def driven(arm, fault='nothing', sensor=0, seed=1, duration=8.0):
    """Stamps, joint positions, rates, efforts as a driver finds them from readings; the truth."""
    run = simulated(replace(arm, sensor_matrix=None), seed=seed, duration=duration)
    time, rng = run.stamps * 1e-9, np.random.default_rng(seed)
    reading = run.position @ S.T + 1e-3 * rng.normal(size=run.position.shape)
    rate = np.gradient(run.position, time, axis=0) @ S.T + 1e-2 * rng.normal(size=reading.shape)
    reading[:, sensor] += FAULTS[fault](time)
    if arm.joints[0].sensors.rates == 'derived':
        rate[1:] = np.diff(reading, axis=0) / arm.sample_time
    back = np.linalg.inv(S)
    samples = np.stack([reading @ back.T, rate @ back.T, run.samples[:, 2]], axis=1)
    return run.stamps, samples, run.position


def watched(arm, *arguments):
    monitor = SerialMonitor(arm)
    monitor.update_many(*driven(arm, *arguments)[:2])
    return monitor


@pytest.mark.parametrize('rates', ['independent', 'derived'])
@pytest.mark.parametrize('seed', [1, 2])
def test_healthy_arm_raises_nothing(arm, rates, seed):
    assert watched(with_rates(arm, rates), 'nothing', 0, seed).alarms == []


@pytest.mark.slow
@pytest.mark.parametrize('sensor', [0, 1])
@pytest.mark.parametrize('fault', ['step', 'drift', 'offset'])
@pytest.mark.parametrize('seed', [1, 2])
def test_fault_is_named_and_measured_on_its_sensor_whatever_joints_it_moves(
    arm, sensor, fault, seed
):
    monitor = watched(arm, fault, sensor, seed)
    assert {alarm.sensor for alarm in monitor.alarms if alarm.sensor} == {f'link{sensor + 1}_angle'}
    found = monitor.estimate(0).fault
    assert abs(found[1 - sensor]) < 0.03
    if fault != 'drift' and seed == 1:
        assert {alarm.kind for alarm in monitor.alarms} == {'bias'}
        size = float(FAULTS[fault](np.array([8.0]))[0])
        assert found[sensor] == pytest.approx(size, abs=0.04)


@pytest.mark.parametrize('sensor', [0, 1])
def test_step_with_derived_rates_is_named_on_its_sensor(arm, sensor):
    (alarm,) = watched(with_rates(arm, 'derived'), 'step', sensor).alarms
    assert (alarm.sensor, alarm.kind) == (f'link{sensor + 1}_angle', 'bias')


@pytest.mark.parametrize('sensor', [0, 1])
def test_reading_that_freezes_is_named_although_its_joint_position_changes(arm, sensor):
    stamps, samples, _ = driven(arm, duration=6.0)
    reading = map_rows(S, samples[:, 0])
    frozen = int(4.3 / arm.sample_time)
    reading[frozen:, sensor] = reading[frozen, sensor]
    samples[:, 0] = map_rows(np.linalg.inv(S), reading)
    monitor = SerialMonitor(arm)
    monitor.update_many(stamps, samples)
    assert monitor.sampler.still[sensor] == len(stamps) - frozen - 1
    assert (f'link{sensor + 1}_angle', 'stuck') in {(a.sensor, a.kind) for a in monitor.alarms}


@pytest.mark.parametrize('sensor', [0, 1])
def test_answers_are_joint_positions_without_the_fault(arm, sensor):
    stamps, samples, truth = driven(arm, 'step', sensor, duration=6.0)
    answers = SerialSensorMonitor('test', arm).take_many(stamps, *np.moveaxis(samples, 1, 0))
    assert np.abs(answers.state['measured_position'] - samples[:, 0]).max() < 1e-12
    last = answers.state['compensated_position'][-500:] - truth[-500:]
    assert np.abs(last).max() < 0.02
    assert answers.fault['alarm'][-1].tolist() == [sensor == 0, sensor == 1]


def test_reading_that_is_missing_spoils_only_joints_that_need_it():
    assert map_rows(np.eye(2)[::-1], np.array([np.nan, 2.0]))[0] == 2.0
    joints = map_rows(np.linalg.inv(S), np.array([1.0, np.nan]))
    assert joints[0] == 1.0 and np.isnan(joints[1])
