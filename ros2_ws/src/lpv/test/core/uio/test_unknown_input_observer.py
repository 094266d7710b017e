import math
from dataclasses import replace

import numpy as np
import pytest
from fault_injection import csv_stream, with_joints
from places import DATA

from lpv import AlarmEvent, ConfigError, Fault
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import TorqueTolerance
from lpv.core.serial_arm.diagnosis import parameter_set as healthy
from lpv.core.serial_arm.diagnosis.healthy_balance import generator_count
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.support.records import new_record
from lpv.core.uio.bound.error_bound import error_bound
from lpv.core.uio.bound.unknown_torque import MOTION, healthy_arm, unknown_torque
from lpv.core.uio.certificate.error_system import exact_fault_sigma, link_errors
from lpv.core.uio.model.dynamics import friction, set_pose
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import planar_model
from lpv.core.uio.unknown_input_observer import UnknownInputObserver

pytestmark = pytest.mark.slow


def answers(run, arm, gains, observer, parts=1):
    """Of a monitor that gets a run in some parts."""
    monitor = SerialSensorMonitor('uio', arm, gains=gains, observer=observer)
    stamps = 1 + np.round(1e9 * run.time).astype(np.int64)
    rows = (stamps, run.measured, run.measured_velocity, run.effort)
    return [monitor.take_many(*part) for part in zip(*(np.array_split(r, parts) for r in rows))]


@pytest.fixture
def observed(paper_arm, paper_gains, run_paper):
    """Runs the paper's arm, or one like it, without faults if not said otherwise; run and answers
    of an observer whose gains allow for that arm."""

    def run(observer, arm=paper_arm, duration=6.0, **changes):
        gains = replace(paper_gains, arm_sha256=planar_model(arm).sha256())
        made = run_paper(arm, gains, **{'faults': (), 'duration': duration, **changes})
        return made, *answers(made, arm, gains, observer)

    return run


@pytest.mark.parametrize(('factors', 'payload'), [
    ((1.05, 0.95), 0.0), ((0.95, 1.05), 0.3), ((1.05, 1.05), 0.3),
])  # fmt: skip
def test_given_a_healthy_arm_then_bounds_hold(paper_arm, observed, factors, payload):
    arm = replace(paper_arm, uncertainty=replace(paper_arm.uncertainty, payload=0.3))
    off = {'mass_factors': factors, 'inertia_factors': factors, 'disturbance': False}
    _, found = observed('uio', arm, payload=payload, **off)
    assert found.events == []
    known = found.fault.bound[500:]
    assert np.isfinite(known).all() and known.max() < 0.5
    assert np.all(np.abs(found.fault.estimate[500:]) <= known)


@pytest.mark.parametrize('observer', ['uio', 'tightest'])
def test_given_no_efforts_for_long_then_it_begins_anew(paper_arm, paper_gains, observed, observer):
    run, whole = observed(observer)
    effort = run.effort.copy()
    effort[1000:1500, 1] = np.nan
    (found,) = answers(replace(run, effort=effort), paper_arm, paper_gains, observer)
    assert found.events == [] and np.isfinite(found.state.position).all()
    assert np.all(np.abs(found.fault.estimate) <= found.fault.bound)
    np.testing.assert_allclose(found.fault.bound[-1], whole.fault.bound[-1], rtol=0.5)


def with_gap(run):
    """A run whose samples around 3 s are missing for longer than max_gap; which are left."""
    kept = np.abs(run.time - 3.0) > 0.06
    names = 'time', 'measured', 'measured_velocity', 'effort'
    return replace(run, **{name: getattr(run, name)[kept] for name in names}), kept


def test_given_a_fault_that_begins_in_a_long_gap_then_bounds_hold_it(
    paper_arm, paper_gains, observed
):
    """The angles go on by the encoders' increments, and the observer's set knows nothing of it."""
    run, _ = observed('uio', faults=(Fault('link2_angle', 'bias', 3.0, size=0.5),))
    left, kept = with_gap(run)
    (found,) = answers(left, paper_arm, paper_gains, 'tightest')
    wrong = np.abs(found.fault.estimate - run.fault[kept])
    assert np.all(wrong <= found.fault.bound)


def test_given_an_alarm_before_a_long_gap_then_the_observer_tells_more_than_the_horizon_again(
    paper_arm, paper_gains, observed
):
    run, _ = observed('uio', duration=26.0, faults=(Fault('link2_angle', 'bias', 1.0, size=0.3),))
    left, _ = with_gap(run)
    horizon, both = (
        answers(left, paper_arm, paper_gains, observer)[0].fault.bound[-1]
        for observer in ('horizon', 'tightest')
    )
    assert np.any(both < horizon)


