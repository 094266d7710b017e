import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from bags import write_measurements
from fault_injection import DATA, with_joints
from places import ROOT
from scipy import stats
from simulated_recordings import is_physical
from ur10e_twin import recording as recording_of_twin
from ur10e_twin import ur10e

from lpv.bag.run.csv_import import ColumnMap, load_column_map
from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.description import JointFriction, JointLimits, LinkInertia
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation import assembly, payload
from lpv.identify.estimation.assembly import with_joint_values
from lpv.identify.estimation.autocorrelation import estimate_covariance
from lpv.identify.estimation.gains import rescaled
from lpv.identify.estimation.identification import identify
from lpv.identify.estimation.mistakes import find_mistakes
from lpv.identify.estimation.torque_error import calibrate
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.model.prior import parameter_map
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.motions import plan_excitation, random_trajectory
from lpv.identify.recordings.filters import low_pass
from lpv.identify.recordings.motion import find_bandwidths, split
from lpv.identify.recordings.recording import clean, read_recording
from lpv.identify.results.report import write_report
from lpv.identify.results.summary import DRIVES, FIGURES, SENSORS, cells, remarks

pytestmark = pytest.mark.slow
of_real_arms = pytest.mark.skipif(not DATA.is_dir(), reason='no recordings of real arms')
NAMES = ('one', 'two', 'three')
TOOL = payload.Payload(0.8, (0.25, 0.0, 0.05), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0)


def test_given_noise_when_identified_then_links_are_physical(arm, result, recording, tmp_path):
    noise = 0.02 * np.max(np.abs(recording.effort), axis=0)
    assert np.all(result.figures.rms < 1.1 * noise)
    assert np.all(result.figures.rms_band < 0.4 * noise)
    assert np.all(result.prior_figures.rms > 3.0 * noise)
    assert result.arm.effort_includes_gravity
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


def test_given_a_result_when_written_then_its_page_has_tables_of_the_terminal(result, tmp_path):
    page = write_report(result, tmp_path).read_text()
    rows = [re.findall('<td[^>]*>(.*?)</td>', row) for row in re.findall('<tr>.*', page)]
    for columns in (FIGURES, DRIVES, SENSORS):
        assert [row for row in cells(result, columns) if row not in rows] == []
    assert page.count('data:image/png;base64,') == 2 and '<dd>3 <small>' in page


def test_given_links_or_friction_when_checked_or_rescaled_then_torques_are_as_they_can_be(arm):
    assert all(is_physical(joint.link) for joint in arm.joints)
    assert not is_physical(LinkInertia(1.0, (1.0, 0.0, 0.0), (0.0,) * 6))
    assert JointFriction(viscous=-0.4, coulomb=1.0).is_dissipative(2.0)
    assert not JointFriction(viscous=-0.6, coulomb=1.0).is_dissipative(2.0)
    motion = np.random.default_rng(5).normal(size=(3, 20, 3))
    expected = pytest.approx(1.3 * joint_torques(arm, *motion))
    assert joint_torques(rescaled(arm, 1.3), *motion) == expected
    errors = {'torque_error': (0.1, 0.2, 0.3), 'torque_error_speed': (0.0, 0.1, 0.2)}
    stated = replace(arm.uncertainty, torque_error_time=0.5, **errors)
    coupled = with_joints(replace(arm, uncertainty=stated), 2, rotor_coupling=0.01)
    found = rescaled(coupled, 1.3)
    assert found.uncertainty.torque_error == pytest.approx((0.13, 0.26, 0.39))
    assert found.uncertainty.torque_error_speed == pytest.approx((0.0, 0.13, 0.26))
    assert found.uncertainty.torque_error_time == 0.5
    assert found.joints[2].rotor_coupling == pytest.approx(0.013)


def test_given_a_fit_with_which_a_solver_went_round_in_circles_then_bodies_are_found():
    fit = np.load(ROOT / 'tests' / 'data' / 'hard_fit.npz')  # of an arm of four joints on a lift
    names = 'root', 'target', 'mean', 'sigma', 'lower', 'upper'
    *fitted, lower, upper = (fit[name].astype(float) for name in names)
    found = assembly._nearest_consistent(*fitted, 4, (lower, upper))
    assert all(is_physical(LinkInertia.from_vector(link)) for link in found[:40].reshape(4, 10))


