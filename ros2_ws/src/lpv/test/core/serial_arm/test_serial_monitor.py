from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from fault_injection import motion_range, simulate
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from serial_arms import blamed, shoulder_arm, simulated, watch, with_rates, without
from simulated_runs import Push, Run, simulated_run
from watched import Watched

from lpv import Fault, load_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import Uncertainty
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.core.serial_arm.diagnosis.bank import CONTACT_TIME, Bank
from lpv.core.serial_arm.diagnosis.contact import force_levers, tip_jacobians
from lpv.core.serial_arm.diagnosis.estimator import DISTRUST
from lpv.core.serial_arm.diagnosis.information import ROBUST, recent
from lpv.core.serial_arm.diagnosis.lines import BEND
from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv.core.serial_arm.diagnosis.priors import FAULT_AT_START
from lpv.core.serial_arm.diagnosis.published_rates import rate_lag
from lpv.core.serial_arm.diagnosis.sampler import CONTRARY, HIDDEN, NOISY, SPIKE, STEP, new_sampler
from lpv.core.serial_arm.diagnosis.sampling import push_sample
from lpv.core.serial_arm.dynamics.kinematics import jacobian
from lpv.core.serial_arm.dynamics.payload import with_payload

UNLOADED = Uncertainty(payload=0.0, friction=0.3)
RATES = pytest.mark.parametrize('rates', ['derived', 'independent'])


def watched(arm, *faults, **options):
    return watch(arm, simulated(arm, *faults, **options))


def named(monitor):
    return {alarm.sensor for alarm in monitor.alarms}


@RATES
@pytest.mark.parametrize('seed', [1, 2])
def test_healthy_arm_of_unknown_parameters_raises_nothing_and_its_axis_has_no_level(rates, seed):
    monitor = watched(shoulder_arm(rates), seed=seed)
    estimate = monitor.estimate()
    assert monitor.alarms == [] and np.abs(estimate.fault[1:]).max() < 0.03
    if rates == 'derived' and seed == 1:
        assert estimate.state[0] is SensorState.NOT_DIAGNOSABLE and estimate.sigma[0] > 0.4
        assert estimate.state[1:] == (SensorState.OK, SensorState.OK)


def test_given_many_unknowns_when_the_largest_is_one_of_chance_then_the_file_fits():
    arm = shoulder_arm()
    estimator = watch(arm, simulated(arm, duration=4.0)).estimator
    unknown = estimator.posterior.mean[len(arm.joints) :]
    for sigmas, fits in ((3.2, True), (5.0, False)):
        unknown[:] = 0.0
        unknown[-1] = sigmas / np.sqrt(estimator.posterior.least[-1])
        assert (estimator.misfit() < ROBUST) is fits


@pytest.mark.parametrize('joint', [1, 2])
def test_offset_from_the_start_is_named_and_measured_also_after_a_gap(joint):
    arm, sensor = shoulder_arm(), f'encoder{joint + 1}'
    run = simulated(arm, Fault(sensor, 'bias', 0.0, size=0.5))
    for one in (run, without(run, slice(2513, 2778))):
        monitor = watch(arm, one)
        assert [(a.sensor, a.kind) for a in monitor.alarms] == [(sensor, 'bias')]
        assert monitor.alarms[0].detected < 5e9 and 0.99 < monitor.alarms[0].confidence <= 1.0
        assert monitor.estimate().fault[joint] == pytest.approx(0.5, abs=0.05)


def test_given_an_offset_then_its_confidence_is_its_probability_beside_torques(monkeypatch):
    odds = 5.0  # less than its evidence against a healthy arm
    certain = odds - np.log(FAULT_AT_START)
    monkeypatch.setattr(Bank, 'offset_against_contact', lambda *_: certain)
    fault = Fault('encoder2', 'bias', 0.0, size=0.5)
    (alarm,) = watched(shoulder_arm(), fault, duration=3.0).alarms
    assert alarm.confidence == pytest.approx(1.0 / (1.0 + np.exp(-odds)))


def test_given_a_frozen_reading_then_its_confidence_is_its_probability_beside_brakes(monkeypatch):
    left = 5.0  # less than its evidence against a joint at rest

    def brakes(_, i, found):
        return max(one.gain for one in found if one.seen and one.joint == i) - left

    monkeypatch.setattr(SerialMonitor, '_brakes', brakes)
    alarm, *_ = watched(shoulder_arm(), Fault('encoder2', 'stuck', 4.0), duration=6.0).alarms
    assert alarm.kind == 'stuck'
    assert alarm.confidence == pytest.approx(1.0 - np.exp(-left))


