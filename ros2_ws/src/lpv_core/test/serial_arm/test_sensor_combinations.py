"""Sensors that measure combinations of joints: the paper's arm with sensors of absolute angles."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import wrong_plant

from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
    Uncertainty,
)
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.serial_arm.sensor_map import map_rows
from lpv_core.serial_arm.simulation import SerialSimulator

S = ((1.0, 0.0), (1.0, 1.0))
ONSET = 4.0


def paper_arm(rates='independent'):
    joints = []
    for i, (mass, inertia, limit) in enumerate(((10.0, 0.83, 1500.0), (5.0, 0.41, 600.0))):
        around_joint = inertia + mass * 0.25
        joints.append(SerialJoint(
            f'joint{i + 1}', (float(i), 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
            LinkInertia(mass, (0.5 * mass, 0.0, 0.0),
                        (0.0, 0.0, around_joint, 0.0, 0.0, around_joint)),
            JointFriction(), limits=JointLimits(-1.5, 1.5, 4.0, limit),
            sensors=JointSensors(f'link{i + 1}', 1e-3, 0.0, rates, 1e-2)))  # fmt: skip
    return SerialArm(
        'paper', tuple(joints), (np.pi / 2, 0.0, 0.0), 9.8, (1.0, 0.0, 0.0),
        uncertainty=Uncertainty(0.0, 0.0, 0.05), sensor_matrix=S)  # fmt: skip


def driven(arm, fault, sensor, seed, duration=8.0):
    """Joint positions, rates and efforts as a driver finds them from the readings; the truth."""
    plain = replace(arm, sensor_matrix=None)
    run = SerialSimulator(plain, wrong_plant(plain, seed), seed).run(duration)
    time, rng = run.stamps * 1e-9, np.random.default_rng(seed)
    size = fault(time)
    reading = run.position @ np.array(S).T + 1e-3 * rng.normal(size=run.position.shape)
    rate = np.gradient(run.position, time, axis=0) @ np.array(S).T
    rate += 1e-2 * rng.normal(size=rate.shape)
    reading[:, sensor] += size
    if arm.joints[0].sensors.rates == 'derived':
        rate[1:] = np.diff(reading, axis=0) / arm.sample_time
    back = np.linalg.inv(S)
    samples = np.stack([reading @ back.T, rate @ back.T, run.samples[:, 2]], axis=1)
    return run.stamps, samples, run.position


def step(time):
    return 0.05 * (time >= ONSET)


def drift(time):
    return 0.05 * np.maximum(time - ONSET, 0.0)


def offset(time):
    return 0.3 + 0.0 * time


def nothing(time):
    return 0.0 * time


def watched(arm, *arguments):
    stamps, samples, _ = driven(arm, *arguments)
    monitor = SerialMonitor(arm)
    monitor.update_many(stamps, samples)
    return monitor


@pytest.mark.parametrize('rates', ['independent', 'derived'])
@pytest.mark.parametrize('seed', [1, 2])
def test_healthy_arm_raises_nothing(rates, seed):
    assert watched(paper_arm(rates), nothing, 0, seed).alarms == []


@pytest.mark.parametrize('sensor', [0, 1])
@pytest.mark.parametrize('fault', [step, drift, offset])
@pytest.mark.parametrize('seed', [1, 2])
def test_fault_is_named_on_its_sensor_whatever_joints_it_moves(sensor, fault, seed):
    monitor = watched(paper_arm(), fault, sensor, seed)
    assert {alarm.sensor for alarm in monitor.alarms if alarm.sensor} == {f'link{sensor + 1}'}
    other = monitor.estimate(0).fault[1 - sensor]
    assert abs(other) < 0.03


@pytest.mark.parametrize('sensor', [0, 1])
@pytest.mark.parametrize('fault', [step, offset])
def test_bias_is_measured_on_its_sensor(sensor, fault):
    monitor = watched(paper_arm(), fault, sensor, 1)
    assert {alarm.kind for alarm in monitor.alarms} == {'bias'}
    size = float(fault(np.array([8.0]))[0])
    assert monitor.estimate(0).fault[sensor] == pytest.approx(size, abs=0.04)


@pytest.mark.parametrize('sensor', [0, 1])
def test_step_with_derived_rates_is_named_on_its_sensor(sensor):
    monitor = watched(paper_arm('derived'), step, sensor, 1)
    assert [(alarm.sensor, alarm.kind) for alarm in monitor.alarms] == [
        (f'link{sensor + 1}', 'bias')
    ]


@pytest.mark.parametrize('sensor', [0, 1])
def test_reading_that_freezes_is_named_although_its_joint_position_changes(sensor):
    arm = paper_arm()
    stamps, samples, _ = driven(arm, nothing, 0, 1, 6.0)
    reading = map_rows(np.array(S), samples[:, 0])
    frozen = int(4.3 / arm.sample_time)
    reading[frozen:, sensor] = reading[frozen, sensor]
    samples[:, 0] = map_rows(np.linalg.inv(S), reading)
    monitor = SerialMonitor(arm)
    monitor.update_many(stamps, samples)
    assert monitor.sampler.still[sensor] == len(stamps) - frozen - 1
    assert (f'link{sensor + 1}', 'stuck') in {(one.sensor, one.kind) for one in monitor.alarms}


@pytest.mark.parametrize('sensor', [0, 1])
def test_answers_are_joint_positions_without_the_fault(sensor):
    arm = paper_arm()
    stamps, samples, truth = driven(arm, step, sensor, 1, 6.0)
    monitor = SerialSensorMonitor('test', arm)
    answers = monitor.take_many(stamps, *np.moveaxis(samples, 1, 0))
    assert np.abs(answers.state['measured_position'] - samples[:, 0]).max() < 1e-12
    last = answers.state['compensated_position'][-500:] - truth[-500:]
    assert np.abs(last).max() < 0.02
    assert answers.fault['alarm'][-1].tolist() == [sensor == 0, sensor == 1]


def test_reading_that_is_missing_spoils_only_joints_that_need_it():
    values = np.array([np.nan, 2.0])
    assert map_rows(np.array([[1.0, 0.0], [0.0, 1.0]])[::-1], values)[0] == 2.0
    joints = map_rows(np.linalg.inv(S), np.array([1.0, np.nan]))
    assert joints[0] == 1.0 and np.isnan(joints[1])