def test_given_friction_that_falls_too_far_then_the_arm_can_be_read(arm, simulated, tmp_path):
    falling = [JointFriction(0.0, -2.8, 3.0, 3.0)] * 3
    slow = with_joint_values(arm, friction=falling, limits=[JointLimits(-2.5, 2.5, 1.0, 100.0)] * 3)
    workshop = Workshop(slow, [simulated(slow, rate=60.0)])
    found = workshop.arm_of(workshop.fit())
    assert all(joint.friction.viscous < 0.0 for joint in found.joints)
    assert parse_arm(to_mapping(found)) == found
    # What nobody could read is not written.
    out = tmp_path / 'arm.yaml'
    told = r'arm.yaml is not written: 3 fields are wrong: \(1\) joints\[0\].friction'
    pytest.raises(ConfigError, save_arm, slow, out).match(told)
    assert not out.exists()


def test_given_many_noises_when_fitted_then_intervals_hold_the_truth(arm, simulated):
    inside = []
    for seed in range(12):
        workshop = Workshop(arm, [simulated(arm, seed, rate=60.0)])
        fit = workshop.fit()
        truth = parameter_map(workshop.base, 3) @ arm.parameter_vector()
        used = np.diag(fit.covariance) > 0.0
        width = stats.norm.ppf(0.975) * np.sqrt(np.diag(fit.covariance)[used])
        inside.append(np.abs(fit.parameters - truth)[used] < width)
    assert 0.90 < np.mean(inside) < 0.99


@pytest.mark.parametrize(('factor', 'told'), [(1.0, 0), (0.2, 1), (30.0, 1)])
def test_given_efforts_in_another_unit_when_fitted_then_their_unit_is_doubted(
    arm, recording, factor, told
):
    workshop = Workshop(arm, [replace(recording, effort=factor * recording.effort)])
    workshop.check_scale(workshop.fit())
    assert sum('another unit than N m' in text for text in workshop.warnings) == told


def test_given_a_contact_parts_or_no_rates_when_fitted_then_all_counts(arm, recording, result):
    effort = recording.effort.copy()
    effort[400:430] += 60.0
    touched = identify(arm, [replace(recording, effort=effort)])
    for before, after in zip(result.arm.joints, touched.arm.joints):
        assert after.friction.coulomb == pytest.approx(before.friction.coulomb, rel=0.1)
    assert np.all(touched.figures.rms < 1.1 * result.figures.rms)
    halves = [recording.rows(part) for part in (slice(1000), slice(1000, None))]
    # Rates come from positions where there are none.
    found = identify(arm, [replace(half, velocity=None) for half in halves])
    assert not found.used_rates and len(found.predictions) == 2
    assert {joint.sensors.rates for joint in found.arm.joints} == {'none'}
    assert np.all(found.figures.rms < 1.1 * result.figures.rms)
    partly = identify(arm, [replace(halves[0], velocity=None), halves[1]])
    assert partly.used_rates and len(partly.predictions) == 2
    assert np.all(partly.figures.rms < 1.1 * result.figures.rms)


@pytest.mark.parametrize('way', ['identified', 'calibrated'])
def test_given_a_fault_in_the_recording_then_the_diagnosis_names_it(arm, recording, result, way):
    position = recording.position + np.outer(recording.time > 8.0, [0.0, 0.1, 0.0])
    faulty = replace(recording, position=position)
    run = {'identified': identify, 'calibrated': calibrate}[way]
    (said,) = [text for text in run(arm, [faulty]).warnings if 'healthy?' in text]
    assert re.search(r'8\.0 s: ALARM, two_encoder: error \+0\.1', said)
    assert not any('healthy?' in text for text in result.warnings)
    assert not any('healthy?' in text for text in calibrate(arm, [recording]).warnings)