def test_given_constant_friction_then_it_is_known_and_bounded(paper_arm, paper_gains, observed):
    arm = with_joints(paper_arm, friction={'offset': 10.0})
    pytest.raises(ConfigError, UnknownInputObserver, arm, paper_gains).match('gains.arm_sha256')
    (_, found), (_, usual) = observed('uio', arm), observed('uio')
    assert found.events == []
    assert np.all(np.abs(found.fault.estimate[500:]) <= 0.5 * found.fault.bound[500:])
    # After 0.5 s; later, dead reckoning limits both.
    assert np.all(found.fault.bound[250] > 1.05 * usual.fault.bound[250])


@pytest.mark.parametrize('joint', [
    {'torque_tolerance': TorqueTolerance(torque=(0.0,))},
    {'torque_tolerance': TorqueTolerance(torque=(15.0,))}, {'effort_delay': 0.05}, None,
])  # fmt: skip
def test_given_efforts_called_inexact_then_nothing_is_certified(paper_arm, paper_gains, joint):
    arm = with_joints(paper_arm, **(joint or {}))
    arm = replace(arm, effort_bandwidth=math.inf if joint else 5.0)
    gains = replace(paper_gains, arm_sha256=planar_model(arm).sha256())
    assert UnknownInputObserver(arm, gains).certifies == (arm == paper_arm)


def test_given_links_rotors_and_payload_of_the_file_then_their_torque_is_bounded(paper_arm):
    """By masses, their places along and beside the links, and inertias."""
    uncertainty = replace(paper_arm.uncertainty, payload=0.5)
    described = with_joints(replace(paper_arm, uncertainty=uncertainty), rotor_inertia=0.5)
    chain, arm = compile_chain(described), planar_model(described)
    sizes, quiet = healthy.parameter_set(described, chain), replace(arm, velocity_noise=0.0)
    known = healthy_arm(replace(quiet, disturbance_mean=0.0))
    rng, largest, nominal = np.random.default_rng(2), 0.0, SerialModel(chain)
    payload, angles = healthy.payload_generator(sizes, 0.5), JointMap(arm)
    for _ in range(300):
        shares = rng.choice([-1.0, 1.0], generator_count(sizes))
        shares[payload:][: healthy.PAYLOAD_PARTS] *= shares[payload] > 0.0  # places of its mass
        q, v, a = rng.uniform(-2.0, 2.0, (3, 2))
        true = SerialModel(healthy.member(chain, sizes, shares))
        missed = true.inverse_dynamics(q, v, a) - nominal.inverse_dynamics(q, v, a)
        missed = angles.absolute_torque(missed)
        driven = np.tile(angles.absolute_velocity(a), (2, 1))
        motion = new_record(MOTION, rate=angles.absolute_velocity(v), driven=driven)
        set_pose(motion.pose, angles.absolute_position(q))
        most = np.zeros(2)
        unknown_torque(known, motion, most)
        assert np.all(np.abs(missed) <= most)
        largest = max(largest, (np.abs(missed) / most).max())
    assert largest > 0.8


@pytest.mark.parametrize('share', [-0.3, 0.3])
@pytest.mark.parametrize('viscous', [(0.0, 0.0), (-4.0, 1.0)])  # it may fall with speed
def test_given_slopes_and_load_then_the_error_of_friction_is_bounded(paper_model, share, viscous):
    errors = {'coulomb': (5.0, 2.0), 'load': (0.2, 0.5), 'viscous': viscous}
    none = dict.fromkeys(errors, (0.0, 0.0))
    arm = replace(paper_model, coulomb_slope=(10.0, 1000.0), velocity_noise=0.0, **errors)
    by = {'coulomb': 1.0 + share, 'load': 1.0 + share, 'viscous': 1.0 - share}
    true = replace(arm, **{n: tuple(by[n] * v for v in errors[n]) for n in errors})
    frictionless = replace(arm, **none)
    rng, largest = np.random.default_rng(4), 0.0
    for rate, torque in zip(rng.uniform(-1.0, 1.0, (200, 2)), rng.uniform(-50.0, 50.0, (200, 2))):
        known, other = (np.array(friction(rate, torque, a.constants())) for a in (arm, true))
        carried = torque - known
        joint, load = rate - [0.0, rate[0]], np.abs([carried.sum(), carried[1]])
        lost = (np.array(arm.coulomb) + arm.load * load) * 2.0 / np.pi
        lost = lost * np.arctan(arm.coulomb_slope * joint) + arm.viscous * joint
        np.testing.assert_allclose([lost[0] - lost[1], lost[1]], known)
        motion = new_record(MOTION, rate=rate, load=np.abs([carried.sum(), carried[1]]))
        most, rest = np.zeros(2), np.zeros(2)
        unknown_torque(healthy_arm(arm), motion, most)
        unknown_torque(healthy_arm(frictionless), motion, rest)
        ratio = np.abs(other - known) / (most - rest)
        assert np.all(ratio <= 1.0)
        largest = max(largest, ratio.max())
    assert largest > 0.5