@RATES
@pytest.mark.parametrize(('joint', 'period', 'size'), [
    (0, 0.002, 0.01), (1, 0.002, 0.01), (2, 0.002, 0.01), (1, 0.008, 0.05),
])  # fmt: skip
def test_step_is_named_as_one_more_sample_confirms_it_and_keeps_kind(rates, joint, period, size):
    arm = replace(shoulder_arm(rates), sample_time=period)
    fault = Fault(f'encoder{joint + 1}', 'bias', 2.0, size=size)
    (alarm,) = watched(arm, fault, duration=4.0).alarms
    assert (alarm.sensor, alarm.kind) == (f'encoder{joint + 1}', 'bias')
    assert alarm.detected * 1e-9 == pytest.approx(2.0 + period, abs=1e-6)
    assert alarm.size == pytest.approx(size, abs=2e-3 if size < 0.02 else 5e-3)


def low_passed(rates, share):
    """Rates of which each sample takes a share, and the rest of what it was before."""
    return lfilter([share], [1.0, share - 1.0], rates, axis=0)


def filtered(run, share=0.4):
    """What a driver makes of readings that gives low-passed differences for rates."""
    samples, period = run.samples.copy(), 1e-9 * np.diff(run.stamps)[:, None]
    samples[0, 1] = 0.0
    samples[1:, 1] = low_passed(np.diff(samples[:, 0], axis=0) / period, share)
    return run._replace(samples=samples)


def test_given_filtered_rates_when_a_reading_jumps_then_it_is_a_step_and_no_noise():
    run = simulated(shoulder_arm(), Fault('encoder2', 'bias', 2.0, size=0.02), duration=4.0)
    for share in (0.4, 1.0):
        monitor = watch(shoulder_arm(), filtered(run, share))
        assert (rate_lag(monitor.sampler) > 0.0) == (share < 1.0)
        assert [(alarm.sensor, alarm.kind) for alarm in monitor.alarms] == [('encoder2', 'bias')]
        assert monitor.estimate().fault[1] == pytest.approx(0.02, abs=0.02)


@pytest.mark.parametrize('wrong', ['wraps', 'wrong sign'])
def test_given_a_derived_rate_when_it_contradicts_its_reading_then_it_alone_is_named(wrong):
    run = simulated(shoulder_arm(), duration=7.0)
    rate = run.samples[1000:2000, 1, 1]
    rate[:] = (rate + 0.25) % 0.5 - 0.25 if wrong == 'wraps' else -rate
    monitor = watch(shoulder_arm(), run)
    found = [alarm for alarm in monitor.alarms if alarm.kind != 'contact']
    assert {(alarm.sensor, alarm.kind) for alarm in found} == {('encoder2', 'rate_bias')}
    assert found[0].detected < 2.5e9
    assert not any(rate.active for rate in monitor.rates)  # 2 s after the end
    assert np.abs(monitor.estimate().fault).max() < 0.03


@pytest.mark.parametrize(('share', 'times'), [(0.025, 1), (0.06, 2)])  # 2 Hz, 5 Hz twice
def test_given_independent_rates_that_a_driver_filters_then_encoders_are_right(share, times):
    arm, drift = shoulder_arm('independent'), Fault('encoder2', 'drift', 4.0, rate=0.2)
    for faults, named in ((), []), ((drift,), [('encoder2', 'drift')]):
        run = simulated(arm, *faults, duration=6.0)
        for _ in range(times):
            run.samples[:, 1] = low_passed(run.samples[:, 1], share)
        assert blamed(watch(arm, run)) == named


def test_given_filtered_rates_when_samples_are_missing_then_no_difference_bridges_the_gap():
    run = without(filtered(simulated(shoulder_arm(), duration=4.0)), slice(-201, -1))
    monitor = watch(shoulder_arm(), run)
    assert rate_lag(monitor.sampler) > 0.0
    assert monitor.sampler.samples[-1, 1] == pytest.approx(run.samples[-1, 1])