def test_given_efforts_that_nothing_explains_then_it_is_said(recording, result, arm):
    rough = 10.0 * np.random.default_rng(3).normal(size=recording.effort.shape) * [0, 0, 1]
    faulty = replace(recording, effort=recording.effort + rough)
    found = identify(arm, [faulty])
    for one in (found, calibrate(result.arm, [faulty])):
        (said,) = (text for text in one.warnings if 'is explained' in text)
        assert said.startswith('three') and found.figures.r2[2] < 0.5
    for one in (result, calibrate(result.arm, [recording])):
        assert not any('is explained' in text for text in one.warnings)


def test_given_efforts_without_gravity_when_identified_then_it_is_found(arm, simulated):
    arms = (replace(arm, gravity=g) for g in (9.81, 0.0, 1e-3))
    lifted, free, planar = (simulated(one, 2, rate=30.0).rows(slice(300)) for one in arms)
    without = replace(arm, effort_includes_gravity=False)
    for given, recording, text in ((arm, free, 'do not contain'), (without, lifted, 'contain')):
        found = identify(given, [recording])
        assert np.all(found.figures.r2 > 0.98)
        assert found.arm.effort_includes_gravity is (given is without)
        (said,) = (one for one in found.warnings if 'the weight' in one)
        assert said.startswith(f'efforts {text} ') and said.endswith('taken so')
    kept = identify(arm, [free], weight_is_known=True)
    assert kept.arm.effort_includes_gravity
    assert not identify(replace(arm, gravity=1e-3), [planar]).warnings


def test_given_currents_when_identified_then_gains_and_their_signs_are_found(arm, simulated):
    gains = (8.0, -5.0, 3.0)
    recording = simulated(with_joint_values(arm, torque_gain=gains), 3)
    found = identify(replace(arm, effort_unit='A'), [recording]).arm
    ratio = np.array([joint.torque_gain for joint in found.joints]) / gains
    assert ratio == pytest.approx(np.full(3, ratio.mean()), rel=0.1)
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)


def deviations(arm, motion):
    """Torques of a motion as an arm file states them, and their standard deviations [N m]."""
    vector, slope = arm.parameter_vector(), np.array([j.friction.coulomb_slope for j in arm.joints])
    torque, rows = joint_torques(arm, *motion), np.array(arm.covariance.factor)
    others = (assembly.with_parameters(arm, vector + row, slope) for row in rows)
    changes = [joint_torques(other, *motion) - torque for other in others]
    missed = np.array(arm.uncertainty.torque_error)
    return torque, np.sqrt(missed**2 + np.sum(np.square(changes), axis=0))


def test_given_an_arm_that_pauses_in_a_short_recording_then_its_file_is_as_wrong_as_it_says():
    links = [LinkInertia.from_vector(1.2 * j.link.to_vector()) for j in ur10e().joints]
    given = with_joint_values(ur10e(), link=links)
    found = identify(given, [recording_of_twin(1000, 0.0, 10.0)]).arm
    rng = np.random.default_rng(1)
    motion = rng.uniform(-1.0, 1.0, (3, 200, 6)) * np.array([1.5, 1.0, 2.0])[:, None, None]
    torque, sigma = deviations(found, motion)
    error = torque - joint_torques(ur10e(), *motion)
    # Drives of the twin have gains 5 % and friction 20 % off those of `ur10e`.
    smooth = joint_torques(with_joint_values(found, friction=[JointFriction()] * 6), *motion)
    other = 0.05 * np.abs(torque) + 0.2 * (torque - smooth)
    ratio = np.sqrt(np.mean(error**2 / (sigma**2 + other**2), axis=0))
    assert np.all(ratio < 2.0)
    assert np.all(np.sqrt(np.mean(error**2, axis=0) / np.mean(torque**2, axis=0)) < 0.3)


def test_given_currents_of_an_arm_that_pauses_when_looked_at_then_rests_do_not_decide_gains():
    true = np.array([joint.torque_gain for joint in ur10e().joints])
    blank = with_joint_values(ur10e(), torque_gain=[1.0] * len(true))
    workshop = Workshop(blank, [recording_of_twin(1002)], 0.7)
    workshop.estimate_gains()
    ratio = workshop.gain / true
    assert ratio == pytest.approx(np.full(len(true), ratio.mean()), rel=0.25)


