import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from fault_injection import with_sensors
from planar_formulas import inverse_dynamics

from lpv import ConfigError, load_arm
from lpv.core.simulation import arm_simulator, scenario
from lpv.core.simulation.faults import Fault, FaultInjector
from lpv.core.support.resources import bringup_file

pytestmark = pytest.mark.slow
QUIET = {'noise': False, 'disturbance': False}
TIMES = np.arange(0.0, 5.0, 0.5)


@pytest.fixture
def simulate(paper_arm, two_faults):
    """A simulator of the paper's arm, without faults if not said otherwise."""
    make = partial(arm_simulator.ArmSimulator, paper_arm)
    return lambda *faults, **changes: make(replace(two_faults, faults=faults, **changes))


def test_given_torques_then_effort_tells_them(paper_arm, two_faults, simulate, joints, paper_model):
    plant = simulate(**QUIET)
    sensed = plant.sense()
    start = two_faults.path(paper_arm).sample(0.0).position
    for name in ('position', 'measured_position'):
        np.testing.assert_allclose(sensed[name], start, atol=1e-15)
    np.testing.assert_array_equal(sensed['velocity'], 0.0)
    assert plant.time == 0.0
    plant.step((1e6, -1e6))
    np.testing.assert_array_equal(plant.sense()['effort'], [1500.0, -600.0])
    for torque in ((math.nan, 0.0), (0.0, math.inf), (1.0,), (1.0, 2.0, 3.0)):
        pytest.raises(ValueError, plant.step, torque).match('2 finite numbers')
    assert plant.step_count == 1
    plant.state.motion[1] = 1e200  # as of joints much too light for the steps
    with pytest.raises(ConfigError, match='fastest of which is at .* give rotor inertias'):
        plant.step((0.0, 0.0))
    plant = simulate(noise=False)
    before = plant.sense()
    for _ in range(10):
        plant.hold()
    after = plant.sense()
    np.testing.assert_array_equal(after['position'], before['position'])
    assert plant.step_count == 10
    theta = joints.absolute_position(after['position'])
    carried = inverse_dynamics(theta, (0.0, 0.0), (0.0, 0.0), paper_model.constants())
    np.testing.assert_allclose(joints.absolute_torque(after['effort']), carried, rtol=1e-12)


def test_given_a_fault_when_injected_then_noise_and_disturbance_stay_the_same(simulate, joints):
    noise = Fault('link1_angle', 'noise', 0.0, size=0.5)
    plants = simulate(), simulate(noise, Fault('link2_angle', 'bias', 0.0, size=0.2))
    last = np.inf
    for _ in range(20):
        plain, faulty = (p.sense() for p in plants)
        for name in ('position', 'measured_velocity'):
            np.testing.assert_array_equal(plain[name], faulty[name])
        reading = plain['measured_position']
        shift = joints.absolute_velocity(faulty['measured_position'] - reading)
        np.testing.assert_allclose(shift, faulty['fault'], atol=1e-12)
        # A reading is one until the next step.
        np.testing.assert_array_equal(plants[0].sense()['measured_position'], reading)
        assert np.abs(reading - last).max() > 1e-5
        last = reading
        for plant in plants:
            plant.step((1.0, 2.0))


def test_given_noise_when_sampled_then_moments_are_right_and_faults_independent(simulate, joints):
    plant, rows = simulate(Fault('link1_angle', 'noise', 0.0, size=0.1)), []
    for _ in range(4000):
        now = plant.sense()
        own, rates = (
            joints.absolute_velocity(now[f'measured_{name}'] - now[name])
            for name in ('position', 'velocity')
        )
        plant.step((0.0, 0.0))
        push = plant.sense()['disturbance'].item()
        rows.append([now['fault'][0], *(own - now['fault']), *rates, push])
    fault, *noise, push = np.array(rows).T
    np.testing.assert_allclose(np.std(noise, axis=1), [1e-3, 1e-3, 1e-2, 1e-2], rtol=0.06)
    assert push.mean() == pytest.approx(0.2, abs=0.06)
    assert push.var() == pytest.approx(0.9, rel=0.1)
    assert np.abs(np.corrcoef([fault, *noise[:2]]) - np.eye(3)).max() < 0.06  # 3.8 deviations
    # Nor may both draw the same numbers at different times.
    drawn = np.round(fault / 0.1, 9), np.round(np.array(noise[:2]) / 1e-3, 9)
    assert np.intersect1d(*drawn).size == 0


def test_given_derived_rates_then_the_first_reading_has_none_from_zero_and_they_jump_with_theirs():
    arm, path = load_arm(bringup_file('arms', 'panda')), bringup_file('scenarios', 'panda')
    jump = Fault(arm.sensor_names[1], 'bias', 1.5 * arm.sample_time, size=0.1)
    faulty = replace(scenario.load_scenario(path), faults=(jump,))
    plant = arm_simulator.ArmSimulator(with_sensors(arm, rates='derived'), faulty)
    plant.hold()  # as in real time, where the first sample is published after a step
    assert np.abs(plant.sense()['measured_velocity']).max() < 0.1
    plant.hold()
    before, after = plant.signals['measured_position'].copy(), plant.sense()
    steps = (after['measured_position'] - before) / arm.sample_time
    assert steps[1] * arm.sample_time == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(after['measured_velocity'], steps, atol=1e-9)