@pytest.mark.parametrize('periods', [2, 10])
def test_given_differences_of_a_faster_driver_then_their_noise_is_no_wrong_rate(periods):
    arm = replace(shoulder_arm(), sample_time=0.001)
    run = simulated(arm, duration=8.0)
    noisy = run.position + 1e-4 * np.random.default_rng(3).standard_normal(run.position.shape)
    rate = np.diff(noisy, axis=0, prepend=noisy[:1]) / arm.sample_time
    samples = np.stack([noisy, rate, run.samples[:, 2]], axis=1)
    published = run._replace(stamps=run.stamps[::periods], samples=samples[::periods])
    arm = replace(arm, sample_time=arm.sample_time * periods)
    assert watch(arm, published).alarms == []


def test_given_filtered_differences_of_rounded_readings_then_no_rate_is_named():
    run = simulated(shoulder_arm(), duration=6.0)
    for share, step in product((0.02, 0.1, 1.0), (1e-12, 1e-3)):
        samples = run.samples.copy()
        samples[:, 0] = np.round(samples[:, 0] / step) * step
        assert watch(shoulder_arm(), filtered(run._replace(samples=samples), share)).alarms == []


def sampled(time, readings, period, smallest, share=1.0, own=None):
    """A sampler after readings whose rates are low-passed differences, and what it found."""
    n = readings.shape[1]
    derived = np.full(n, 1.0 if own is None else 0.0)
    usual = np.full(n, 1e-4), np.full(n, smallest)
    sampler = new_sampler(derived, *usual, (40, 1, 2), 50, np.ones(n), 0.01)
    sampler.lines['limit'] = 6.5
    rates = np.diff(readings, axis=0, prepend=readings[:1]) / period
    rates = low_passed(rates, share) if own is None else own
    found = []
    for stamp, reading, rate in zip(time, readings, rates, strict=True):
        push_sample(sampler, stamp, reading, rate, np.zeros(n))
        found.append(sampler.found.copy())
    return sampler, np.array(found)


def test_given_filtered_rates_when_stamps_jitter_then_a_joint_that_turns_back_has_no_wrong_rate():
    period = 0.002
    time = period * np.arange(1, 4001)
    turns = 0.3 * np.tanh((time - 4.0) / 0.01) * np.exp(-(((time - 4.0) / 0.5) ** 2))
    readings = period * np.cumsum(np.stack([np.cos(3.0 * time), turns], axis=1), axis=0)
    jitter = 0.2 * period * np.abs(np.random.default_rng(0).standard_normal(len(time)))
    readings = np.round(readings / 5e-5) * 5e-5
    _, found = sampled(time + jitter, readings, period, 0.005, share=0.1)
    assert not (found == CONTRARY).any()


@pytest.mark.parametrize('size', [1.0, 2.5])
def test_given_noise_when_its_jumps_are_about_the_smallest_then_they_are_no_wrong_stamps(size):
    smallest, period = 0.02, 0.002
    for seed in range(40):
        rng = np.random.default_rng(seed)
        readings = 1e-5 * rng.standard_normal((120, 2))
        readings[60:, 0] += size * smallest * rng.standard_normal(60)
        sampler, found = sampled(period * np.arange(1, 121), readings, period, smallest)
        assert list(sampler.noisy) == [1, 0] and (found[60:, 0] == NOISY).sum() == 1


def test_given_wrong_stamps_when_readings_move_then_these_do_not_jump():
    period, count = 0.002, 3000
    for seed in range(3):
        rng = np.random.default_rng(seed)
        time = period * np.arange(1, count + 1)
        readings = 0.5 * np.sin(6.0 * time[:, None] + rng.uniform(0.0, 6.0, 2))
        readings += 1e-5 * rng.standard_normal(readings.shape)
        stamps = np.maximum.accumulate(time + 0.2 * period * rng.standard_normal(count))
        stamps += 1e-9 * np.arange(count)
        steps = np.maximum(np.diff(stamps, prepend=stamps[0] - period), 1e-4)
        _, found = sampled(stamps, readings, steps[:, None], 1e-3)
        assert not np.isin(found, (STEP, SPIKE, NOISY)).any()


@RATES
@pytest.mark.parametrize('part', [0.0, 0.125, 0.5, 0.875, 1.0])
def test_given_a_joint_that_stops_dead_then_its_reading_does_not_jump_but_by_more(rates, part):
    period, speed, stop = 0.002, 8.0, 60
    time, noise = period * np.arange(1, 121), np.random.default_rng(0).standard_normal((120, 2))
    way = speed * np.minimum(time, time[stop - 1] + part * period)
    own = np.stack([speed * (time <= time[stop - 1]), 0.0 * time], axis=1)
    for step in (0.0, 3.0 * speed * period):
        readings = np.stack([way + step * (time >= time[stop]), 0.0 * time], axis=1) + 1e-5 * noise
        given = own if rates == 'independent' else None
        _, found = sampled(time, readings, period, 1e-3, own=given)
        assert (found == STEP).any() == (step > 0.0)
        assert not np.isin(found, (SPIKE, HIDDEN, NOISY)).any()


