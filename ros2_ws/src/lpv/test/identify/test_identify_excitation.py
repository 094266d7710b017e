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


def test_given_limits_when_planned_then_the_motion_keeps_them_and_begins_and_ends_at_rest(
    arm, plan
):
    position, rate, acceleration = plan.trajectory.sample(np.linspace(0.0, 12.0, 1201))
    for j, joint in enumerate(arm.joints):
        assert joint.limits.lower < position[:, j].min() < position[:, j].max() < joint.limits.upper
        assert np.abs(rate[:, j]).max() < joint.limits.velocity
    assert np.all(plan.torque < [joint.limits.torque for joint in arm.joints])
    assert np.abs([rate[[0, -1]], acceleration[[0, -1]]]).max() < 1e-9
    # More trials inform more.
    assert plan.information > plan_excitation(arm, 12.0, trials=1).information


def test_given_a_floor_when_planned_then_the_tip_stays_above_or_it_is_said_that_none_does(arm):
    center, chain = np.array([0.0, -0.6, 0.3]), compile_chain(arm)
    plan = plan_excitation(arm, 12.0, Bounds(lowest=0.05), center=center, trials=20)
    for q in plan.trajectory.sample(np.arange(0.0, 12.0, 0.05))[0]:
        assert forward_kinematics(chain, q)[1][2] > 0.049
    with pytest.raises(IdentificationError, match='no motion keeps'):
        plan_excitation(arm, 12.0, Bounds(lowest=5.0), trials=3)


def test_given_a_motion_when_written_then_bag_files_and_a_spline_of_the_scenario_hold_it(
    arm, plan, tmp_path
):
    table, message, bag, scenario = write_reference(arm, plan.trajectory, 50.0, tmp_path / 'out')
    points = yaml.safe_load(message.read_text())['points']
    assert points[0]['positions'] == pytest.approx(plan.trajectory.center)
    read = read_recording(bag, arm.joint_names)
    assert read.position == pytest.approx(plan.trajectory.sample(read.time)[0], abs=1e-6)
    assert np.loadtxt(table, delimiter=',', skiprows=1).shape[0] == len(read.time)
    data = yaml.safe_load(scenario.read_text())
    assert data['duration'] == 12.0
    time, joints = zip(*((p['t'], p['joints']) for p in data['path']['waypoints']))
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    spline = make_interp_spline(time, joints, k=5, bc_type=(rest, rest))
    between = np.arange(0.03, 12.0, 0.07)
    position, rate, _ = plan.trajectory.sample(between)
    assert spline(between) == pytest.approx(position, abs=1e-3)
    assert spline.derivative()(between) == pytest.approx(rate, abs=2e-2)