@pytest.mark.parametrize('changes', [{}, {'payload': 0.25, 'mass_factors': (1.03, 0.97)}])
def test_given_mujoco_when_run_then_signals_are_ours(run_paper, changes):
    pytest.importorskip('mujoco')
    plants = ('nonlinear', 'mujoco')
    one, other = (run_paper(duration=1.5, plant=plant, **changes) for plant in plants)
    for name in ('position', 'velocity', 'measured', 'fault_estimate'):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=1e-6)


def apart(plants, count, torque=(0.0, 0.0)):
    """How far the true positions of two plants are from each other after some steps [rad]."""
    for plant in plants:
        for _ in range(count):
            plant.step(torque)
    one, other = (plant.sense()['position'] for plant in plants)
    return np.abs(one - other).max()


def test_given_no_coriolis_terms_when_the_arm_is_slow_or_loaded_then_the_plant_says_so(simulate):
    papers = {'plant': 'nonlinear_without_coriolis', **QUIET}
    plants = [simulate(**QUIET), simulate(**papers)]
    assert apart(plants, 20, (5.0, 2.0)) < 1e-3
    assert apart(plants, 300) > 1e-2
    # It carries a payload, too.
    assert apart([simulate(payload=load, **papers) for load in (0.0, 2.0)], 100) > 1e-3


def test_given_a_disturbance_then_it_is_that_of_eq_31(paper_arm, two_faults, paper_model):
    direction, mean, deviation = scenario.disturbance_of(paper_arm, two_faults)
    assert (mean, deviation) == (0.2, pytest.approx(0.9**0.5))
    to_absolute = np.array([[1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(to_absolute @ direction, paper_model.disturbance_direction)
    assert scenario.disturbance_of(paper_arm, replace(two_faults, disturbance=False))[2] == 0.0
    assert scenario.disturbance_of(replace(paper_arm, lpv=None), two_faults)[2] == 0.0


def apply_at(times, *faults, reading=lambda t: (t, -t)):
    injector = FaultInjector(('a', 'b'), faults, np.random.default_rng(5))
    return np.array([injector.apply(t, np.array(reading(t), float), 0.1) for t in times])


@pytest.mark.parametrize(('kind', 'fields', 'expected'), [
    ('bias', {'size': -0.3}, -0.3 + 0 * TIMES),
    ('drift', {'rate': 0.4}, 0.4 * (TIMES - 1.0)),
    ('drift', {'rate': 0.4, 'size': 0.5}, np.minimum(0.4 * (TIMES - 1.0), 0.5)),
    ('drift', {'rate': -0.4, 'size': 0.5}, np.maximum(-0.4 * (TIMES - 1.0), -0.5)),
    ('scale', {'size': 0.1}, -0.1 * TIMES),
    ('stuck', {}, TIMES - 1.0),
    ('dropout', {}, np.full_like(TIMES, np.nan)),
])  # fmt: skip
def test_given_each_kind_of_fault_when_applied_then_it_is_what_it_is_called(kind, fields, expected):
    found = apply_at(TIMES, Fault('b', kind, 1.0, 2.0, **fields)) - np.array([TIMES, -TIMES]).T
    on = (TIMES >= 1.0) & (TIMES < 3.0)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 1], np.where(on, expected, 0.0), atol=1e-14)


def test_given_faults_when_applied_then_moments_are_right_they_add_up_and_are_cleared():
    faults = Fault('a', 'noise', 0.0, size=0.2), Fault('b', 'spike', 0.0, size=0.7, rate=1)
    noise, spikes = apply_at(np.arange(4000) * 0.1, *faults, reading=lambda t: (0, 0)).T
    assert noise.std() == pytest.approx(0.2, rel=0.05)
    assert set(np.unique(spikes)) == {-0.7, 0.0, 0.7}
    assert np.mean(spikes != 0) == pytest.approx(0.1, rel=0.2)
    found = apply_at([2.0], Fault('a', 'bias', 0.0, size=0.1), Fault('a', 'bias', 1.0, size=0.2))
    np.testing.assert_allclose(found, [[2.3, -2.0]])
    times = (0.5, 1.0, 1.5, 2.5, 1.2)
    found = apply_at(times, Fault('a', 'stuck', 1.0, 1.0), reading=lambda t: (10 * t, 0))
    assert found[:, 0].tolist() == [5.0, 10.0, 10.0, 25.0, 12.0]
    faults = Fault('a', 'bias', 0.0, size=1.0), Fault('b', 'stuck', 0.0)
    injector = FaultInjector(('a', 'b'), faults, np.random.default_rng(5))
    pytest.raises(ConfigError, injector.clear, 'c').match(r'fault\.sensor')
    injector.apply(0.0, np.zeros(2), 0.1)
    assert injector.clear('a') == 1
    np.testing.assert_array_equal(injector.apply(1.0, np.array([5.0, 5.0]), 0.1), [5.0, 0.0])
    assert injector.clear() == 1
    np.testing.assert_array_equal(injector.apply(2.0, np.array([5.0, 5.0]), 0.1), [5.0, 5.0])