@pytest.mark.parametrize('growth', [15.0, 25.0])
def test_given_a_joint_that_begins_to_shake_then_its_reading_does_not_jump_but_by_more(growth):
    period, rng = 0.002, np.random.default_rng(0)
    time = period * np.arange(1, 301)
    shaken = 8e-3 * np.clip(growth * (time - 0.4), 0.0, 1.0) * np.sin(2.0 * np.pi * 90.0 * time)
    for step in (0.0, 0.1):
        readings = np.stack([shaken + step * (time > 0.55), 5.0 * time], axis=1)
        readings += 2e-5 * rng.standard_normal(readings.shape)
        _, found = sampled(time, readings, period, 5e-3)
        assert (found == STEP).sum() == (step > 0.0)


def noisy_readings(seed):
    """Two joints in motion, their readings with noise of 1 mrad; every 2 ms."""
    noise, time = np.random.default_rng(seed).normal(size=(2, 20000)), 0.002 * np.arange(1, 20001)
    return time, (0.5 * np.sin([[3.0], [2.0]] * time) + 1e-3 * noise).T


def test_given_a_step_that_noise_of_e_hides_then_it_is_found_as_three_more_samples_confirm_it():
    time, readings = noisy_readings(0)
    began = np.arange(1000, len(time), 200)
    readings[:, 0] += 0.02 * np.searchsorted(began, np.arange(len(time)), 'right')
    found = sampled(time, readings, 0.002, 0.005)[1]
    late = (found[began[:, None] + np.arange(4), 0] == STEP).sum()
    assert late > 0.9 * len(began)
    assert (found[1000:] == STEP).sum() == (found[1000:] != 0).sum() == late


@pytest.mark.parametrize(('lost', 'found_again'), [((500,), True), (range(500, 20000, 500), False)])
def test_given_samples_lost_when_none_was_for_long_then_such_steps_are_found_again(
    lost, found_again
):
    time, readings = noisy_readings(0)
    began = np.arange(900, len(time), 200)
    readings[:, 0] += 0.02 * np.searchsorted(began, np.arange(len(time)), 'right')
    kept = np.delete(np.arange(len(time)), lost)
    found = sampled(time[kept], readings[kept], 0.002, 0.005)[1][:, 0] == STEP
    # With one of 300 samples lost so far, 6300 without one are as rare as noise beyond the limit.
    assert found[1000:6000].mean() < 0.3 / 200
    assert (found[8000:].mean() > 0.9 / 200) == found_again


@pytest.mark.parametrize('change', [10.0, -10.0])
def test_given_noise_when_joints_stop_dead_or_begin_to_move_then_their_readings_do_not_jump(change):
    time, readings = noisy_readings(1)
    began = np.arange(1000, len(time), 200) + np.linspace(0.0, 1.0, 95)
    for k, since in enumerate(np.maximum(time - 0.002 * began[:, None], 0.0)):
        readings[:, 0] += change * since * (-1) ** k
    assert not sampled(time, readings, 0.002, 0.005)[1][1000:].any()


def test_given_the_largest_accelerations_then_lines_jump_by_what_no_healthy_reading_exceeds():
    period, most, rng = 0.002, 300.0, np.random.default_rng(0)
    moving = rng.uniform(-most, most, (2000, 1)), most * rng.choice([-1.0, 1.0], (2000, 1))
    turns = np.repeat([[-most], [most]], 1000, axis=0)
    largest = []
    for acceleration in (*moving, turns):
        fine = np.repeat(acceleration, 20, axis=0)  # of samples in the middle between changes
        rate = np.cumsum(fine, axis=0) * period / 20
        readings = (np.cumsum(rate, axis=0) * period / 20)[10::20]
        sampler = new_sampler(*np.ones((3, 1)), (40, 1, 2), 50, np.ones(1), period)
        jumps = []
        for k, reading in enumerate(readings):
            push_sample(sampler, period * (k + 1), reading, np.zeros(1), np.zeros(1))
            jumps.append(abs(sampler.lines['jump'][0]))
        largest.append(max(jumps) / (most * period**2))
    assert max(largest) == pytest.approx(BEND, rel=0.02)


