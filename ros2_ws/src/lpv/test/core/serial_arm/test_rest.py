from dataclasses import replace
from functools import cache

import fault_injection
import numpy as np
import pytest
from fault_injection import BY_NAME, Stream, cells, derived, draw, motion_range, simulate
from serial_arms import blamed, delivered, shoulder_arm, simulated, watch, with_rates
from simulated_runs import Run
from watched import Watched

from lpv.core.serial_arm.diagnosis.stuck import Frozen
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.files import load_arm

DURATION, PERIOD = 8.0, 0.02  # [s]


def seeds(count, fast):
    """Seeds of runs; those after the first few are left to the whole suite."""
    slow = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(fast, count)]
    return [*range(fast), *slow]


def arm_named(name, sample_time, rates):
    """An arm that is shipped, or of two or three joints, with such rates."""
    arm = load_arm(name) if name in {'ur10', 'panda'} else shoulder_arm()
    joints = arm.joints[1:] if name == 'two' else arm.joints
    return with_rates(replace(arm, joints=joints), rates, sample_time=sample_time)


def moves_and_rests(rng, times, joints):
    """Joints that move from rest to rest at any time, slowly and fast: q, v, a."""
    motion = np.zeros((3, len(times), joints))
    for i in range(joints):
        place, begin = rng.uniform(-1.0, 1.0), 0.0
        while begin < times[-1]:
            span = rng.uniform(0.3, 3.0)
            way = min(span * 10.0 ** rng.uniform(-2.3, 0.2), span**2) * rng.integers(0, 2)
            way *= -1.0 if place > 0.0 else 1.0
            now = (times >= begin) & (times < begin + span)
            share, rate, bend = fault_injection.minimum_jerk((times[now] - begin) / span)
            motion[0, now, i] = place + way * share
            motion[1, now, i], motion[2, now, i] = way / span * rate, way / span**2 * bend
            place, begin = place + way, begin + span
    return motion


def rounded_samples(arm, seed, step, frozen=None, resting=None, error=0.0):
    """A run of a plant that is not quite the model."""
    rng, period = np.random.default_rng(seed), arm.sample_time
    times, n = np.arange(round(DURATION / period)) * period, len(arm.joints)
    q, v, a = moves_and_rests(rng, times, n)
    if frozen is not None:
        q[:, frozen], v[:, frozen] = np.sin(2.0 * times), 2.0 * np.cos(2.0 * times)
        a[:, frozen] = -4.0 * np.sin(2.0 * times)
    if resting is not None:  # from 3 s on
        x = np.pi / 3.0 * np.minimum(times, 3.0)
        q[:, resting], v[:, resting] = np.cos(x) / 3.0, -np.pi / 9.0 * np.sin(x)
        a[:, resting] = -(np.pi**2) / 27.0 * np.cos(x) * (times < 3.0)
    model = SerialModel(fault_injection.wrong_chain(arm, np.random.default_rng(seed)))
    effort = model.torque(q, v, a)
    reading = q + (seed % 2) * 1e-4 * rng.normal(size=q.shape)
    if frozen is not None:
        reading[times > 6.4, frozen] = reading[np.argmax(times > 6.4), frozen]
    if resting is not None:
        reading[:, resting] += error
    reading = np.round(reading / step) * step
    rate = v + 5e-3 * rng.normal(size=v.shape)
    gains = np.array([joint.torque_gain for joint in arm.joints])
    return delivered(arm, np.stack([reading, rate, effort / gains], 1))


@pytest.mark.parametrize('seed', seeds(2, fast=1))
@pytest.mark.parametrize('step', [1e-4, 1e-3])
@pytest.mark.parametrize('sample_time', [0.01, pytest.param(0.002, marks=pytest.mark.slow)])
@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('name', ['ur10', 'panda', 'three', 'two'])
def test_given_rounded_readings_when_at_rest_then_all_is_well(name, rates, sample_time, step, seed):
    arm = arm_named(name, sample_time, rates)
    assert watch(arm, rounded_samples(arm, seed, step)).alarms == []


@pytest.mark.slow
@pytest.mark.parametrize('step', [1e-4, 1e-3])
@pytest.mark.parametrize('sample_time', [0.01, 0.002])
@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_rounded_reading_when_it_freezes_then_it_is_named(rates, sample_time, step):
    arm = arm_named('three', sample_time, rates)
    for seed in range(2):
        found = blamed(watch(arm, rounded_samples(arm, seed, step, frozen=2)))
        assert ('encoder3', 'stuck') in found, seed
        assert not {one for one in found if one[1] == 'stuck'} - {('encoder3', 'stuck')}


