"""Motions that identify."""

import numpy as np
import pytest
import yaml
from scipy.interpolate import make_interp_spline

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv.identify.errors import IdentificationError
from lpv.identify.motions.excitation import Bounds, plan_excitation
from lpv.identify.motions.reference import write_reference
from lpv.identify.recordings.recording import read_recording


@pytest.fixture(scope='module')
def plan(arm):
    return plan_excitation(arm, 12.0, trials=40)


def test_given_limits_when_planned_then_the_motion_keeps_them(arm, plan):
    position, rate, _ = plan.trajectory.sample(np.arange(0.0, 12.0, 0.01))
    for j, joint in enumerate(arm.joints):
        assert joint.limits.lower < position[:, j].min() < position[:, j].max() < joint.limits.upper
        assert np.abs(rate[:, j]).max() < joint.limits.velocity
    assert np.all(plan.torque < [joint.limits.torque for joint in arm.joints])


def test_given_a_plan_when_it_starts_and_ends_then_the_arm_rests(plan):
    _, rate, acceleration = plan.trajectory.sample(np.array([0.0, 12.0]))
    assert np.abs(rate).max() < 1e-9
    assert np.abs(acceleration).max() < 1e-9


def test_given_more_trials_when_planned_then_the_motion_informs_more(arm, plan):
    assert plan.information > plan_excitation(arm, 12.0, trials=1).information


def test_given_a_floor_when_planned_then_the_tip_stays_above(arm):
    plan = plan_excitation(
        arm, 12.0, Bounds(lowest=0.05), center=np.array([0.0, -0.6, 0.3]), trials=20
    )
    chain = compile_chain(arm)
    for q in plan.trajectory.sample(np.arange(0.0, 12.0, 0.05))[0]:
        assert forward_kinematics(chain, q)[1][2] > 0.049


def test_given_limits_that_no_motion_keeps_when_planned_then_it_is_said(arm):
    with pytest.raises(IdentificationError, match='no motion keeps'):
        plan_excitation(arm, 12.0, Bounds(lowest=5.0), trials=3)


def test_given_a_motion_when_written_then_files_and_bag_hold_it(arm, plan, tmp_path):
    table, message, bag, _ = write_reference(arm, plan.trajectory, 50.0, tmp_path / 'out')
    points = yaml.safe_load(message.read_text())['points']
    assert points[0]['positions'] == pytest.approx(plan.trajectory.center)
    read = read_recording(bag, arm.joint_names)
    assert read.position == pytest.approx(plan.trajectory.sample(read.time)[0], abs=1e-6)
    assert np.loadtxt(table, delimiter=',', skiprows=1).shape[0] == len(read.time)


def test_given_a_motion_when_written_as_a_scenario_then_a_quintic_spline_repeats_it(
    arm, plan, tmp_path
):
    *_, scenario = write_reference(arm, plan.trajectory, 50.0, tmp_path / 'out')
    data = yaml.safe_load(scenario.read_text())
    assert data['duration'] == 12.0
    time, joints = zip(*((p['t'], p['joints']) for p in data['path']['waypoints']))
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    spline = make_interp_spline(time, joints, k=5, bc_type=(rest, rest))
    between = np.arange(0.03, 12.0, 0.07)
    position, rate, _ = plan.trajectory.sample(between)
    assert spline(between) == pytest.approx(position, abs=1e-3)
    assert spline.derivative()(between) == pytest.approx(rate, abs=2e-2)