def test_two_steps_at_once_are_both_named():
    faults = Fault('encoder2', 'bias', 2.0, size=0.02), Fault('encoder3', 'bias', 2.0, size=-0.02)
    assert named(watched(shoulder_arm(), *faults, duration=2.5)) == {'encoder2', 'encoder3'}


def test_push_is_a_contact_and_no_fault_of_an_encoder():
    pushes = [Push(4.0, 4.6, (0.0, 25.0, 12.0)), Push(6.0, 6.3, (15.0, -20.0, 0.0))]
    monitor = watched(shoulder_arm(), pushes=pushes)
    assert {alarm.kind for alarm in monitor.alarms} == {'contact'}
    # What is around a contact is hardly learned from.
    doubted = (monitor.estimator.window.trust <= DISTRUST).sum()
    assert doubted >= round(CONTACT_TIME / monitor.plan.interval)


@pytest.mark.parametrize(('seed', 'stated'), [*product(range(1, 5), [2.0]), (1, None), (2, None)])
def test_given_a_load_that_is_picked_up_then_the_arm_is_another_one_and_bounds_hold(seed, stated):
    arm = shoulder_arm('independent', Uncertainty(payload=stated, friction=0.3))
    run = simulate(arm, motion_range(arm, 0.5), seed, pauses=True, payload=2.0)
    monitor = watch(arm, run)
    estimate = monitor.estimate()
    assert {alarm.kind for alarm in monitor.alarms} == {'load'} and not monitor.in_contact
    assert (np.abs(estimate.fault) < 4.0 * estimate.sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 2])
def test_given_a_collision_that_stays_in_contact_then_no_encoder_is_blamed(seed):
    direction = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    pushes = Push(4.0, 4.02, tuple(60.0 * direction)), Push(4.02, 7.0, tuple(6.0 * direction))
    assert named(watched(shoulder_arm(), pushes=pushes, seed=seed)) <= {''}


SHAPES = {
    'half-sine': lambda place: np.sin(np.pi * np.clip(place, 0.0, 1.0)),
    'ramp that stays': lambda place: np.clip(place, 0.0, 1.0),
    'step': lambda place: (place > 0.0) * (place < 1.0),
}


def pushed(arm, shape, seed, span, force):
    """A run with a force on the tip [N] from 3.5 s on, of such a shape and time [s]."""
    run, chain = simulated(arm, seed=seed, duration=7.0), compile_chain(arm)
    torque = np.array([jacobian(chain, q)[:3].T @ force for q in run.position])
    place = (run.stamps * 1e-9 - 3.5) / span
    run.samples[:, 2] -= SHAPES[shape](place)[:, None] * torque
    return run


@pytest.mark.slow
@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('seed', [1, 2])
def test_slow_push_or_force_on_the_tip_is_no_fault_of_an_encoder(shape, seed):
    arm, rng = shoulder_arm(), np.random.default_rng(seed)
    run = pushed(arm, shape, seed, rng.uniform(0.5, 3.0), 15.0 * rng.normal(size=3))
    assert named(watch(arm, run)) <= {''}


def test_given_a_force_on_six_joints_at_once_then_it_is_one_cause_and_no_encoder_is_blamed():
    """Six torques that each may be anything cost more than a drift of the elbow's encoder."""
    arm = with_rates(load_arm('ur10'), 'derived')
    assert named(watch(arm, pushed(arm, 'step', 44, 1.145, (9.61, 6.97, 4.90)))) <= {''}


def test_given_any_frame_of_the_base_then_levers_are_the_largest_plausible_forces_on_the_tip():
    arm, last, largest = shoulder_arm(), 10, np.array([40.0, 30.0, 8.0])
    monitor, chain = watch(arm, simulated(arm, duration=3.0)), compile_chain(arm)
    window = monitor.estimator.window
    tips = monitor.estimator.call(tip_jacobians, chain, window, last)
    poses = window.poses[recent(window, last)]
    np.testing.assert_allclose(tips, [jacobian(chain, q)[:3] for q in poses], atol=1e-12)
    levers = force_levers(tips, largest)
    effects = levers / largest
    # Such a force in any direction gives no joint more than its own largest torque.
    assert np.linalg.norm(effects, axis=1).max() == pytest.approx(1.0)
    # Its axes are independent of each other in what they do.
    together = np.einsum('kin,kjn->ij', effects, effects)
    np.testing.assert_allclose(together - np.diag(np.diag(together)), 0.0, atol=1e-9)
    turn = Rotation.from_euler('xyz', [0.4, -1.1, 2.0]).as_matrix()
    found = np.abs(force_levers(turn @ tips, largest))
    np.testing.assert_allclose(found, np.abs(levers), atol=1e-9)
    assert not force_levers(0.0 * tips, largest).any()


