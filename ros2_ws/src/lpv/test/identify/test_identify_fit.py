"""Identification of arms whose parameters are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from simulated_recordings import is_physical

from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.core.serial_arm.description import JointFriction, JointLimits, LinkInertia, LpvRegion
from lpv.identify.estimation.assembly import parameter_map
from lpv.identify.estimation.gains import rescaled
from lpv.identify.estimation.identification import identify
from lpv.identify.estimation.payload import Payload, identify_payload, with_payload
from lpv.identify.estimation.torque_error import calibrate
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.motions.excitation import plan_excitation
from lpv.identify.recordings.filters import low_pass

pytestmark = pytest.mark.slow


def test_given_a_noisy_recording_when_identified_then_links_are_physical_and_predict_to_the_noise(
    arm, result, recording, tmp_path
):
    noise = 0.02 * np.max(np.abs(recording.effort), axis=0)
    assert np.all(result.figures.rms < 1.1 * noise)
    assert np.all(result.figures.rms_band < 0.4 * noise)
    assert np.all(result.prior_figures.rms > 3.0 * noise)
    assert result.weight.contains_weight and result.arm.effort_includes_gravity
    for joint in result.arm.joints:
        assert is_physical(joint.link) and joint.rotor_inertia >= 0.0
        assert joint.friction.coulomb == pytest.approx(1.5, rel=0.15)
        assert 20.0 < joint.friction.coulomb_slope < 80.0
    save_arm(result.arm, tmp_path / 'arm.yaml')
    loaded = load_arm(tmp_path / 'arm.yaml')
    assert loaded == result.arm and loaded.sha256() == result.arm.sha256()
    # Another motion is predicted from the file alone.
    q, v, a = 0.7 * np.random.default_rng(9).normal(size=(3, 200, 3))
    expected = joint_torques(arm, q, v, a)
    error = joint_torques(loaded, q, v, a) - expected
    assert np.all(np.std(error, axis=0) < 0.04 * np.std(expected, axis=0))


def test_given_links_and_friction_when_checked_then_those_that_cannot_be_are_told(arm):
    assert all(is_physical(joint.link) for joint in arm.joints)
    assert not is_physical(LinkInertia(1.0, (1.0, 0.0, 0.0)))
    assert JointFriction(viscous=-0.4, coulomb=1.0).is_dissipative(2.0)
    assert not JointFriction(viscous=-0.6, coulomb=1.0).is_dissipative(2.0)


def test_given_many_noises_when_fitted_then_intervals_hold_the_truth(arm, simulated):
    inside = []
    for seed in range(12):
        workshop = Workshop(arm, [simulated(arm, seed, rate=60.0)])
        fit = workshop.free_fit(1.0, None)
        truth = parameter_map(workshop.base, 3) @ arm.parameter_vector()
        used = np.diag(fit.covariance) > 0.0
        width = stats.t.ppf(0.975, fit.freedom) * np.sqrt(np.diag(fit.covariance)[used])
        inside.append(np.abs(fit.parameters - truth)[used] < width)
    assert 0.90 < np.mean(inside) < 0.99


def test_given_a_contact_when_fitted_then_parameters_hardly_move(arm, recording, result):
    effort = recording.effort.copy()
    effort[400:430] += 60.0
    touched = identify(arm, [replace(recording, effort=effort)])
    for before, after in zip(result.arm.joints, touched.arm.joints):
        assert after.friction.coulomb == pytest.approx(before.friction.coulomb, rel=0.1)
    assert np.all(touched.figures.rms < 1.1 * result.figures.rms)


def test_given_no_rates_when_identified_then_they_come_from_positions(arm, recording, result):
    blind = identify(arm, [replace(recording, velocity=None)])
    assert not blind.used_rates
    assert {joint.sensors.rates for joint in blind.arm.joints} == {'none'}
    assert np.all(blind.figures.rms < 1.1 * result.figures.rms)


def test_given_efforts_without_gravity_when_identified_then_it_is_found_unless_said_otherwise(
    arm, simulated
):
    floating = simulated(replace(arm, gravity=0.0), 2, rate=60.0)
    found, workshop = identify(arm, [floating]), Workshop(arm, [floating])
    assert np.all(found.figures.r2 > 0.98)
    assert workshop.check_weight(0.6, may_change=False).contains_weight is False
    assert not found.arm.effort_includes_gravity and workshop.arm.effort_includes_gravity
    for warnings in (found.warnings, workshop.warnings):
        assert any('not to contain the weight' in text for text in warnings)


def test_given_a_planar_arm_when_weighed_then_the_data_do_not_tell(arm, simulated):
    flat = replace(arm, gravity=1e-3)
    workshop = Workshop(flat, [simulated(flat, 2, rate=60.0)])
    assert workshop.check_weight(0.6, True).contains_weight is None


def test_given_currents_when_identified_then_gains_and_their_signs_are_found(arm, simulated):
    gains = (8.0, -5.0, 3.0)
    joints = tuple(replace(joint, torque_gain=gain) for joint, gain in zip(arm.joints, gains))
    recording = simulated(replace(arm, joints=joints), 3)
    found = identify(replace(arm, effort_unit='A'), [recording]).arm
    ratio = np.array([joint.torque_gain for joint in found.joints]) / gains
    assert ratio == pytest.approx(np.full(3, ratio.mean()), rel=0.1)
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)


def test_given_a_tool_when_its_payload_is_identified_then_mass_and_centre_fit(arm, simulated):
    tool = Payload(0.8, (0.25, 0.0, 0.05), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0)
    found = identify_payload(arm, [simulated(with_payload(arm, tool), 4)])
    assert found.mass == pytest.approx(0.8, abs=4 * found.mass_sigma)
    assert found.center[0] == pytest.approx(0.25, abs=0.02)
    assert found.rms_after < 0.5 * found.rms_before


def test_given_a_factor_when_an_arm_is_rescaled_then_torques_scale(arm):
    q, v, a = np.random.default_rng(5).normal(size=(3, 20, 3))
    expected = pytest.approx(1.3 * joint_torques(arm, q, v, a))
    assert joint_torques(rescaled(arm, 1.3), q, v, a) == expected


def test_given_filtered_efforts_when_identified_then_their_bandwidth_is_found(arm, simulated):
    raw = simulated(arm, 6, torque=1e-4)
    found = identify(arm, [replace(raw, effort=low_pass(raw.effort, 2.0, 0.01))])
    assert found.arm.effort_bandwidth == 2.0


def test_given_friction_that_grows_with_load_when_identified_then_it_is_chosen(arm, simulated):
    joints = tuple(
        replace(joint, friction=JointFriction(0.1, 0.5, 0.5, 60.0, load))
        for joint, load in zip(arm.joints, (0.0, 0.2, 0.0))
    )
    loaded = replace(arm, joints=joints)
    found = identify(arm, [simulated(loaded, 7, torque=0.005)]).arm
    assert found.joints[1].friction.load == pytest.approx(0.2, abs=0.03)


def test_given_two_recordings_when_identified_then_both_count(arm, recording):
    halves = [recording.rows(part) for part in (slice(1000), slice(1000, None))]
    assert len(identify(arm, halves).predictions) == 2


def test_given_a_prismatic_joint_when_identified_then_torques_and_forces_are_predicted(
    arm, rough, simulated
):
    rail = replace(
        arm.joints[0],
        axis=(0.6, 0.0, 0.8),
        friction=JointFriction(1.0, 20.0, 10.0, 100.0),
        rotor_inertia=4.0,
        limits=JointLimits(-0.8, 0.9, 1.5, 400.0),
        type='prismatic',
    )
    arm = replace(arm, joints=(rail, *arm.joints[1:]))
    recording = simulated(arm, motion=plan_excitation(arm, 20.0, trials=10).trajectory)
    found = identify(rough(arm), [recording])
    assert np.all(found.figures.rms < 0.025 * np.max(np.abs(recording.effort), axis=0))
    assert found.arm.joints[0].is_prismatic
    assert found.arm.joints[0].friction.coulomb == pytest.approx(10.0, rel=0.15)
    assert found.mistakes == ()


def test_given_an_arm_with_an_lpv_region_when_identified_then_the_region_is_kept(arm, simulated):
    recording = simulated(arm, rate=60.0)
    for region in (LpvRegion('hanging', (0.3, 0.3)), None):
        assert calibrate(replace(arm, lpv=region), [recording]).arm.lpv == region