def test_given_a_tool_when_its_payload_is_identified_then_mass_and_centre_fit(arm, simulated):
    loaded = [simulated(payload.with_payload(arm, TOOL), 4)]
    found = payload.identify_payload(arm, loaded)
    assert payload.unknown_load(arm, loaded)[0].startswith('a load of 0.8 kg at the tip')
    assert payload.unknown_load(arm, [simulated(arm, 4)]) == []
    assert found.mass == pytest.approx(0.8, abs=4 * found.mass_sigma)
    assert found.center[0] == pytest.approx(0.25, abs=0.02)
    assert found.rms_after < 0.5 * found.rms_before


def test_given_friction_of_another_day_then_errors_of_tools_are_as_stated(arm, simulated):
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        warmth = rng.uniform(0.8, 1.2, len(arm.joints))
        friction = [JointFriction(0.2, 1.0 * w, 1.5 * w, 40.0) for w in warmth]
        warm = payload.with_payload(with_joint_values(arm, friction=friction), TOOL)
        reach, speed = np.full(3, 1.5), np.full(3, 1.8)
        motion = random_trajectory(rng, np.zeros(3), reach, speed, 20.0)
        found = payload.identify_payload(arm, [simulated(warm, seed, motion=motion)])
        sigma = np.array([found.mass_sigma, *found.center_sigma])
        errors.append((np.array([found.mass, *found.center]) - [0.8, 0.25, 0.0, 0.05]) / sigma)
    assert np.mean(np.abs(errors) < 2.0) > 0.88


def test_given_filtered_efforts_when_identified_then_their_bandwidth_is_found(arm, simulated):
    raw = simulated(arm, 6, torque=1e-4)
    found = identify(arm, [replace(raw, effort=low_pass(raw.effort, 2.0, 0.01))])
    assert found.arm.effort_bandwidth == 2.0


def test_given_friction_that_grows_with_load_when_identified_then_it_is_chosen(arm, simulated):
    frictions = [JointFriction(0.1, 0.5, 0.5, 60.0, load) for load in (0.0, 0.2, 0.0)]
    recording = simulated(with_joint_values(arm, friction=frictions), 7, torque=0.005)
    found = identify(arm, [recording]).arm
    assert found.joints[1].friction.load == pytest.approx(0.2, abs=0.03)


def test_given_a_prismatic_joint_when_identified_then_forces_fit(arm, simulated):
    friction, limits = JointFriction(1.0, 20.0, 10.0, 100.0), JointLimits(-0.8, 0.9, 1.5, 400.0)
    changes = {'friction': friction, 'limits': limits, 'rotor_inertia': 4.0, 'type': 'prismatic'}
    arm = with_joints(arm, 0, axis=(0.6, 0.0, 0.8), **changes)
    recording = simulated(arm, motion=plan_excitation(arm, 20.0, trials=10).trajectory)
    heavier = [LinkInertia.from_vector(1.2 * joint.link.to_vector()) for joint in arm.joints]
    found = identify(with_joint_values(arm, link=heavier), [recording])
    assert np.all(found.figures.rms < 0.025 * np.max(np.abs(recording.effort), axis=0))
    assert found.arm.joints[0].is_prismatic and found.mistakes == ()
    assert any('N for N m, m for rad' in text for text in remarks(found))
    scale = np.where([joint.is_prismatic for joint in arm.joints], 1e3, 1.0)
    in_mm = replace(recording, position=scale * recording.position)
    (mistake,) = find_mistakes(found.arm, [in_mm])
    assert 'millimetres' in mistake.text
    assert found.arm.joints[0].friction.coulomb == pytest.approx(10.0, rel=0.15)


