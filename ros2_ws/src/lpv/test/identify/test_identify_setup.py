import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from bags import write_measurements
from fault_injection import DATA, csv_stream, moves_and_rests, two_links, with_joints
from scipy.interpolate import make_interp_spline
from ur10e_twin import recording as recording_of_twin
from ur10e_twin import ur10e

from lpv import ConfigError, LpvError, load_arm
from lpv.bag.run.csv_import import load_column_map
from lpv.core.serial_arm import description
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import JointFriction, JointLimits, LinkInertia, LpvRegion
from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.identify import sensors as of_sensors
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation import delays, mistakes, payload
from lpv.identify.estimation.assembly import with_joint_values
from lpv.identify.estimation.torque_error import calibrate, torque_error, torque_tolerance
from lpv.identify.model import rigid_body
from lpv.identify.motions import Bounds, plan_excitation, random_trajectory, write_reference
from lpv.identify.recordings.filters import shifted
from lpv.identify.recordings.motion import Segment, find_bandwidths, moving
from lpv.identify.recordings.recording import Recording, read_recording
from lpv.identify.results.report import residuals
from lpv.identify.sensors import find_second_encoders, noise_deviation, quantization_step

STEP, SLOW = 0.004, pytest.mark.slow


@pytest.mark.parametrize('kind', ['revolute', 'prismatic', 'carried rotor'])
def test_given_an_arm_when_computing_torques_then_they_are_those_of_the_dynamics(arm, kind):
    if kind == 'carried rotor':  # by a link, with one that turns with two joints
        arm = with_joints(load_arm('real_arm'), 1, rotor_coupling=-0.01)
    else:
        arm = with_joints(arm, 1, axis=(0.6, 0.0, -0.8), type=kind)
        arm = replace(arm, base_orientation=(0.3, -0.2, 0.1))
    arm, n = with_joints(arm, friction=JointFriction()), len(arm.joints)
    motion = np.random.default_rng(2).normal(size=(3, 20, n))
    expected = SerialModel(compile_chain(arm)).torque(*motion)
    rows = rigid_body.RigidBody(arm).regressor(*motion)[:, :, : 10 * n]
    found = rows @ arm.inertial_parameters() + motion[2] @ compile_chain(arm).motor
    assert found == pytest.approx(expected, abs=1e-12)


def test_given_a_joint_that_slides_when_residuals_are_drawn_then_its_units_are_there(arm):
    arm = replace(arm, joints=(arm.joints[0], replace(arm.joints[1], type='prismatic')))
    part = SimpleNamespace(**dict.fromkeys(('velocity', 'position', 'residual'), np.ones((5, 2))))
    figure = residuals(SimpleNamespace(arm=arm, predictions=[part]))
    labels = [axis.get_xlabel() for axis in figure.axes]
    assert labels == ['rate [rad/s]', 'position [rad]', 'rate [m/s]', 'position [m]']


def test_given_any_parameters_when_reduced_to_base_ones_then_torques_stay(arm):
    model, samples = rigid_body.RigidBody(arm), np.random.default_rng(0).normal(size=(3, 30, 3))
    base, full = rigid_body.find_base_parameters(model), model.regressor(*samples)
    x = np.random.default_rng(1).normal(size=33)
    assert full[:, :, base.columns] @ (base.combination @ x) == pytest.approx(full @ x, abs=1e-9)
    assert np.linalg.matrix_rank(full[:, :, base.columns].reshape(-1, base.size)) == base.size


@pytest.fixture(scope='module')
def plan(arm):
    return plan_excitation(arm, 12.0, trials=40)


def test_given_limits_when_planned_then_the_motion_keeps_them_and_rests_at_its_ends(arm, plan):
    position, rate, acceleration = plan.trajectory.sample(np.linspace(0.0, 12.0, 1201))
    for j, joint in enumerate(arm.joints):
        assert joint.limits.lower < position[:, j].min() < position[:, j].max() < joint.limits.upper
        assert np.abs(rate[:, j]).max() < joint.limits.velocity
    assert np.all(plan.torque < [joint.limits.torque for joint in arm.joints])
    assert np.abs([rate[[0, -1]], acceleration[[0, -1]]]).max() < 1e-9
    # More trials inform more.
    assert plan.information > plan_excitation(arm, 12.0, trials=1).information


