"""Identification of arms whose parameters are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from simulated_recordings import SensorNoise, is_physical, simulate

from lpv.core.serial_arm.description import JointFriction, JointLimits, LinkInertia, LpvRegion
from lpv.identify.estimation.assembly import parameter_map
from lpv.identify.estimation.gains import rescaled
from lpv.identify.estimation.identification import Options, identify
from lpv.identify.estimation.payload import Payload, identify_payload, with_payload
from lpv.identify.estimation.torque_error import calibrate
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.motions.excitation import plan_excitation
from lpv.identify.recordings.filters import low_pass

pytestmark = pytest.mark.slow


def test_given_a_noisy_recording_when_identified_then_links_are_physical_and_predict_to_the_noise(
    result, recording
):
    noise = 0.02 * np.max(np.abs(recording.effort), axis=0)
    assert np.all(result.figures.rms < 1.1 * noise)
    assert np.all(result.figures.rms_band < 0.4 * noise)
    assert np.all(result.prior_figures.rms > 3.0 * noise)
    assert all(is_physical(joint.link) for joint in result.arm.joints)
    assert all(joint.rotor_inertia >= 0.0 for joint in result.arm.joints)
    assert result.weight.contains_weight and result.arm.effort_includes_gravity


def test_given_another_motion_when_predicted_from_the_file_alone_then_torques_fit(arm, result):
    rng = np.random.default_rng(9)
    q, v, a = 0.7 * rng.normal(size=(3, 200, 3))
    expected = joint_torques(arm, q, v, a)
    error = joint_torques(result.arm, q, v, a) - expected
    assert np.all(np.std(error, axis=0) < 0.04 * np.std(expected, axis=0))


def test_given_friction_when_identified_then_its_slope_is_found(arm, result):
    for joint in result.arm.joints:
        assert joint.friction.coulomb == pytest.approx(1.5, rel=0.15)
        assert 20.0 < joint.friction.coulomb_slope < 80.0


def test_given_many_noises_when_fitted_then_intervals_hold_the_truth(arm, motion):
    inside = []
    for seed in range(12):
        noisy = simulate(arm, motion, 60.0, SensorNoise(), np.random.default_rng(seed))
        workshop = Workshop(arm, [noisy])
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


@pytest.fixture(scope='module')
def floating(arm, motion):
    """A recording whose efforts do not contain the weight."""
    noise, rng = SensorNoise(), np.random.default_rng(2)
    return simulate(replace(arm, gravity=0.0), motion, 60.0, noise, rng)


def test_given_efforts_without_gravity_when_not_said_so_then_it_is_found_and_said(arm, floating):
    found = identify(arm, [floating])
    assert np.all(found.figures.r2 > 0.98)
    assert not found.arm.effort_includes_gravity
    assert any('not to contain the weight' in text for text in found.warnings)


def test_given_efforts_without_gravity_when_said_otherwise_then_only_a_warning_comes(arm, floating):
    workshop = Workshop(arm, [floating])
    assert workshop.check_weight(0.6, may_change=False).contains_weight is False
    assert workshop.arm.effort_includes_gravity
    assert any('not to contain the weight' in text for text in workshop.warnings)


def test_given_a_planar_arm_when_weighed_then_the_data_do_not_tell(arm, motion):
    flat = replace(arm, gravity=1e-3)
    recording = simulate(flat, motion, 60.0, SensorNoise(), np.random.default_rng(2))
    assert Workshop(flat, [recording]).check_weight(0.6, True).contains_weight is None


def test_given_currents_when_identified_then_gains_and_their_signs_are_found(arm, motion):
    gains = (8.0, -5.0, 3.0)
    joints = tuple(replace(joint, torque_gain=gain) for joint, gain in zip(arm.joints, gains))
    driven = replace(arm, joints=joints)
    recording = simulate(driven, motion, 100.0, SensorNoise(), np.random.default_rng(3))
    found = identify(replace(arm, effort_unit='A'), [recording]).arm
    ratio = np.array([joint.torque_gain for joint in found.joints]) / gains
    assert ratio == pytest.approx(np.full(3, ratio.mean()), rel=0.1)
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)


def test_given_a_tool_when_its_payload_is_identified_then_mass_and_centre_fit(arm, motion):
    tool = Payload(0.8, (0.25, 0.0, 0.05), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0)
    recording = simulate(
        with_payload(arm, tool), motion, 100.0, SensorNoise(), np.random.default_rng(4)
    )
    found = identify_payload(arm, [recording])
    assert found.mass == pytest.approx(0.8, abs=4 * found.mass_sigma)
    assert found.center[0] == pytest.approx(0.25, abs=0.02)
    assert found.rms_after < 0.5 * found.rms_before


def test_given_a_factor_when_an_arm_is_rescaled_then_torques_scale(arm):
    q, v, a = np.random.default_rng(5).normal(size=(3, 20, 3))
    assert joint_torques(rescaled(arm, 1.3), q, v, a) == pytest.approx(
        1.3 * joint_torques(arm, q, v, a)
    )


def test_given_filtered_efforts_when_identified_then_their_bandwidth_is_found(arm, motion):
    raw = simulate(arm, motion, 100.0, SensorNoise(torque=1e-4), np.random.default_rng(6))
    found = identify(arm, [replace(raw, effort=low_pass(raw.effort, 2.0, 0.01))], Options())
    assert found.arm.effort_bandwidth == 2.0


def test_given_friction_that_grows_with_load_when_identified_then_it_is_chosen(arm, motion):
    loaded = replace(
        arm,
        joints=tuple(
            replace(joint, friction=JointFriction(0.1, 0.5, 0.5, 60.0, load))
            for joint, load in zip(arm.joints, (0.0, 0.2, 0.0))
        ),
    )
    recording = simulate(loaded, motion, 100.0, SensorNoise(torque=0.005), np.random.default_rng(7))
    found = identify(arm, [recording]).arm
    assert found.joints[1].friction.load == pytest.approx(0.2, abs=0.03)


def test_given_two_recordings_when_identified_then_both_count(arm, recording):
    halves = [recording.rows(part) for part in (slice(1000), slice(1000, None))]
    assert len(identify(arm, halves).predictions) == 2


def test_given_a_prismatic_joint_when_identified_then_torques_and_forces_are_predicted(arm):
    first, second, third = arm.joints
    rail = replace(
        first,
        axis=(0.6, 0.0, 0.8),
        friction=JointFriction(1.0, 20.0, 10.0, 100.0),
        rotor_inertia=4.0,
        limits=JointLimits(-0.8, 0.9, 1.5, 400.0),
        type='prismatic',
    )
    arm = replace(arm, joints=(rail, second, third))
    plan = plan_excitation(arm, 20.0, trials=10).trajectory
    recording = simulate(arm, plan, 100.0, SensorNoise(), np.random.default_rng(1))
    links = [LinkInertia.from_vector(1.2 * joint.link.to_vector()) for joint in arm.joints]
    pairs = zip(arm.joints, links)
    rough = replace(arm, joints=tuple(replace(joint, link=link) for joint, link in pairs))
    found = identify(rough, [recording])
    assert np.all(found.figures.rms < 0.025 * np.max(np.abs(recording.effort), axis=0))
    assert found.arm.joints[0].is_prismatic
    assert found.arm.joints[0].friction.coulomb == pytest.approx(10.0, rel=0.15)
    assert found.mistakes == ()


def test_given_an_arm_with_an_lpv_region_when_identified_then_the_region_is_kept(arm, motion):
    region = LpvRegion('hanging', (0.3, 0.3))
    recording = simulate(arm, motion, 60.0, SensorNoise(), np.random.default_rng(1))
    assert calibrate(replace(arm, lpv=region), [recording]).arm.lpv == region
    assert calibrate(arm, [recording]).arm.lpv is None