def test_given_noisy_encoders_then_angles_have_the_noise_of_their_own(paper_model, paper_gains):
    lyapunov = paper_gains.observer.lyapunov
    units = [link.unit for link in link_errors(paper_model)]
    angle = units * np.sqrt(np.linalg.inv(lyapunov)[:, 0, 0])
    for noise in (1e-4, 0.05):
        arm = replace(paper_model, position_noise=noise, arrangement='relative')
        sigma = exact_fault_sigma(arm, lyapunov)
        observer = replace(paper_gains.observer, fault_sigma=sigma)
        assert error_bound(arm, observer, 4.0).angle_noise == pytest.approx(4.0 * angle)


@pytest.mark.parametrize(('sensor', 'size'), [(0, 0.05), (1, -0.5), (0, -0.6), (1, 0.6)])
def test_given_an_offset_from_the_start_then_its_bound_holds_it(paper_arm, observed, sensor, size):
    fault, large = Fault(paper_arm.sensor_names[sensor], 'bias', 0.0, size=size), abs(size) > 0.5
    options = {'options': {} if large else {'compensation': 'off'}}
    run, found = observed('tightest', duration=5.0 if large else 4.0, faults=(fault,), **options)
    error = np.abs(found.fault.estimate - size * (np.arange(2) == sensor))
    assert np.all(error < found.fault.bound)
    if large:
        raised = [a for a in run.alarms if a.event != AlarmEvent.CLEARED]
        assert {a.sensor_index for a in raised} == {sensor}
        assert any(a.basis == 'guaranteed' for a in raised)
        np.testing.assert_array_equal(found.fault.estimate[-1], run.fault_estimate[-1])
        assert np.all(error[-1] < 0.1)


def test_given_the_tighter_observer_or_parts_then_bounds_agree(paper_arm, paper_gains, observed):
    run, tightest = observed('tightest', duration=3.0)
    others = (answers(run, paper_arm, paper_gains, name)[0] for name in ('uio', 'horizon'))
    tightest, uio, horizon = (found.fault.bound for found in (tightest, *others))
    assert np.all(np.minimum(uio, horizon) <= tightest) and np.all(tightest <= horizon)
    assert (tightest < 0.9 * horizon).any()
    fault = Fault('link1_angle', 'bias', 0.0, size=0.4, duration=4.0)
    options = {'faults': (fault,), 'options': {'compensation': 'off'}}
    run, whole = observed('tightest', duration=8.0, **options)
    assert {event.sensor for _, event in whole.events} == {'link1_angle'}
    for parts in (8, 571):
        found = answers(run, paper_arm, paper_gains, 'tightest', parts)
        assert [e for one in found for _, e in one.events] == [e for _, e in whole.events]
        for name in ('estimate', 'bound', 'threshold'):
            rows = np.concatenate([getattr(one.fault, name) for one in found])
            np.testing.assert_array_equal(rows, getattr(whole.fault, name))


def test_given_gains_then_derived_rates_certify_nothing_and_arms_fit(real_arm, paper_arm, gains_of):
    assert UnknownInputObserver(paper_arm, gains_of['paper']).certifies
    assert not UnknownInputObserver(real_arm, gains_of['real_arm']).certifies
    for make in (UnknownInputObserver, lambda a, g: SerialSensorMonitor('uio', a, gains=g)):
        with pytest.raises(ConfigError, match='gains.arm_sha256.*paper.*real_arm'):
            make(real_arm, gains_of['paper'])
        with pytest.raises(ConfigError, match='gains.arm_sha256'):
            make(replace(paper_arm, gravity=9.81), gains_of['paper'])


RECORDING = csv_stream(DATA / 'real_arm' / 'excerpt.csv')
"""An excerpt; whole recordings are in the matrix of faults."""


@pytest.mark.parametrize(('encoder', 'size'), [(0, 0.0), (0, 0.3), (1, 0.3)])
def test_given_a_recording_then_a_step_is_alarmed(real_arm, real_gains, real_model, encoder, size):
    samples = RECORDING.samples.copy()
    samples[RECORDING.index(3.0) :, 0, encoder] += size
    monitor = SerialSensorMonitor('uio', real_arm, gains=real_gains)
    answers = monitor.take_many(RECORDING.stamps, *np.moveaxis(samples, 1, 0))
    # Most of it is inside the region of the gains.
    absolute = np.pi + np.cumsum(RECORDING.samples[:, 0], axis=1)
    assert np.all(np.cos(absolute) < -np.array(real_model.cos_min), axis=1).mean() > 0.5
    assert RECORDING.duration > 4.9
    found = [alarm for _, alarm in answers.events]
    if size == 0.0:
        assert found == []
        return
    assert [a.event for a in found if a.event != AlarmEvent.UPDATED] == [AlarmEvent.RAISED]
    assert {a.sensor for a in found} == {real_arm.sensor_names[encoder]}
    onset, detected = ((t - RECORDING.stamps[0]) / 1e9 for t in (found[0].onset, found[0].detected))
    assert 2.99 < onset <= detected < 3.03
    assert found[0].size == pytest.approx(0.3, abs=0.1)