def torques_of(arm, plan):
    """Largest torques of a planned motion [N m]."""
    motion = plan.trajectory.sample(np.arange(0.0, 12.0, 0.02))
    return np.abs(rigid_body.joint_torques(arm, *motion)).max(axis=0)


def test_given_heavy_rotors_and_friction_when_planned_then_torques_keep_their_limits(arm):
    drives = {'rotor_inertia': [8.0] * 3, 'friction': [JointFriction(2.0, 0.1, 1.0, 50.0, 0.1)] * 3}
    limits = [max(3.0 * torque, 20.0) for torque in plan_excitation(arm, 12.0, trials=3).torque]
    most = [replace(one.limits, torque=torque) for one, torque in zip(arm.joints, limits)]
    heavy = with_joint_values(arm, limits=most, **drives)
    plan = plan_excitation(heavy, 12.0, trials=10)
    assert np.all(torques_of(heavy, plan) <= 1.001 * plan.torque) and np.all(plan.torque < limits)


def test_given_much_viscous_friction_when_planned_then_a_slower_motion_counts_as_slower(arm):
    most = [0.5 * 100.0 * 0.6 * one.limits.velocity + 60.0 for one in arm.joints]
    limits = [replace(one.limits, torque=torque / 0.8) for one, torque in zip(arm.joints, most)]
    viscous = with_joint_values(arm, limits=limits, friction=[JointFriction(0.0, 100.0)] * 3)
    plan = plan_excitation(viscous, 12.0, trials=3)  # no motion at full speed keeps the limits
    largest = torques_of(viscous, plan)
    assert np.all(largest <= 1.001 * plan.torque) and np.all(plan.torque <= largest + 60.0)


def test_given_a_lift_of_constant_weight_when_planned_then_offsets_of_friction_do_not_decide(arm):
    limits = JointLimits(0.0, 0.5, 1.0, 1e3)
    lift = with_joints(arm, 0, type='prismatic', axis=(0.0, 0.0, 1.0), limits=limits)
    lift = with_joints(lift, 0, position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0))
    assert plan_excitation(lift, 12.0, trials=3).condition < 1e4


def test_given_a_floor_when_planned_then_the_tip_stays_above_or_it_is_said_that_none_does(arm):
    center, chain = np.array([0.0, -0.6, 0.3]), compile_chain(arm)
    plan = plan_excitation(arm, 12.0, Bounds(lowest=0.05), center=center, trials=20)
    for q in plan.trajectory.sample(np.arange(0.0, 12.0, 0.05))[0]:
        assert forward_kinematics(chain, q)[1][2] > 0.049
    with pytest.raises(IdentificationError, match='no motion keeps'):
        plan_excitation(arm, 12.0, Bounds(lowest=5.0), trials=3)


def test_given_a_motion_when_written_then_all_files_hold_it(arm, plan, tmp_path):
    motion = plan.trajectory
    table, message, bag, scenario = write_reference(arm, motion, 50.0, tmp_path / 'out')
    points = yaml.safe_load(message.read_text())['points']
    assert points[0]['positions'] == pytest.approx(motion.center)
    read = read_recording(bag, arm.joint_names)
    assert read.position == pytest.approx(motion.sample(read.time)[0], abs=1e-6)
    assert np.loadtxt(table, delimiter=',', skiprows=1).shape[0] == len(read.time)
    data = yaml.safe_load(scenario.read_text())
    assert data['duration'] == 12.0
    time, joints = zip(*((p['t'], p['joints']) for p in data['path']['waypoints']))
    rest, between = [(1, np.zeros(3)), (2, np.zeros(3))], np.arange(0.03, 12.0, 0.07)
    spline = make_interp_spline(time, joints, k=5, bc_type=(rest, rest))
    position, rate, _ = motion.sample(between)
    assert spline(between) == pytest.approx(position, abs=1e-3)
    assert spline.derivative()(between) == pytest.approx(rate, abs=2e-2)


