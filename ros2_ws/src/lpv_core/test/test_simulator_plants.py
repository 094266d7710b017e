"""Plants of the simulator beside the built-in one: MuJoCo's and the paper's."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.scenario import disturbance_of, parse_scenario
from lpv_core.support.errors import ConfigError
from lpv_core.uio.planar import planar_model

pytestmark = pytest.mark.slow


@pytest.mark.parametrize('changes', [{}, {'payload': 0.25, 'mass_factors': (1.03, 0.97)}])
def test_given_noise_disturbance_and_model_error_when_run_on_mujoco_then_signals_are_the_same(
    paper_arm, paper_gains, two_faults, changes
):
    pytest.importorskip('mujoco')
    scenario = replace(two_faults, duration=1.5, **changes)
    one, other = (
        run_closed_loop(paper_arm, replace(scenario, plant=plant), paper_gains)
        for plant in ('nonlinear', 'mujoco')
    )
    for name in ('position', 'velocity', 'measured', 'fault_estimate'):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=1e-6)


def test_given_the_real_arm_in_mujoco_when_a_step_comes_then_the_right_sensor_is_named(
    real_arm, real_gains
):
    pytest.importorskip('mujoco')
    points = [{'t': t, 'x': x, 'y': -0.42} for t, x in ((0.2, -0.2), (2.5, 0.2), (4.8, -0.2))]
    fault = {'sensor': real_arm.sensor_names[0], 'kind': 'bias', 'onset': 2.0, 'size': 0.3}
    data = {'name': 'swing', 'duration': 5.0, 'plant': 'mujoco', 'path': {'waypoints': points}}
    healthy = parse_scenario(data)
    assert healthy == parse_scenario({**data, 'plant': {'model': 'mujoco'}})
    assert run_closed_loop(real_arm, healthy, real_gains).alarms == []
    run = run_closed_loop(real_arm, parse_scenario({**data, 'faults': [fault]}), real_gains)
    first = run.alarms[0]
    assert (first.event, first.sensor) == (AlarmEvent.RAISED, real_arm.sensor_names[0])
    assert first.detected <= 2_020_000_000 and first.size == pytest.approx(0.3, abs=0.05)


def test_given_no_coriolis_terms_when_the_arm_is_slow_then_the_plant_is_almost_the_same(
    paper_arm, two_faults
):
    scenario = replace(two_faults, noise=False, disturbance=False, faults=())
    plants = [
        ArmSimulator(paper_arm, replace(scenario, plant=plant))
        for plant in ('nonlinear', 'nonlinear_without_coriolis')
    ]
    for _ in range(20):
        for plant in plants:
            plant.step((5.0, 2.0))
    slow = [plant.sense()[1] for plant in plants]
    np.testing.assert_allclose(slow[1].position, slow[0].position, atol=1e-3)
    for _ in range(300):
        for plant in plants:
            plant.step((0.0, 0.0))
    fast = [plant.sense()[1] for plant in plants]
    assert np.abs(fast[1].position - fast[0].position).max() > 1e-2


def test_given_a_disturbance_when_it_acts_on_the_joints_then_absolute_angles_get_eq_31(
    paper_arm, two_faults, paper_model
):
    direction, mean, deviation = disturbance_of(paper_arm, two_faults)
    assert (mean, deviation) == (0.2, pytest.approx(0.9**0.5))
    to_absolute = np.array([[1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(to_absolute @ direction, paper_model.disturbance_direction)
    assert disturbance_of(paper_arm, replace(two_faults, disturbance=False))[2] == 0.0
    assert disturbance_of(replace(paper_arm, lpv=None), two_faults)[2] == 0.0


def test_given_sensors_of_absolute_angles_when_one_fails_then_only_its_link_is_read_wrong(
    paper_arm, two_faults
):
    fault = replace(two_faults.faults[0], onset=0.0)
    simulator = ArmSimulator(paper_arm, replace(two_faults, noise=False, faults=(fault,)))
    measurement, truth = simulator.sense()
    np.testing.assert_allclose(truth.fault, [0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(measurement.position - truth.position, [0.3, -0.3], atol=1e-12)


@pytest.mark.parametrize('plant', ['gazebo', 3, {'model': 'nonlinear', 'coulomb': 'dry'}])
def test_given_a_plant_that_makes_no_sense_when_read_then_the_field_is_named(plant):
    points = [{'t': 0.0, 'x': 0.0, 'y': 1.5}, {'t': 1.0, 'x': 0.1, 'y': 1.5}]
    data = {'name': 'x', 'duration': 1.0, 'plant': plant, 'path': {'waypoints': points}}
    with pytest.raises(ConfigError) as caught:
        parse_scenario(data)
    assert caught.value.field.startswith('plant')


def test_given_a_payload_when_the_papers_plant_carries_it_then_it_weighs_on_both_links(
    paper_arm, two_faults
):
    heavy = replace(two_faults, payload=2.0, plant='nonlinear_without_coriolis', noise=False)
    light = replace(heavy, payload=0.0)
    places = []
    for scenario in (light, heavy):
        simulator = ArmSimulator(paper_arm, replace(scenario, disturbance=False, faults=()))
        for _ in range(100):
            simulator.step((0.0, 0.0))
        places.append(simulator.sense()[1].position)
    assert np.abs(places[1] - places[0]).max() > 1e-3
    assert planar_model(paper_arm).with_payload(2.0).links[1].mass == 7.0
