"""What once made bounds useless for ever: then faults are found, and healthy arms are healthy."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.dynamics import inverse_dynamics
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault

pytestmark = pytest.mark.slow

DT, START = 0.002, 1_000_000_000
HALF_SWING, FREQUENCY = 0.8, 2.0 * math.pi * 0.6
QUIET = 10.0
"""Time at rest after which thresholds are those of a fresh start [s]."""


def edge(time):
    """Two minutes with link 1 at 65 degrees, then upright within a second."""
    share = np.clip(time - 120.0, 0.0, 1.0)
    angle = math.radians(65.0) * (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))
    return np.column_stack([angle, np.zeros_like(time)])


def fast_swing(time):
    """+-0.8 rad at 0.6 Hz for ten seconds, faded in and out over a second each."""
    size = HALF_SWING * np.clip(time, 0.0, 1.0) * np.clip(11.0 - time, 0.0, 1.0)
    angle = size * np.sin(FREQUENCY * time)
    return np.column_stack([angle, 0.5 * angle])


ATTACKS = {'edge': (edge, 121.0), 'fast swing': (fast_swing, 11.0)}


def measure(arm, motion, duration, rest, seed=0):
    """Absolute motion as noisy joint measurements, with the torques that it takes."""
    time = DT * np.arange(round((duration + rest) / DT))
    theta = motion(time)
    rate = np.gradient(theta, DT, axis=0)
    acceleration = np.gradient(rate, DT, axis=0)
    constants, joints = arm.constants(), JointMap(arm)
    torque = [inverse_dynamics(*row, constants) for row in np.hstack([theta, rate, acceleration])]
    noise = np.random.default_rng(seed).standard_normal((2, len(time), 2))
    return [
        joints.joint_position(theta) + arm.position_noise * noise[0],
        joints.joint_velocity(rate) + arm.velocity_noise * noise[1],
        np.array([joints.joint_torque(np.array(q)) for q in torque]),
    ]


def diagnose(arm, gains, measured):
    stamps = START + round(1e9 * DT) * np.arange(len(measured[0]))
    return SensorMonitor('test', arm, gains).take_many(stamps, *measured)


def raised(answers):
    return [(row * DT, e.sensor_index) for row, e in answers.events if e.event is AlarmEvent.RAISED]


@pytest.mark.parametrize('name', ATTACKS)
def test_given_an_attack_on_the_bound_when_over_then_thresholds_are_those_of_a_fresh_start(
    paper_arm, paper_gains, name
):
    motion, duration = ATTACKS[name]
    answers = diagnose(paper_arm, paper_gains, measure(paper_arm, motion, duration, QUIET))
    upright = measure(paper_arm, lambda time: 0.0 * fast_swing(time), 0.0, 60.0)
    fresh = diagnose(paper_arm, paper_gains, upright)
    assert raised(answers) == []
    assert np.all(answers.fault.threshold[-1] < 1.1 * fresh.fault.threshold[-1])


@pytest.mark.parametrize('name', ATTACKS)
@pytest.mark.parametrize('index', [0, 1])
def test_given_an_attack_on_the_bound_when_a_sensor_drifts_to_half_a_radian_then_it_alone_is_found(
    paper_arm, paper_gains, name, index
):
    motion, duration = ATTACKS[name]
    measured = measure(paper_arm, motion, duration, 20.0)
    onset = duration + 5.0
    ramp = np.clip(0.05 * (DT * np.arange(len(measured[0])) - onset), 0.0, 0.5)
    direction = JointMap(paper_arm).joint_velocity_from_sensor(np.eye(2)[index])
    measured[0] += np.outer(ramp, direction)
    found = raised(diagnose(paper_arm, paper_gains, measured))
    assert {sensor for _, sensor in found} == {index}
    assert onset < found[0][0] < onset + 10.0


def test_given_healthy_arms_when_run_for_minutes_then_no_alarm_is_raised(
    paper_arm, paper_gains, two_faults
):
    """The short form of two hours of `benchmarks/diagnosis_campaign.py`."""
    for seed in range(6):
        factors = tuple(
            1.0 + paper_arm.model_error * np.random.default_rng(seed).choice([-1.0, 1.0], 4)
        )
        scenario = replace(
            two_faults, faults=(), seed=seed, mass_factors=factors[:2], inertia_factors=factors[2:]
        )
        run = run_closed_loop(paper_arm, paper_gains, scenario)
        assert run.alarms == [] and run.trustworthy.all()


def test_given_steps_beyond_threshold_and_bound_when_random_then_all_are_found_on_their_sensor(
    paper_arm, paper_gains, two_faults
):
    """The short form of 1000 steps of `benchmarks/diagnosis_campaign.py`."""
    rng = np.random.default_rng(5)
    for seed in range(12):
        index, onset = int(rng.integers(2)), float(rng.uniform(2.0, 15.0))
        healthy = replace(two_faults, faults=(), seed=seed)
        threshold = run_closed_loop(paper_arm, paper_gains, healthy).threshold[round(onset / DT)]
        size = float(2.0 * threshold[index] * rng.uniform(1.0, 1.2) * rng.choice([-1.0, 1.0]))
        fault = Fault(paper_arm.sensor_names[index], 'bias', onset, 2.0, size)
        run = run_closed_loop(paper_arm, paper_gains, replace(healthy, faults=(fault,)))
        first = next(a for a in run.alarms if a.event is AlarmEvent.RAISED)
        assert first.sensor_index == index and 0.0 <= first.detected / 1e9 - onset < 0.1