def segment(noise=1e-5, delay=0.0):
    time, rng = STEP * np.arange(5000), np.random.default_rng(0)
    position = np.sin(time)[:, None] + noise * rng.normal(size=(len(time), 1))
    velocity = np.cos(time - delay)[:, None] + 1e-3 * rng.normal(size=(len(time), 1))
    return Segment(STEP, time, position, velocity, 0.0 * position)


def found(position, velocity, kept=slice(None)):
    time = STEP * np.arange(len(position))
    recording = Recording('r', time, position, velocity, np.round(position, 2)).rows(kept)
    return of_sensors.sense([recording], np.zeros(1), np.zeros(1))


@pytest.mark.parametrize('step', [2 * np.pi / 4096, 1e-4, 1e-3])
@pytest.mark.parametrize('count', [5000, 1500])
def test_given_rounded_readings_with_rests_when_searched_then_their_step_is_found(step, count):
    position = segment().position[:count].copy()
    position[: count // 3] = position[count // 3]
    assert quantization_step([step * np.round(position / step)]) == pytest.approx([step], rel=1e-3)
    assert quantization_step([position]) == [0.0]


@pytest.mark.slow
def test_given_signals_when_sensed_then_each_has_its_step_and_its_noise_without_it():
    one = segment(noise=3e-4)
    rates = 5e-3 * np.round(one.velocity / 5e-3)
    sensed = found(1e-4 * np.round(one.position / 1e-4), rates)
    assert sensed.quantization == pytest.approx([1e-4], rel=1e-3)
    assert quantization_step([rates]) == pytest.approx([5e-3], rel=1e-3)
    assert sensed.position_noise == pytest.approx([3e-4], rel=0.05)
    assert found(np.round(one.position, 1), one.velocity).position_noise > 0.0
    # Rates of which nothing is proved are called derived.
    time = STEP * np.arange(5000)[:, None]
    assert found(np.sin(time), np.cos(time)).rates == ['derived']


@pytest.mark.parametrize('share', [0.1, 0.5])
def test_given_missing_samples_when_sensed_then_noise_is_that_of_the_others(share):
    one = segment(noise=3e-4)
    kept = np.random.default_rng(1).random(len(one.time)) > share
    sensed = found(one.position, one.velocity, kept)
    assert sensed.position_noise == pytest.approx([3e-4], rel=0.05)
    assert sensed.velocity_noise == pytest.approx([1e-3], rel=0.05)


def test_given_white_noise_or_late_rates_when_measured_then_deviation_and_delay_are_found():
    assert noise_deviation([segment(noise=2e-4).position]) == pytest.approx([2e-4], rel=0.05)
    late = segment(delay=0.03)
    assert delays.rate_delays([late], find_bandwidths([late])) == pytest.approx([0.03], abs=1e-3)


def test_given_second_encoders_when_compared_then_they_fit_or_not(recording, arm, tmp_path):
    """Joint two has one, with an offset and more noise."""
    rng = np.random.default_rng(3)
    other = 0.1 - recording.position[:, 1:2] + 5e-4 * rng.normal(size=(len(recording.time), 1))
    names, still = (*arm.joint_names, 'two_link'), np.zeros_like(other)
    parts = (recording.position, other), (recording.velocity, still), (recording.effort, still)
    bag = write_measurements(tmp_path / 'bag', names, recording.time, *map(np.hstack, parts))
    (found,) = find_second_encoders(bag, {'two': 'two_link'})
    assert found.encoder.position_noise == pytest.approx(5e-4, rel=0.1)
    assert (found.scale, found.offset) == pytest.approx((-1.0, 0.1), abs=1e-3)
    assert found.difference == pytest.approx(5e-4, rel=0.1)
    assert 'two_link' in of_sensors.describe(found, 'rad')
    said = of_sensors.describe(found, 'm')  # of a joint that slides
    assert ' m, scale' in said and said.endswith(' mm RMS') and 'rad' not in said
    sensors = of_sensors.with_second_encoders(arm, [found]).joints[1].sensors
    assert sensors.second_encoder == found.encoder
    reasons = {'three': 'no second encoder of this joint', 'nothing': 'occurs 0 times'}
    for other, reason in reasons.items():
        pytest.raises(LpvError, find_second_encoders, bag, {'two': other}).match(reason)
    with pytest.raises(ConfigError, match='two_link'):
        of_sensors.with_second_encoders(arm, find_second_encoders(bag, {'two_link': 'two_link'}))


@pytest.mark.skipif(not DATA.is_dir(), reason='no recordings of real arms')
def test_given_a_kr300_when_link_side_encoders_are_compared_then_they_agree_within_a_milliradian():
    pairs = {f'{i}': f'link_position{i}' for i in (1, 2, 3)}
    for reading in find_second_encoders(DATA / 'kr300' / 'A.csv', pairs):
        assert abs(abs(reading.scale) - 1.0) < 0.01 and reading.difference < 2e-3


@pytest.fixture
def refusal(arm, tmp_path, call):
    """What the command says that identifies the arm and refuses its options."""
    file = tmp_path / 'arm.yaml'

    def said(recording, *options, arm=arm):
        save_arm(arm, file)
        return call('identify', recording, '--arm', file, *options, code=2).err

    return said


def test_given_what_does_not_fit_then_it_is_said_before_the_fit(arm, tmp_path, refusal):
    columns, run, new = (tmp_path / name for name in ('columns.yaml', 'run.csv', 'new'))
    joints = 'joints: {one: {position: q, velocity: w}}'
    columns.write_text(f'time: {{column: t}}\nangle_unit: deg\n{joints}')
    slide = replace(arm, joints=(replace(arm.joints[0], type='prismatic'),))
    said = refusal(run, '--columns', columns, arm=slide)
    assert 'columns.yaml: joints.one.unit: must be m' in said
    run.write_text('time q1 tau1\n0.0 0.1 0.2\n')
    said = refusal(run)
    assert 'it has time q1 tau1; give a column map' in said
    example = tmp_path / 'example.yaml'  # of a map, as the error shows it
    example.write_text(said[said.index('such as {') + 8 :])
    assert load_column_map(example).joints == {'shoulder': ('q1', '', 'i1')}
    missing = tmp_path / 'nothing.csv'
    assert 'File exists' in refusal(missing, '--out', tmp_path / 'arm.yaml' / 'a')
    assert 'not a folder' in refusal(missing, '--out', tmp_path)
    refusal(missing, '--out', new / 'a.yaml')
    assert new.is_dir()


def test_given_a_point_mass_that_fits_worse_than_none_then_it_is_no_tool(
    arm, recording, tmp_path, refusal
):
    signals = recording.position, recording.velocity, recording.effort
    swapped = [signal[:, ::-1] for signal in signals]
    bag = write_measurements(tmp_path / 'bag', arm.joint_names, recording.time, *swapped)
    said = refusal(bag, '--payload')
    assert 'warning: signals of one and three are swapped' in said and 'shows no tool: mass' in said


@pytest.mark.parametrize(('options', 'refused'), [
    ('--calibrate --report folder', 'report'), ('--payload --test other.csv', 'test'),
    ('--calibrate --refit', 'refit'), ('--calibrate --known-mass 2', 'known-mass'),
    ('--known-mass 2', 'known-mass'), ('--lock one', 'lock'), ('--joints one', 'joints'),
    ('--second-encoder one', 'second-encoder'), ('--base-rpy 0 nan 0', 'base-rpy'),
    ('--tip link', 'tip'), *((f'--gain {gain}', 'gain') for gain in ('nan', 'inf', '1e308', '0')),
])  # fmt: skip
def test_given_an_option_without_effect_then_it_is_refused(refusal, options, refused):
    told = 'needs 1 or ' if refused == 'gain' else ''
    assert f'lpv identify: --{refused}: {told}' in refusal('x.csv', *options.split())


def test_given_a_calibrated_arm_then_its_second_encoder_is_kept(arm, recording, tmp_path, call):
    file, out, csv = (tmp_path / name for name in ('arm.yaml', 'out.yaml', 'run.csv'))
    save_arm(arm, file)
    kinds = [f'{name}_{kind}' for kind in ('pos', 'vel', 'torque') for name in arm.joint_names]
    signals = recording.time, recording.position, recording.velocity, recording.effort
    header = ','.join(['time', *kinds])
    np.savetxt(csv, np.column_stack(signals), '%.9g', ',', header=header, comments='')
    call(*('identify', csv, '--arm', file, '--calibrate', '--second-encoder', 'one=one_pos'),
         '--out', out)  # fmt: skip
    assert load_arm(out).joints[0].sensors.second_encoder.name == 'one_pos'


def changed(change, *names):
    names = names or ('position', 'velocity', 'effort')
    return lambda r: replace(r, **{name: change(getattr(r, name)) for name in names})


def efforts(change):
    return changed(change, 'effort')


def off(error):
    """Readings of the second joint that are off by an error of their own and the time."""

    def change(recording):
        position, time = recording.position.copy(), recording.time[:, None]
        position[:, 1:2] += error(position[:, 1:2], time)
        return replace(recording, position=position, velocity=None)

    return change


MISTAKES = {
    'degrees': ('angle', 'degrees', changed(np.degrees, 'position', 'velocity'), None),
    'rates in degrees': ('rates', 'two .* rates in degrees',
                         changed(lambda v: v * [1, 57.3, 1], 'velocity'), None),
    'rates of the other sign': ('rates', 'two .* rates that count the other way',
                                changed(lambda v: v * [1, -1, 1], 'velocity'), None),
    'tilted base': ('gravity', 'about y by -5', lambda r: r, (0.0, 0.1, 0.0)),
    'mounted on a wall': ('gravity', 'about y by -(89|9[01])', lambda r: r, (0.0, np.pi / 2, 0.0)),
    'other sign': ('sign', 'efforts of two count', efforts(lambda u: u * [1, -1, 1]), None),
    'tilt and a sign': ('gravity', 'by -5', efforts(lambda u: u * [1, -1, 1]), (0.0, 0.1, 0.0)),
    'other signs': ('sign', 'of all joints', efforts(np.negative), None),
    'turned axis': ('reading', 'and efforts of two count the other way round: is',
                    changed(lambda x: x * [1, -1, 1]), None),
    'swapped names': ('names', 'two and three are swapped',
                      changed(lambda x: x[:, [0, 2, 1]]), None),
    'swapped with the next but one': ('names', 'signals of one and three are swapped',
                                      changed(lambda x: x[:, [2, 1, 0]]), None),
    'swapped efforts': ('names', 'efforts of two and three are swapped',
                        efforts(lambda u: u[:, [0, 2, 1]]), None),
    'one unit': ('unit', 'efforts of two are in another unit: about 10 times',
                 efforts(lambda u: u * [1, 0.1, 1]), None),
    'currents': ('unit', 'currents', efforts(lambda u: u / [13, 12, 9]), None),
    'late efforts': ('delay', '50 ms too late', efforts(lambda u: shifted(u, 0.05, 0.01)), None),
    'zero': ('reading', r'two are off by about \+0\.(4[0-4]?|3[6-9]) rad all',
             off(lambda q, t: 0.4 + 0.0 * q), None),
    'ratio': ('reading', r'two are off by about \+(9|10)\..% of what they are',
              off(lambda q, t: 0.1 * q), None),
    'drift': ('reading', r'two are off by about \+0\.0(1|09\d) rad/s more and more',
              off(lambda q, t: 0.01 * t), None),
    'turned, zero': ('reading', r'readings of two count the other .* off by about \+0\.(7|6[89])',
                     off(lambda q, t: 0.7 - 2.0 * q), None),
}  # fmt: skip
ALIKE = {'mounted on a wall', 'tilt and a sign', 'other signs', 'currents'}
"""Mistakes whose like is among the fast tests: the whole suite looks for them."""


@pytest.mark.parametrize('name', [pytest.param(n, marks=[SLOW] * (n in ALIKE)) for n in MISTAKES])
def test_given_mistakes_then_the_most_evident_one_is_named(rough_arm, recording, name):
    kind, text, change, base = MISTAKES[name]
    arm = rough_arm if base is None else replace(rough_arm, base_orientation=base)
    (first,) = mistakes.find_mistakes(arm, [change(recording)])
    assert first.kind == kind and re.search(text, first.text)


@pytest.mark.parametrize('names', [('two',), ('one', 'two', 'three')])
def test_given_joints_without_limits_in_degrees_then_it_is_said(rough_arm, recording, names):
    arm = with_joint_values(rough_arm, limits=[JointLimits()] * 3)
    scale = np.where(np.isin(arm.joint_names, names), 180.0 / np.pi, 1.0)
    change = changed(lambda x: scale * x, 'position', 'velocity')
    (first,) = mistakes.find_mistakes(arm, [change(recording)])
    assert f'positions of {", ".join(names)} are in another unit: degrees?' in first.text


@pytest.mark.parametrize(('load', 'offset', 'said'), [
    (0.0, 0.06, r'two .* rad in b'), pytest.param(0.0, 0.0, None, marks=SLOW),
    pytest.param(1.0, 0.0, r'by about \+1(\.\d)? kg in b', marks=SLOW),
])  # fmt: skip
def test_given_recordings_then_the_odd_one_is_named(rough_arm, arm, simulated, load, offset, said):
    tool = payload.Payload(load, (0.3, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0)
    loaded = payload.with_payload(arm, tool)
    one, odd, third = simulated(arm, 1), simulated(loaded, 2), simulated(arm, 3)
    odd = replace(odd, position=odd.position + [0.0, offset, 0.0])
    recordings = [replace(r, source=name) for name, r in zip('abc', (one, odd, third))]
    found = mistakes.find_mistakes(rough_arm, recordings)
    assert [bool(re.search(said or '', m.text)) for m in found] == [True] * (said is not None)


class Swing:
    """All joints at one frequency."""

    duration = 20.0

    def sample(self, time):
        """Positions, rates, accelerations."""
        angle = np.asarray(time)[:, None] + [0.0, 0.9, 1.8]
        return np.sin(angle), np.cos(angle), -np.sin(angle)


@pytest.mark.slow
@pytest.mark.parametrize(('stated', 'said'), [(0.0, ['load']), (5.0, [])])
def test_given_a_load_then_it_is_a_mistake_where_the_file_says_there_is_none(stated, said):
    arm = replace(ur10e(), uncertainty=description.Uncertainty(payload=stated))
    found = mistakes.find_mistakes(arm, [recording_of_twin(1000, 2.6, 15.0)])
    assert [one.kind for one in found] == said
    assert all(re.search('about 2.. kg more than the file says', one.text) for one in found)


def test_given_a_proper_setup_when_looked_at_then_there_are_no_mistakes(rough_arm, recording):
    assert mistakes.find_mistakes(rough_arm, [recording]) == []


def as_in_a_urdf(arm):
    """The arm without statements of its friction and rotors."""
    return with_joint_values(arm, friction=[JointFriction()] * 3, rotor_inertia=[0.0] * 3)


def test_given_a_wrist_with_a_geared_rotor_when_looked_at_then_no_ratio_is_doubted(arm, simulated):
    light = LinkInertia(0.5, (0.025, 0.0, 0.0), (2e-3, 0.0, 3e-3, 0.0, 0.0, 3e-3))
    arm = with_joints(arm, 2, link=light, rotor_inertia=0.15)
    fast = random_trajectory(np.random.default_rng(4), *np.outer((0.0, 1.5, 2.6), np.ones(3)), 30.0)
    one = simulated(arm, motion=fast)
    assert mistakes.find_mistakes(as_in_a_urdf(arm), [one]) == []


class Stops:
    """From pose to pose with rests between."""

    duration = 30.0

    def __init__(self, reach, rate, seed):
        self.motion, self.seed = (np.zeros(3), np.array(reach), np.array(rate)), seed

    def sample(self, time):
        """Positions, rates, accelerations."""
        return moves_and_rests(self.motion, np.random.default_rng(self.seed), time)


def test_given_a_joint_that_slides_and_rests_then_no_names_are_swapped(arm, simulated):
    kind = {'type': 'prismatic', 'axis': (0.0, 0.0, 1.0), 'limits': JointLimits(0, 0.2, 1.0, 150.0)}
    arm = with_joints(arm, 1, friction=JointFriction(0.0, 1.0, 60.0, 500.0), **kind)
    one = simulated(arm, motion=Stops((1.0, 0.09, 1.0), (1.5, 0.3, 1.5), 3))
    assert mistakes.find_mistakes(as_in_a_urdf(arm), [one]) == []


def test_given_friction_at_rest_as_in_the_next_motion_then_a_delay_is_found(arm, simulated):
    sticky = with_joint_values(arm, friction=[JointFriction(0.0, 1.0, 3.0, 500.0)] * 3)
    one = simulated(sticky, motion=Stops([1.0] * 3, [1.5] * 3, 1))
    moves = moving(one.velocity, 0.01, np.ones(3))
    ahead = np.sign(one.velocity) * moves
    for row in reversed(range(len(ahead) - 1)):
        ahead[row] = np.where(moves[row], ahead[row], ahead[row + 1])
    late = shifted(one.effort + 3.0 * ahead * ~moves, 0.05, 0.01)
    (first,) = mistakes.find_mistakes(as_in_a_urdf(arm), [replace(one, effort=late)])
    assert first.kind == 'delay' and re.search('[56]0 ms too late', first.text)


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'duration'), [(5, 60.0), (1, 6.0)])
def test_given_an_arm_that_pauses_then_friction_at_rest_is_no_mistake(seed, duration):
    one = recording_of_twin(10**6 + seed, 0.0, duration, robot=1)
    assert mistakes.find_mistakes(ur10e(), [one]) == []


