"""Scenario files of serial arms, and the shipped ones; bad values are in `test_config`."""

import numpy as np
import pytest
import yaml
from nested import changed
from places import BRINGUP
from serial_arms import shoulder_arm

from lpv.core.control.serial_path import PoseWaypoints
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.scenario import load_scenario, parse_scenario
from lpv.core.support.errors import ConfigError

DATA = yaml.safe_load("""
kind: serial_arm
name: test
duration: 5.0
plant: {parameter_error: 0.05, payload: 0.4, friction_factor: 1.2}
path: {waypoints: [{t: 0.5, joints: [0.0, 0.5, -1.0]}, {t: 4.0, joints: [0.6, 0.9, -1.4]}]}
faults: [{sensor: encoder2, kind: bias, onset: 1.0, size: 0.1}]
""")
POSES = yaml.safe_load("""
start: [0.0, 0.6, -1.2]
waypoints:
  - {t: 0.5, position: [0.5, 0.0, 0.2], rpy: [0.0, 0.0, 0.0]}
  - {t: 4.0, position: [0.4, 0.3, 0.4], rpy: [0.0, 0.0, 0.1]}
""")


@pytest.mark.parametrize('name', ['ur10', 'panda'])
def test_given_a_shipped_arm_when_its_scenario_is_read_then_the_arm_can_do_it(name):
    arm = load_arm(BRINGUP / 'arms' / f'{name}.yaml')
    scenario = load_scenario(BRINGUP / 'scenarios' / f'{name}.yaml')
    assert scenario.path(arm).end <= scenario.duration
    assert {fault.kind for fault in scenario.faults} == {'bias', 'drift'}
    ArmSimulator(arm, scenario)


def test_given_errors_when_the_true_arm_is_drawn_then_by_the_seed_and_within_them():
    arm, scenario = shoulder_arm(), parse_scenario(DATA)
    true, nominal = scenario.true_chain(arm), compile_chain(arm)
    factor = true.inertial[:2, 0] / nominal.inertial[:2, 0]
    assert np.all(np.abs(factor - 1.0) <= 0.05) and np.ptp(factor) > 0.0
    np.testing.assert_array_equal(true.inertial, scenario.true_chain(arm).inertial)
    np.testing.assert_allclose(true.friction[:, 1], 1.2 * nominal.friction[:, 1])


def test_given_poses_when_read_then_position_orientation_and_posture_are_kept():
    scenario = parse_scenario({**DATA, 'path': POSES})
    assert isinstance(scenario.waypoints, PoseWaypoints)
    assert scenario.waypoints.start == (0.0, 0.6, -1.2)
    assert scenario.waypoints.orientations[1] == (0.0, 0.0, 0.1)
    with pytest.raises(ConfigError, match='path.start'):
        parse_scenario({**DATA, 'path': {**POSES, 'start': 'anywhere'}})
    with pytest.raises(ConfigError, match=r'waypoints\[0\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[0]', {'t': 0.0}))


def test_given_a_scenario_of_another_arm_when_used_then_the_field_is_named():
    arm = shoulder_arm()
    with pytest.raises(ConfigError, match=r'path.waypoints\[1\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[1].joints', [0.0, 0.1])).path(arm)
    with pytest.raises(ConfigError, match='plant.mass_factors: must have 3 numbers'):
        parse_scenario(changed(DATA, 'plant', {'mass_factors': [1.0, 1.1]})).true_arm(arm)
    for plant in ('lpv', 'nonlinear_without_coriolis'):
        with pytest.raises(ConfigError, match='planar arms of two links: it has 3 joints'):
            ArmSimulator(arm, parse_scenario({**DATA, 'plant': plant}))
