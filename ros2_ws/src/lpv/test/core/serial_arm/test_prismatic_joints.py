"""Arms with prismatic joints: files, kinematics, diagnosis in the loop."""

from dataclasses import replace

import numpy as np
import pytest
from prismatic_arms import middle, mixed_arm, scara, ur10_on_rail

from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.certificate.model_bounds import chain_numbers
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.errors import ConfigError


def arms(*values):
    return pytest.mark.parametrize('arm', values, ids=lambda arm: arm.name)


ARMS = arms(scara(), ur10_on_rail(), mixed_arm())


@ARMS
def test_given_an_arm_file_when_written_and_read_then_it_is_the_same(arm, tmp_path):
    save_arm(arm, tmp_path / 'arm.yaml')
    again = load_arm(tmp_path / 'arm.yaml')
    assert again == arm and again.sha256() == arm.sha256()
    data = to_mapping(arm)
    data['joints'][0]['type'] = 'helical'
    with pytest.raises(ConfigError, match='revolute, prismatic'):
        parse_arm(data)


def test_given_a_prismatic_joint_then_its_whole_range_counts_as_a_turn_and_1_m_at_most():
    scales = dict(zip(scara().joint_names, scara().scales()))
    assert scales['turn_1'] == 1.0 and scales['lift'] == pytest.approx(0.2 / (2 * np.pi))
    rail = ur10_on_rail().joints[0]
    for end, scale, span in ((20.0, 1.0, (-20.0, 20.0)), (np.inf, None, (-0.5, 0.5))):
        joint = replace(rail, limits=replace(rail.limits, lower=-end, upper=end))
        assert joint.range == span and scale in (joint.scale, None)


def test_given_a_prismatic_joint_when_a_certificate_is_asked_for_then_it_is_refused_by_name():
    with pytest.raises(ConfigError, match='rail is prismatic'):
        chain_numbers(ur10_on_rail())


def scenario(arm, *faults, duration):
    rng = np.random.default_rng(3)
    reach = np.array([0.12 * (joint.range[1] - joint.range[0]) for joint in arm.joints])
    rows = middle(arm) + reach * np.vstack([0.0 * reach, rng.uniform(-1.0, 1.0, (4, len(reach)))])
    if arm.name == 'ur10_on_rail':
        rows[:, 2:4] += [-1.0, 1.0]
    return Scenario(
        name='slides', duration=duration, seed=2, plant='nonlinear', parameter_error=0.03,
        payload=0.2, friction_factor=1.1, noise=True, noise_factor=1.0,
        times=(0.3, 2.5, 5.0, 7.5, 9.8), waypoints=tuple(map(tuple, rows)), faults=faults,
    )  # fmt: skip


@pytest.mark.slow
@arms(scara(), ur10_on_rail(), mixed_arm(joints=3))
def test_given_an_arm_with_slides_when_nothing_fails_then_it_follows_and_nothing_is_said(arm):
    run = run_closed_loop(arm, scenario(arm, duration=6.0))
    assert run.alarms == [] and not run.stop_reason.any() and not run.brake_reason.any()
    assert np.abs(run.position - run.reference).max() < 0.03


DRIFT = 'moves the estimate of the next joint instead'


@pytest.mark.slow
@pytest.mark.parametrize(
    'fault',
    [
        Fault('rail_encoder', 'bias', 3.0, size=0.03),
        pytest.param(
            Fault('rail_encoder', 'drift', 3.0, rate=0.05),
            marks=pytest.mark.xfail(reason=DRIFT, strict=True),
        ),
        Fault('shoulder_lift_encoder', 'bias', 3.0, size=0.1),
    ],
    ids=lambda f: f'{f.sensor}-{f.kind}',
)
def test_given_an_arm_on_a_rail_when_an_encoder_fails_then_its_fault_is_named(fault):
    arm = ur10_on_rail()
    run = run_closed_loop(arm, scenario(arm, fault, duration=10.0))
    first = run.alarms[0]
    assert (first.sensor, first.kind) == (fault.sensor, fault.kind)
    assert first.unit == ('m' if 'rail' in fault.sensor else 'rad')
    assert {alarm.sensor for alarm in run.alarms} == {fault.sensor}