def followed(seed, step, error):
    """The sensor of a joint that rests, with such an error over time; alarms, faults at the end."""
    arm, joint = arm_named('three', 0.01, 'derived'), seed % 3
    times = np.arange(round(DURATION / arm.sample_time)) * arm.sample_time
    monitor = watch(arm, rounded_samples(arm, seed, step, resting=joint, error=error(times)))
    return arm.sensor_names[joint], set(blamed(monitor)), monitor.faults()[0]


@pytest.mark.parametrize('step', [1e-4, 1e-3])
@pytest.mark.parametrize('seed', seeds(4, fast=1))
def test_given_noise_that_ends_while_its_joint_rests_when_named_then_nothing_is_frozen(seed, step):
    noise = 0.02 * np.random.default_rng(seed).normal(size=round(DURATION / 0.01))
    sensor, found, faults = followed(seed, step, lambda t: noise * ((t > 3.5) & (t < 6.0)))
    assert {name for name, _ in found} == {sensor}
    assert 'stuck' not in {kind for _, kind in found}
    assert np.abs(faults).max() < 0.1


def test_given_a_noisy_reading_when_its_rate_is_derived_then_balances_take_calm_ones():
    noise = 0.02 * np.random.default_rng(0).normal(size=round(DURATION / 0.01))
    noise[:350] = 0.0
    arm = arm_named('three', 0.01, 'derived')
    sampler = watch(arm, rounded_samples(arm, 0, 1e-4, resting=0, error=noise)).sampler
    assert sampler.noisy[0] == 1
    rates = sampler.blocks[sampler.blocks[:, 9] > 4.0, 3]
    # Differences of neighbouring readings have 0.02 sqrt(2) / 0.01 s, those over 50 ms a fifth.
    assert rates.std() == pytest.approx(0.02 * np.sqrt(2.0) / 0.05, rel=0.2)


@pytest.mark.parametrize('size', [0.02, 0.1])
@pytest.mark.parametrize('seed', seeds(4, fast=2))
def test_given_a_reading_at_rest_when_it_jumps_then_it_is_biased_and_did_not_freeze(seed, size):
    sensor, found, faults = followed(seed, 1e-4, lambda t: size * (t > 5.0))
    assert found == {(sensor, 'bias')}
    assert np.sort(np.abs(faults)) == pytest.approx([0.0, 0.0, size], abs=0.05)


def held_by_friction(arm, seed, rest=12.0, most=1.0, moves=2):
    """Moves of 3 s, and rests in which friction is anything up to so many times Coulomb's."""
    rng, n = np.random.default_rng(seed), len(arm.joints)
    times = np.arange(round((3.0 + rest) / arm.sample_time)) * arm.sample_time
    x, place = np.clip(times / 3.0, 0.0, 1.0)[:, None], np.zeros(n)
    chain = fault_injection.wrong_chain(arm, rng)
    model, rows, (share, rate, bend) = SerialModel(chain), [], fault_injection.minimum_jerk(x)
    gains = np.array([joint.torque_gain for joint in arm.joints])
    for _ in range(moves):
        way = rng.uniform(-1.0, 1.0, n) - place
        q, v, a = place + way * share, way / 3.0 * rate, way / 9.0 * bend
        held = most * rng.uniform(-1.0, 1.0, n) * chain.friction[:, 1] * (x == 1.0)
        rows.append(np.stack([q, v, (model.torque(q, v, a) + held) / gains], axis=1))
        place = q[-1]
    samples = np.concatenate(rows)
    samples[:, 0] += 1e-4 * rng.normal(size=samples[:, 0].shape)
    samples[:, 1] += 5e-3 * rng.normal(size=samples[:, 0].shape)
    return delivered(arm, samples)


@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('seed', seeds(2, fast=1))
def test_given_friction_that_holds_joints_for_long_when_healthy_then_bounds_hold(seed, rates):
    arm = arm_named('ur10', 0.01, rates)
    run, monitor = held_by_friction(arm, seed), Watched(arm)
    for part in range(0, len(run.stamps), 100):
        monitor.take(run.stamps[part : part + 100], run.samples[part : part + 100])
        fault, sigma = monitor.faults()
        assert (np.abs(fault) < 4.0 * sigma).all()
        assert monitor.guarantee is None or not monitor.guarantee.exceeded.any()
    assert blamed(monitor) == []