def named_by_jumps(arm, samples):
    """Who is named where efforts say nothing, so that jumps alone are seen."""
    stamps = round(1e9 * arm.sample_time) * np.arange(len(samples))
    return named(watch(replace(arm, effort_includes_gravity=False), Run(stamps, samples, None)))


def test_given_repeated_samples_when_an_encoder_jumps_at_one_then_it_alone_is_named():
    arm = replace(load_arm('ur10'), sample_time=0.03)
    rate = np.linspace(1.0, 2.0, 6)
    phase = rate * 0.03 * np.arange(120)[:, None] + rate
    samples = np.stack([0.5 * np.sin(phase), 0.5 * rate * np.cos(phase), 0.0 * phase], 1)
    samples[25::50] = samples[24:-1:50]
    assert named_by_jumps(arm, samples) == set()
    samples[75:, 0, 2] += 0.02
    assert named_by_jumps(arm, samples) == {arm.sensor_names[2]}
    # A joint that shakes faster than it is sampled has not jumped.
    samples = np.zeros((60, 3, 3))
    samples[:, 1, 1] = 0.4 * (-1.0) ** np.arange(60)
    arm = replace(shoulder_arm('independent'), sample_time=0.033)
    assert named_by_jumps(arm, samples) == set()


def test_spike_is_no_lasting_fault():
    arm = shoulder_arm('independent')
    run = simulated_run(arm, 3.0, seed=3)
    run.samples[1000, 0, 1] += 0.3
    monitor, unaware = watch(arm, run), Watched(arm, smallest_step=0.5)
    events = [(alarm.sensor, alarm.kind, alarm.event.name) for alarm in monitor.alarms]
    assert events == [('encoder2', 'spike', 'RAISED'), ('encoder2', 'spike', 'CLEARED')]
    assert abs(monitor.estimate().fault[1]) < 0.1
    unaware.take(run.stamps, run.samples)
    assert unaware.alarms == []  # it is smaller than what is a fault
    run.samples[800:, 0, 1] += 0.2
    assert {alarm.kind for alarm in watch(arm, run).alarms} == {'bias'}  # it is known to be faulty


def test_given_a_drift_that_just_ended_when_another_begins_then_the_rate_tells_as_soon():
    first = Fault('encoder2', 'drift', 2.0, 1.0, rate=0.1)
    faults = first, replace(first, onset=3.1, rate=0.2)
    one, other = watched(shoulder_arm('independent'), *faults, duration=3.6).alarms
    assert one.detected < 2.2e9 and other.detected < 3.3e9


def test_payload_and_viscous_friction_that_nobody_stated_are_learned_without_an_alarm():
    arm = shoulder_arm('derived', Uncertainty(friction=0.3))
    for load in (0.3, 4.0):
        monitor = watch(arm, simulated_run(arm, 10.0, plant=with_payload(compile_chain(arm), load)))
        learned = monitor.learned()
        assert monitor.alarms == [] and learned.payload == pytest.approx(load, rel=0.3)
    arm = shoulder_arm()
    chain = compile_chain(arm)
    friction = chain.friction + [[0.5, 0.0, 0.0, 0.0, 0.0]]
    monitor = watch(arm, simulated_run(arm, 10.0, plant=chain._replace(friction=friction)))
    learned = monitor.learned()
    assert monitor.alarms == []
    assert np.all(np.abs(learned.viscous - 0.8) < 4.0 * learned.sigma[1])


@pytest.mark.slow
@pytest.mark.parametrize('rate', [0.003, 0.01, 0.03])
def test_slow_ramp_is_no_arm_that_is_learned(rate):
    fault, arm = Fault('encoder2', 'drift', 0.0, rate=rate), shoulder_arm('derived', UNLOADED)
    monitor = watched(arm, fault, seed=2, duration=30.0)
    estimate = monitor.estimate()
    assert named(monitor) == {'encoder2'}
    assert abs(estimate.fault[1] - rate * 30.0) < max(0.03, 4.0 * estimate.sigma[1])
