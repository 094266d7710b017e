"""Paths and scenario files of serial arms; bad values of files are in `test_config`."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from nested import changed
from places import BRINGUP
from serial_arms import shoulder_arm

from lpv.core.control.serial_path import PoseWaypoints, SerialPath
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import JointLimits
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.scenario import load_scenario, parse_scenario
from lpv.core.support.errors import ConfigError, UnreachableError

TIMES = (0.5, 2.5, 5.0)
JOINTS = ((0.0, 0.5, -1.0), (0.6, 0.9, -1.4), (-0.3, 0.4, -0.9))
REACHED = ((0.5, 0.0, 0.2), (0.4, 0.3, 0.4), (0.5, -0.2, 0.3))
START = (0.0, 0.6, -1.2)


@pytest.fixture(scope='module')
def arm():
    return shoulder_arm('independent')


@pytest.fixture(scope='module')
def path(arm):
    return SerialPath(arm, TIMES, JOINTS)


def test_given_waypoints_when_sampled_then_the_path_meets_them_and_rests_at_the_ends(path):
    np.testing.assert_allclose(path.sample(TIMES).position, JOINTS, atol=1e-12)
    for time in (0.0, 0.5, 5.0, 9.0):
        motion = path.sample(time)
        assert np.abs([motion.velocity, motion.acceleration]).max() < 1e-9


def test_given_a_path_when_differentiated_then_rates_and_accelerations_fit(path):
    times = np.linspace(0.6, 4.9, 50)
    before, here, after = (path.sample(times + step) for step in (-1e-5, 0.0, 1e-5))
    assert np.abs((after.position - before.position) / 2e-5 - here.velocity).max() < 1e-6
    assert np.abs((after.velocity - before.velocity) / 2e-5 - here.acceleration).max() < 1e-5


def test_given_poses_when_followed_then_the_tip_is_on_the_spline_through_them(arm):
    path = SerialPath.through_poses(arm, TIMES, PoseWaypoints(REACHED, START))
    np.testing.assert_allclose(path.sample(TIMES).tip, REACHED, atol=1e-5)
    assert np.abs(np.diff(path.sample(np.linspace(0.0, 5.0, 500)).position, axis=0)).max() < 0.05


@pytest.mark.parametrize(
    ('points', 'reason'),
    [
        (((1.5, 0.0, 0.2), (1.4, 0.0, 0.2)), 'out of reach'),
        (((0.5, 0.0, 0.2), (0.799, 0.0, 0.2)), 'singularity'),
        (((0.5, 0.0, 0.4), (0.001, 0.0, 0.7)), 'singularity|out of reach'),
    ],
)
def test_given_poses_that_cannot_be_when_followed_then_the_error_says_when_and_why(
    arm, points, reason
):
    with pytest.raises(UnreachableError, match=rf'at \d+\.\d\d s .*({reason})'):
        SerialPath.through_poses(arm, (0.0, 3.0), PoseWaypoints(points, START))


FITTING = TIMES, JOINTS, JointLimits(-2.5, 2.5, 2.5, 60.0)
"""Times, joint positions, limits of joint 1."""
REFUSED = {
    'takes joint1 to .* whose limit': (*FITTING[:2], JointLimits(-0.2, 0.5, 2.5, 60.0)),
    'rad/s of joint1, whose limit is 0.2': (*FITTING[:2], JointLimits(-2.5, 2.5, 0.2, 60.0)),
    'N m of joint1, whose limit is 0.1': (*FITTING[:2], JointLimits(-2.5, 2.5, 2.5, 0.1)),
    'path.waypoints: .*must increase': ((0.0, 0.0), JOINTS[:2], FITTING[2]),
    'path.waypoints: .*two or more': ((0.0,), JOINTS[:1], FITTING[2]),
    'path.waypoints: .*3 joint positions': ((0.0, 1.0), ((0.0, 0.0), (0.1, 0.1)), FITTING[2]),
    'path.waypoints: .*finite': ((0.0, 1.0), ((0.0, 0.0, np.nan), JOINTS[0]), FITTING[2]),
}


@pytest.mark.parametrize('reason', REFUSED)
def test_given_what_makes_no_path_or_exceeds_a_limit_when_made_then_joint_or_field_is_named(
    arm, reason
):
    times, joints, limits = REFUSED[reason]
    narrow = replace(arm, joints=(replace(arm.joints[0], limits=limits), *arm.joints[1:]))
    with pytest.raises(ConfigError, match=reason):
        SerialPath(narrow, times, joints)


# ------------------------------------------------------------------ scenario files

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


def test_given_errors_when_the_true_arm_is_drawn_then_by_the_seed_and_within_them(arm):
    scenario = parse_scenario(DATA)
    true, nominal = scenario.true_chain(arm), compile_chain(arm)
    factor = true.inertial[:2, 0] / nominal.inertial[:2, 0]
    assert np.all(np.abs(factor - 1.0) <= 0.05) and np.ptp(factor) > 0.0
    np.testing.assert_array_equal(true.inertial, scenario.true_chain(arm).inertial)
    np.testing.assert_allclose(true.friction[:, 1], 1.2 * nominal.friction[:, 1])


def test_given_poses_when_read_then_position_orientation_and_posture_are_kept():
    scenario = parse_scenario({**DATA, 'path': POSES})
    assert isinstance(scenario.waypoints, PoseWaypoints)
    assert scenario.waypoints.start == START
    assert scenario.waypoints.orientations[1] == (0.0, 0.0, 0.1)
    with pytest.raises(ConfigError, match='path.start'):
        parse_scenario({**DATA, 'path': {**POSES, 'start': 'anywhere'}})
    with pytest.raises(ConfigError, match=r'waypoints\[0\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[0]', {'t': 0.0}))


def test_given_a_scenario_of_another_arm_when_used_then_the_field_is_named(arm):
    with pytest.raises(ConfigError, match=r'path.waypoints\[1\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[1].joints', [0.0, 0.1])).path(arm)
    with pytest.raises(ConfigError, match='plant.mass_factors: must have 3 numbers'):
        parse_scenario(changed(DATA, 'plant', {'mass_factors': [1.0, 1.1]})).true_arm(arm)
    for plant in ('lpv', 'nonlinear_without_coriolis'):
        with pytest.raises(ConfigError, match='planar arms of two links: it has 3 joints'):
            ArmSimulator(arm, parse_scenario({**DATA, 'plant': plant}))