@pytest.mark.slow
@pytest.mark.parametrize('seed', [4, 13])
def test_given_friction_beyond_the_files_when_joints_rest_then_no_encoder_is_blamed(seed):
    arm = arm_named('ur10', 0.01, 'derived')
    assert blamed(watch(arm, held_by_friction(arm, seed, rest=4.0, most=1.8, moves=4))) == []


@pytest.mark.parametrize(('name', 'seed'), [('panda', 508), ('ur10', 510)])
def test_given_friction_beyond_the_files_when_all_joints_stop_then_it_is_no_load(name, seed):
    arm = arm_named(name, 0.01, 'derived')
    monitor = watch(arm, held_by_friction(arm, seed, rest=4.0, most=1.8, moves=1))
    assert [alarm.kind for alarm in monitor.alarms] == []


def stopped(arm, seed, step, moment=10.0, rest=10.0):
    """An arm that brakes stop within 0.15 s; its drives give nothing, and then their hold."""
    motion = [np.broadcast_to(one, len(arm.joints)) for one in motion_range(arm, 0.4)]
    run = simulate(arm, motion, seed, pauses=True, duration=moment + rest + 8.0)
    time, samples = (run.stamps - run.stamps[0]) * 1e-9, run.samples.copy()
    begin = int(np.argmax(time >= moment))
    braked, later = (time - moment).clip(0.0, 0.15)[:, None], time >= moment + rest
    q, v = samples[begin, :2]
    after = time >= moment
    samples[after, 0] = (q + v * braked * (1.0 - braked / 0.3))[after]
    samples[after, 1] = (v * (1.0 - braked / 0.15))[after]
    model = SerialModel(fault_injection.wrong_chain(arm, np.random.default_rng([7, seed])))
    held = model.torque(samples[-1, 0], 0.0 * q, 0.0 * q)
    samples[after, 2] = np.where(later[after, None], held, 0.0)
    if step:
        samples[:, 0] = step * np.round(samples[:, 0] / step)
    return derived(Stream(run.stamps, samples))


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'step'), [(1, 2.0 * np.pi / 2**16), (5, 0.0)])
def test_given_brakes_that_stop_the_arm_when_drives_are_off_then_no_encoder_is_blamed(seed, step):
    """Readings lose their noise, and efforts do not hold the weight for as long as the horizon."""
    assert blamed(watch(shoulder_arm(), stopped(shoulder_arm(), seed, step))) == []


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 4])
@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('kind', ['healthy', 'gaps', 'stamps off'])
def test_statistic_of_a_healthy_arm_stays_below_what_its_mean_allows(rates, kind, seed):
    # E[M] is at most the number of decisions: P(M >= 1000 t) <= 1/1000 at the last one.
    arm, rng = shoulder_arm(rates), np.random.default_rng(seed)
    run = Stream(*simulated(arm, seed=seed, duration=12.0)[:2])
    run = fault_injection.disturb(run, BY_NAME[kind], rates == 'derived', rng)
    monitor, largest, decisions = Watched(arm), -np.inf, 0
    for part in range(0, len(run.stamps), 25):
        monitor.take(run.stamps[part : part + 25], run.samples[part : part + 25])
        largest, decisions = max(largest, monitor.statistic), decisions + 1
    assert largest < np.log(1000.0 * decisions)


@cache
def monitored(seed, jitter):
    """The monitor of an arm at 50 Hz that pauses, after 20 s with readings off their stamps."""
    arm = replace(fault_injection.shoulder_arm(quantization=1e-4), sample_time=PERIOD)
    healthy = simulate(arm, motion_range(arm, 0.5), seed, pauses=True)
    time, rng = healthy.stamps * 1e-9, np.random.default_rng(seed)
    taken = time + jitter * PERIOD * rng.normal(size=len(time))
    stream = derived(replace(healthy, samples=fault_injection.read_at(healthy, taken)))
    return watch(arm, Run(1 + stream.stamps, stream.samples, None))


@pytest.mark.parametrize('jitter', [0.0, 0.2])
def test_given_stamps_that_scatter_when_the_arm_moves_then_their_error_is_learned(jitter):
    learned = [np.sqrt(monitored(k, jitter).sampler.state['jitter'][0]) / PERIOD for k in range(4)]
    assert np.median(learned) == pytest.approx(jitter, abs=0.05)


@pytest.mark.parametrize('seed', seeds(10, fast=4))
def test_given_stamps_that_scatter_when_encoders_are_healthy_then_none_is_blamed(seed):
    assert blamed(monitored(seed, 0.2)) == []