def test_given_a_lift_and_efforts_in_another_unit_then_its_weight_hides_nothing(arm, simulated):
    arm = with_joints(arm, 0, type='prismatic', limits=JointLimits(-1.0, 1.0, 1.0, 500.0))
    one = simulated(arm)
    one = replace(one, effort=0.1 * one.effort)
    (mistake,) = find_mistakes(arm, [one])
    assert 'efforts are no torques in N m' in mistake.text
    workshop = Workshop(arm, [one])
    workshop.check_scale(workshop.fit())
    assert 'links are 0.1' in ' '.join(workshop.warnings)


def identified(folder, urdf):
    arm = read_urdf_chain(DATA / folder / urdf)
    return identify(arm, [read_recording(DATA / folder / 'exciting.db3', arm.joint_names)])


@of_real_arms
def test_given_a_ur10_or_a_panda_when_identified_then_torques_held_back_are_predicted():
    result = identified('ur10', 'ur10.urdf')
    assert np.all(result.figures.rms <= [1.3, 1.25, 1.3, 0.4, 0.4, 2.4])
    assert all(is_physical(joint.link) for joint in result.arm.joints)
    result = identified('panda', 'fer.urdf')
    assert np.all(result.figures.rms_band <= [0.41, 0.46, 0.62, 0.14, 0.10, 0.07, 0.06])


@of_real_arms
@pytest.mark.parametrize('order', [1, -1])
def test_given_a_two_link_arm_when_identified_then_it_is_no_worse_than_published(order, tmp_path):
    arm = load_arm(bringup_file('arms', 'real_arm'))
    columns = load_column_map(bringup_file('columns', 'real_arm'))
    files = [DATA / 'real_arm' / f'run_{name}.csv' for name in ('143601', '144115')[::order]]
    one, other = (read_recording(file, arm.joint_names, None, columns) for file in files)
    result = identify(arm, [one], tests=[other])
    assert np.all(result.figures.rms <= 1.01 * result.prior_figures.rms)
    assert {joint.sensors.rates for joint in result.arm.joints} == {'derived'}
    save_arm(result.arm, tmp_path / 'arm.yaml')
    assert load_arm(tmp_path / 'arm.yaml') == result.arm


def test_given_a_file_when_read_then_joints_are_found_or_named(tmp_path, recording, monkeypatch):
    motion = recording.time, recording.position, recording.velocity
    bag = write_measurements(tmp_path / 'bag', ('three', 'one', 'two'), *motion, recording.effort)
    read = read_recording(bag, NAMES)
    assert np.array_equal(read.position[:, 0], recording.position[:, 1])
    assert np.array_equal(read.effort[:, 2], recording.effort[:, 0])
    without = write_measurements(tmp_path / 'without', NAMES, *motion, None)
    with pytest.raises(IdentificationError, match="'elbow' occurs 0 .*'three', 'one'"):
        read_recording(bag, ('one', 'elbow'))
    pytest.raises(IdentificationError, read_recording, without, NAMES).match('has no efforts')
    # Columns of a CSV file are guessed.
    columns = np.column_stack([recording.time, recording.position, recording.effort])
    for header in ('time;q0;q1;q2;tau0;tau1;tau2', 'time,q1,q2,q3,tau1,tau2,tau3'):
        np.savetxt(tmp_path / 'a.csv', columns, delimiter=header[4], header=header, comments='')
        read = read_recording(tmp_path / 'a.csv', NAMES)
        assert read.velocity is None and read.effort == pytest.approx(recording.effort)
    with pytest.raises(IdentificationError, match='numbered 1, 2, 3, but the arm has 2 joints'):
        read_recording(tmp_path / 'a.csv', NAMES[1:])
    # A file is read as `lpv import-csv` reads it: quoted numbers, an empty cell, a cut line.
    header, first, second, *lines = (tmp_path / 'a.csv').read_text().split()
    first = ','.join(f'"{cell}"' for cell in first.split(','))
    no_effort = second.rpartition(',')[0] + ','
    (tmp_path / 'b.csv').write_text('\n'.join([header, first, no_effort, *lines, '20.0,0.3']))
    same = read_recording(tmp_path / 'b.csv', NAMES)
    assert np.array_equal(same.position, np.delete(read.position, 1, 0))
    assert 'is cut off' in same.warnings[0] and '1 samples' in same.warnings[1]
    (tmp_path / 'b.csv').write_text(header.replace('tau3', 'other'))
    with pytest.raises(IdentificationError, match="no column looks like the effort of 'three'"):
        read_recording(tmp_path / 'b.csv', NAMES)
    columns = ColumnMap('time', 's', 0.0, {'one': ('q1', '', 'tau1')}, {'one': 'rad'})
    with pytest.raises(IdentificationError, match="map has no joint 'two'; it has one"):
        read_recording(tmp_path / 'a.csv', NAMES[:2], columns=columns)
    monkeypatch.setattr('lpv.identify.recordings.recording.MOST_SAMPLES', 100)
    for path in (bag, tmp_path / 'a.csv'):
        with pytest.raises(IdentificationError, match='has more than 100 samples'):
            read_recording(path, NAMES)


