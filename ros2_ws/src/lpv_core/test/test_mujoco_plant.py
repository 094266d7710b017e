"""Diagnosis and tracking on the MuJoCo plant: the figures of the built-in simulator hold there."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.joints import JointMap
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.metrics import mise
from lpv_core.simulation.scenario import parse_scenario
from lpv_core.support.errors import ConfigError

pytestmark = pytest.mark.slow

pytest.importorskip('mujoco', reason='MuJoCo is not installed')

SWING = {
    'name': 'swing',
    'duration': 5.0,
    'disturbance': False,
    'path': {
        'waypoints': [
            {'t': 0.2, 'x': -0.2, 'y': -0.42},
            {'t': 2.5, 'x': 0.2, 'y': -0.42},
            {'t': 4.8, 'x': -0.2, 'y': -0.42},
        ]
    },
}


def swing(plant, faults=()):
    return parse_scenario({**SWING, 'plant': plant, 'faults': list(faults)})


def test_given_the_shipped_scenario_when_run_on_mujoco_then_the_figures_hold(
    paper_arm, paper_gains, two_faults
):
    run = run_closed_loop(paper_arm, paper_gains, replace(two_faults, plant='mujoco'))
    to_absolute = JointMap(paper_arm).absolute_position
    rate_error = JointMap(paper_arm).absolute_velocity(run.velocity - run.estimated_velocity)
    # A fifth of the paper's Table 2 for angles and faults; its rates and tracking.
    assert np.all(
        mise(to_absolute(run.position) - to_absolute(run.estimate))
        <= np.array([0.006, 0.002]) / 5.0
    )
    assert np.all(mise(run.fault - run.fault_estimate) <= np.array([0.006, 0.002]) / 5.0)
    assert np.all(mise(rate_error) <= 1e-3)
    assert np.all(mise(to_absolute(run.position) - to_absolute(run.reference)) <= [0.003, 0.007])
    raised = [a for a in run.alarms if a.event == AlarmEvent.RAISED]
    assert [a.sensor for a in raised] == [f.sensor for f in two_faults.faults]
    assert raised[0].detected <= 6_012_000_000
    assert raised[0].size == pytest.approx(0.3, abs=0.05)
    assert 9.0 < raised[1].detected / 1e9 < 11.5


def test_given_noise_and_model_error_when_run_on_both_plants_then_they_give_the_same_signals(
    paper_arm, paper_gains, two_faults
):
    arm = replace(paper_arm, payload=0.25)
    gains = replace(paper_gains, arm_sha256=arm.sha256())
    scenario = replace(
        two_faults,
        duration=1.5,
        payload=0.25,
        mass_factors=(1.03, 0.97),
        inertia_factors=(0.97, 1.03),
    )
    runs = [
        run_closed_loop(arm, gains, replace(scenario, plant=plant))
        for plant in ('nonlinear', 'mujoco')
    ]
    for name in ('position', 'velocity', 'measured', 'fault_estimate'):
        np.testing.assert_allclose(
            getattr(runs[1], name), getattr(runs[0], name), atol=1e-6, err_msg=name
        )


@pytest.mark.parametrize(
    'plant',
    [
        {'model': 'mujoco'},
        {
            'model': 'mujoco',
            'coulomb': 'dry',
            'friction_factor': 1.2,
            'mass_factors': 1.03,
            'inertia_factors': 1.03,
        },
    ],
)
def test_given_the_real_arm_in_mujoco_when_healthy_no_alarm_when_faulty_the_right_sensor(
    real_arm, real_gains, plant
):
    assert run_closed_loop(real_arm, real_gains, swing(plant)).alarms == []
    fault = {'sensor': 'joint1_encoder', 'kind': 'bias', 'onset': 2.0, 'size': 0.3}
    run = run_closed_loop(real_arm, real_gains, swing(plant, [fault]))
    raised = [a for a in run.alarms if a.event == AlarmEvent.RAISED]
    assert [a.sensor for a in raised] == ['joint1_encoder']
    assert raised[0].detected <= 2_020_000_000
    assert raised[0].size == pytest.approx(0.3, abs=0.05)
    assert np.all(mise(run.position - run.reference) < 1e-3)


def test_given_a_payload_when_the_drives_brake_then_the_effort_holds_it(real_arm):
    heavy = swing({'model': 'mujoco', 'payload': 0.2})
    light = swing('mujoco')
    efforts = []
    for scenario in (light, heavy):
        plant = ArmSimulator(real_arm, scenario)
        before = plant.sense()[1].position
        plant.hold()
        measurement, truth = plant.sense()
        np.testing.assert_array_equal(truth.position, before)
        efforts.append(np.abs(measurement.effort))
    assert np.all(efforts[1] > 1.15 * efforts[0])


def test_given_a_name_instead_of_a_mapping_when_read_then_it_is_the_model():
    assert swing('mujoco') == swing({'model': 'mujoco'})
    assert swing('mujoco').coulomb == 'smooth'


@pytest.mark.parametrize(
    ('plant', 'named'),
    [
        ('gazebo', 'plant.model'),
        ({'model': 'nonlinear', 'coulomb': 'dry'}, 'plant.coulomb'),
        ({'model': 'mujoco', 'coulomb': 'sticky'}, 'plant.coulomb'),
        (3, 'plant'),
    ],
)
def test_given_a_plant_that_makes_no_sense_when_read_then_the_field_is_named(plant, named):
    with pytest.raises(ConfigError) as caught:
        swing(plant)
    assert caught.value.field == named