def test_given_a_joint_that_rests_when_another_drifts_then_its_motion_explains_no_more_than_all():
    """The evidence of a reading that is frozen is at most what the balances leave at all."""
    (cell,) = cells(['pausing'], [False], ['derived'], [BY_NAME['drift 0.1']])
    subject, window, _ = draw(cell, 2, 1)
    monitor, stream = Watched(subject.arm), window.stream.part(0.0, 6.6)
    monitor.take(stream.stamps, stream.samples)
    (rests,) = np.flatnonzero(np.ptp(stream.samples[:, 0], axis=0) < 1e-3)
    frozen = Frozen(0.0, 0.0, 1.0, alive=False, seen=False)
    found = monitor.bank.stuck({int(rests): frozen}, monitor.readings.blocks)
    estimator, null = monitor.estimator, monitor.estimator.posterior
    left, size = estimator.left_over(len(estimator))
    everything = 0.5 * (left**2 / (size**2 * null.inflation)).sum()
    assert max(one.gain for one in found) < everything


@pytest.mark.parametrize('seed', [1, 3])
def test_given_an_arm_that_rests_upright_when_one_reading_is_off_then_no_other_one_is_blamed(seed):
    """A drift that moves nothing and changes no torque may be of any size: rows are not linear."""
    (subject,) = fault_injection.subjects('paper', False)
    subject, rng = subject.with_rates('derived'), np.random.default_rng(seed)
    arm, count = subject.arm, round(6.0 / subject.arm.sample_time)
    rests = np.zeros((1, 2))
    torque = SerialModel(fault_injection.wrong_chain(arm, rng)).torque(rests, rests, rests)
    samples = np.zeros((count, 3, 2))
    samples[:, 0] = [joint.sensors.position_noise for joint in arm.joints]
    samples[:, 0] *= rng.normal(size=(count, 2))
    samples[:, 0] += np.linalg.inv(arm.joints_to_sensors()) @ [0.0, 0.3]
    samples[:, 2] = torque + 0.01 * rng.normal(size=(count, 2))
    assert not subject.answers(delivered(arm, samples)).events


@pytest.mark.parametrize(('name', 'pose'), [
    ('paper', (0.3, -0.2)), ('paper', (1.0, -0.7)), ('real_arm', (1.0, -0.7)),
])  # fmt: skip
@pytest.mark.parametrize('noise', [0.0, 0.1])
def test_given_brakes_that_hold_the_arm_from_the_start_then_no_encoder_is_blamed(name, pose, noise):
    """Drives that are off report no effort, or noise, until the arm moves."""
    arm, rng = with_rates(load_arm(name), 'derived'), np.random.default_rng(1)
    run = simulate(arm, np.array([pose, (0.3, 0.3), (0.8, 0.8)]), 1, pauses=True)
    count, scatter = round(5.0 / arm.sample_time), [j.sensors.position_noise for j in arm.joints]
    held = np.zeros((count, *run.samples.shape[1:]))
    held[:, 0] = run.samples[0, 0] + scatter * rng.normal(size=held[:, 0].shape)
    held[:, 2] = noise * rng.normal(size=held[:, 2].shape)
    samples = np.concatenate([held, run.samples[: 2 * count]])
    assert blamed(watch(arm, delivered(arm, samples))) == []


@pytest.mark.parametrize(('name', 'rates', 'joint', 'share'), [
    ('real_arm', 'derived', 0, 0.3), ('paper', 'independent', 0, -0.3),
    pytest.param('real_arm', 'independent', 0, 0.6, marks=pytest.mark.slow),
    pytest.param('paper', 'derived', 1, -0.3, marks=pytest.mark.slow),
])  # fmt: skip
def test_given_a_torque_that_stays_then_no_encoder_is_blamed(name, rates, joint, share):
    """Someone leans on the arm: from 7 s on drives give less, by a share of the usual effort."""
    (subject,) = fault_injection.subjects(name, recorded=False)
    subject, stream = subject.with_rates(rates), subject.streams(1)
    stream = derived(stream) if rates == 'derived' else stream
    samples = stream.samples.copy()
    usual = np.quantile(np.abs(samples[:, 2, joint]), 0.95)
    samples[stream.index(7.0) :, 2, joint] -= share * usual
    answers = subject.answers(replace(stream, samples=samples))
    state, fault = answers.state, answers.fault
    assert [event for _, event in answers.events if event.sensor] == []
    # Trusted bounds hold healthy sensors, and the loop gets what they read.
    outside = (np.abs(fault.estimate) > fault.bound + 1e-6).any(axis=1)
    assert not (outside & state.trustworthy).any()
    np.testing.assert_array_equal(state.compensated_position, state.measured_position)
    np.testing.assert_array_equal(state.velocity, state.measured_velocity)