def cleaned(recording, **changes):
    one = replace(recording, **changes)
    return clean('test', [one.time], one.position, one.velocity, one.effort)


def test_given_errors_that_sway_slowly_when_judged_then_variances_are_positive():
    k = np.arange(1000.0)
    rows = np.stack([np.sin(0.04 * np.pi * k), np.ones_like(k)], axis=1)[:, None]
    residual = np.cos(2.0 * np.pi * k / 260.0)[:, None]
    inverse = np.linalg.inv(rows[:, 0].T @ rows[:, 0])
    counts = np.ones(residual.shape, bool)
    covariance = estimate_covariance(rows, residual, inverse, [len(k)], counts)
    values = np.linalg.eigvalsh(covariance)
    assert values.min() > 0.0 and covariance[0, 0] == pytest.approx(inverse[0, 0], rel=0.5)


@pytest.mark.parametrize('order', ['in turn', 'behind each other'])
def test_given_each_message_twice_when_cleaned_then_it_counts_once(recording, order):
    rows = np.arange(len(recording.time))
    twice = np.repeat(rows, 2) if order == 'in turn' else np.tile(rows, 2)
    signals = (x[twice] for x in (recording.position, recording.velocity, recording.effort))
    once = clean('r', [recording.time[twice], 1e-3 * np.arange(2.0 * len(rows))], *signals)
    assert once.warnings == (f'{len(rows)} samples that are there again are left out',)
    assert np.array_equal(once.time, recording.time)
    assert np.array_equal(once.position, recording.position)
    # Stamps that stand still: nothing is taken for a copy.
    signals = (x[twice] for x in (recording.position, recording.velocity, recording.effort))
    log = 0.005 * np.arange(2.0 * len(rows))
    assert len(clean('r', [np.zeros(len(twice)), log], *signals).time) == len(twice)


def test_given_few_samples_or_no_motion_then_it_is_said(arm, recording, motion, simulated):
    still = replace(recording, position=0.0 * recording.position, velocity=0.0 * recording.velocity)
    effort = recording.effort[:1200:3]
    partly = replace(recording, effort=recording.effort * [1.0, 0.0, 1.0])
    frozen = replace(recording, position=recording.position * [1.0, 0.0, 1.0])
    for use, bad, reason in (
        (identify, recording.rows(slice(300)), 'too short'),
        (identify, still, 'no joint moves'),
        *(
            (use, partly, 'efforts of two never change')
            for use in (identify, calibrate, payload.identify_payload, find_mistakes)
        ),
        (calibrate, frozen, 'readings of two never change'),
    ):
        pytest.raises(IdentificationError, use, arm, [bad]).match(reason)
    # Efforts that are next to nothing say nothing of the masses; that is said once.
    weak = replace(recording.rows(slice(0, 1200, 3)), effort=1e-12 * effort)
    found = identify(arm, [weak], refit=True)
    assert ' '.join(found.warnings).count('hardly driven') == 1
    assert np.isfinite(found.arm.covariance.matrix()).all()
    # A warning names one joint at rest.
    moves = np.array([0.0, 1.0, 1.0])
    rest = replace(motion, sine=moves * motion.sine, cosine=moves * motion.cosine)
    found = identify(arm, [simulated(arm, 8, motion=rest)])
    assert 'one does not move' in ' '.join(found.warnings)
    assert np.isfinite(found.arm.parameter_vector()).all()