def test_given_gains_and_delays_as_healthy_drives_have_then_they_are_right(arm, simulated):
    one = simulated(arm, motion=Swing())
    effort = shifted(one.effort * [1.05, 0.95, 1.05], 0.01, 0.01)
    assert mistakes.find_mistakes(arm, [replace(one, effort=effort)]) == []


@pytest.mark.skipif(not DATA.is_dir(), reason='no recordings of real arms')
@pytest.mark.parametrize(('build', 'file'), [('A0', 'A0_01'), ('C0', 'C0_03')])
def test_given_real_arms_that_move_fast_when_looked_at_then_there_are_no_mistakes(build, file):
    stream = csv_stream(DATA / 'real_arm' / 'more' / f'{file}.csv')
    one = Recording(file, 1e-9 * stream.stamps, *np.moveaxis(stream.samples, 1, 0))
    assert mistakes.find_mistakes(two_links(build)[0], [one]) == []


@pytest.mark.slow
def test_given_a_load_that_is_taken_when_looked_at_then_no_encoder_is_blamed():
    before, after = (recording_of_twin(10**6, load, 15.0, robot=1) for load in (0.0, 3.0))
    late = np.where(before.time[:, None] > 7.0, after.effort, before.effort)
    (first,) = mistakes.find_mistakes(ur10e(), [replace(before, effort=late)])
    assert first.kind == 'change' and re.search(r'by about \+[23].* kg after [6-9] s', first.text)


def test_given_errors_that_change_with_speed_when_fitted_then_the_bounds_do():
    rng = np.random.default_rng(1)
    speed = rng.uniform(0, 2, 5000)
    tolerance = torque_tolerance(speed, np.exp(-4 * speed) + 0.1 * rng.uniform(-1, 1, 5000))
    near, fast = np.interp([0.01, 1.5], tolerance.speed, tolerance.torque)
    assert near > 0.9 and fast < 0.15
    # Errors that grow with speed, and last for a while.
    rng, count, step = np.random.default_rng(2), 40_000, 0.01
    rate, error = np.repeat(rng.uniform(-2, 2, count // 50), 50), np.zeros(count)
    keep = np.exp(-step / 0.2)
    for k, drawn in enumerate(rng.normal(size=count) * np.sqrt(1 - keep**2)):
        error[k] = keep * error[k - 1] + drawn
    residual = np.hypot(0.5, 0.8 * rate) * error + 0.1 * rng.normal(size=count)
    signals, usual = [[x[:, None]] for x in (rate, residual, rate < 9.0)], np.array([0.4])
    found = torque_error(*signals, step, usual)
    assert found.slow == pytest.approx([0.5], rel=0.15)
    assert found.growth == pytest.approx([0.8], rel=0.15)
    assert found.time == pytest.approx(0.2, rel=0.4)
    # Of a joint that does not move what is usual is stated; of one that hardly does, some of it.
    error = 0.1 * np.sign(np.arange(count) % 20 - 9.5)
    for samples, least, most in ((0, 0.39, 0.41), (20, 0.15, 0.35)):
        signals = [[x[:, None]] for x in (0.0 * rate, error, np.arange(count) < samples)]
        assert least < torque_error(*signals, step, usual).slow < most
    # Where efforts are off by their noise alone, errors last for no less than part of a sample.
    for seed in range(8):
        noise = 0.1 * np.random.default_rng(seed).normal(size=count)
        signals = [[x[:, None]] for x in (rate, noise, rate < 9.0)]
        assert 0.1 * step < torque_error(*signals, step, usual).time < 10.0 * step


def test_given_a_short_recording_when_calibrated_then_the_model_stays(arm, simulated, tmp_path):
    short = simulated(arm, 5).rows(slice(500, 1500))
    short = replace(short, position=1e-3 * np.round(short.position / 1e-3))
    found = calibrate(arm, [short])
    assert np.array_equal(found.arm.parameter_vector(), arm.parameter_vector())
    assert [j.sensors.quantization for j in found.arm.joints] == pytest.approx([1e-3] * 3, rel=1e-3)
    stated = found.arm.uncertainty
    assert len(stated.torque_error) == len(stated.torque_error_speed) == 3
    # One that misses what it holds; a region is kept.
    heavier = replace(arm, gravity=1.3 * arm.gravity, lpv=LpvRegion('hanging', (0.3, 0.3)))
    worse = calibrate(heavier, [short]).arm
    assert worse.uncertainty.torque_error[1] > 3.0 * stated.torque_error[1]
    assert worse.lpv == heavier.lpv and found.arm.lpv is None
    save_arm(found.arm, tmp_path / 'arm.yaml')
    assert load_arm(tmp_path / 'arm.yaml') == found.arm


def test_given_rests_when_looked_for_then_reversals_are_none_and_a_joint_that_never_moves_is_one():
    time = 0.01 * np.arange(1000)
    pauses = np.where(time % 2.0 < 1.0, 0.3 * np.sin(np.pi * time), 0.0)
    rates = np.stack([pauses, 0.3 * np.sin(time), 0.0 * time], axis=1)
    found = moving(rates, 0.01, np.ones(3))
    assert found[:, 0].mean() == pytest.approx(0.5, abs=0.05)
    assert found[:, 1].all() and not found[:, 2].any()


@pytest.mark.slow
def test_given_an_arm_that_pauses_when_calibrated_then_friction_at_rest_is_no_torque_error():
    # In motion the twin's friction is within 20 % of the file's, at rest anything up to Coulomb's.
    found = calibrate(ur10e(), [recording_of_twin(1000)]).arm.uncertainty
    coulomb = compile_chain(ur10e()).friction[:, 1]
    assert (np.array(found.torque_error) < 0.25 * coulomb).all()


def test_given_an_arm_at_rest_when_calibrated_then_unseen_errors_are_named(arm, recording):
    first = recording.rows(np.zeros(len(recording.time), int))
    noisy = first.position + 2e-5 * np.random.default_rng(2).normal(size=first.position.shape)
    still = replace(first, time=recording.time, position=noisy, velocity=0.0 * first.velocity)
    found = calibrate(arm, [still])
    assert len(found.warnings) == 3 and np.isfinite(found.arm.uncertainty.torque_error).all()
    assert {joint.sensors.rates for joint in found.arm.joints} == {'derived'}