def test_given_a_reading_that_never_changes_when_split_then_bands_are_those_of_others(recording):
    held = recording.position.copy()
    held[:, 0] = 0.0
    bands = find_bandwidths(split(replace(recording, position=held)))
    assert bands.position < 10.0
    assert np.isfinite(find_bandwidths(split(replace(recording, position=0.0 * held))).position)


def test_given_axes_that_hardly_miss_each_other_when_fitted_then_joints_are_driven(arm, simulated):
    places, up, across = [(0.0, 0.003, 0.2)] * 3, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    wrist = with_joint_values(arm, position=places, axis=[up, across, up])
    workshop = Workshop(wrist, [simulated(wrist)])
    # First moments over 3 mm are base parameters of 100 kg, which cancel.
    assert np.abs(workshop.prior.mean).max() > 100.0
    assert workshop.fit().prior.strength == workshop.strength and not workshop.warnings


def test_given_bad_samples_or_stamps_when_cleaned_then_few_are_mended_many_refused(recording):
    effort = recording.effort.copy()
    effort[100:110] = np.nan
    mended = cleaned(recording, effort=effort)
    assert len(mended.time) == len(recording.time) - 10 and 'not finite' in mended.warnings[0]
    zeros = recording.position.copy()
    zeros[700:720] = 0.0
    mended = cleaned(recording, position=zeros)
    assert len(mended.time) == len(recording.time) - 20 and '20 samples of z' in mended.warnings[0]
    effort[::2] = np.nan
    pytest.raises(IdentificationError, cleaned, recording, effort=effort).match('only 50 %')
    with pytest.raises(IdentificationError, match='has 1 samples of the joints'):
        cleaned(recording.rows(slice(1)))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert len(cleaned(recording.rows(slice(2))).time) == 2
    for rates, told in ((np.nan, 'are missing, they are computed'), (0.0, 'stand still while')):
        mended = cleaned(recording, velocity=np.full_like(effort, rates))
        assert mended.velocity is None and mended.warnings[0].startswith(f'rates {told}')
    jitter = 0.004 * np.random.default_rng(0).uniform(-1, 1, len(recording.time))
    mended = cleaned(recording, time=recording.time + jitter)
    assert 'count of the samples' in mended.warnings[0] and np.ptp(np.diff(mended.time)) < 1e-9
    kept = np.random.default_rng(1).random(len(recording.time)) > 0.01
    some = recording.rows(kept)
    mended = cleaned(some, time=some.time + 0.25 * jitter[kept])
    assert 'count of the samples' in mended.warnings[0], 'those that were lost, too'
    assert np.ptp(mended.time - some.time) < 1e-3
    with pytest.raises(IdentificationError, match='stamps stand still'):
        cleaned(recording, time=np.zeros(len(recording.time)))
    for constant, told in ((0.5, 'has efforts that never change'), (np.nan, 'has no efforts of')):
        with pytest.raises(IdentificationError, match=told):
            cleaned(recording, effort=np.full_like(effort, constant))
        with pytest.raises(IdentificationError, match=told):
            cleaned(recording.rows(slice(2)), effort=np.full_like(effort[:2], constant))
    late = recording.time > 8.0
    parts = cleaned(recording, time=recording.time - 5.0 * late)
    assert parts.warnings == ('the clock was set back (1 times): the recording is cut there',)
    assert np.array_equal(parts.position, recording.position)
    assert [len(part.time) for part in split(parts)] == [np.sum(~late), np.sum(late)]
    stray = cleaned(recording, time=np.where(recording.time == 8.0, 30.0, recording.time))
    assert not stray.warnings and len(split(stray)) == 1
    keep = (recording.time < 8.0) | (recording.time > 9.0)
    assert len(split(recording.rows(keep))) == 2
    (even,) = split(replace(recording, time=0.01 * np.arange(len(recording.time))))
    assert even.step == 0.01, 'as it is written into the arm file'
