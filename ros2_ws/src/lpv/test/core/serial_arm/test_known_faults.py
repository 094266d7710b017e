from dataclasses import replace

import numpy as np
import pytest
from fault_injection import with_joints
from serial_arms import answered, shoulder_arm, simulated, watch, with_rates, without
from simulated_runs import Push
from watched import Watched

from lpv import Fault, load_arm
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.certificate.jump_bound import jump_bound
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, SensorState
from lpv.core.serial_arm.diagnosis.fault_filter import FaultFilter


def true_rates(arm, run):
    return np.gradient(run.position, arm.sample_time, axis=0)


def averaged(values):
    """Means of 0.1 s, without those at the ends."""
    return np.convolve(values, np.ones(50) / 50, 'valid')


@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_drift_then_its_alarm_has_its_bound_and_it_goes_on_without_samples(rates):
    arm = shoulder_arm(rates)
    for seed in (1, 2):
        whole = simulated(arm, Fault('encoder2', 'drift', 3.0, rate=0.3), duration=7.0, seed=seed)
        run = without(whole, slice(2500, 2800))
        answers = answered(arm, run)
        error = answers.fault.estimate - (run.samples[:, 0] - run.position)
        assert np.abs(error[2500:]).max() < 0.06  # 0.18 rad in the gap
        assert (np.abs(error) < answers.fault.bound)[2500:].all()
        assert {event.kind for _, event in answers.events} == {'drift'}
        ((row, alarm),) = ((k, e) for k, e in answers.events if e.event is AlarmEvent.RAISED)
        known = answers.fault.estimate[row, 1], answers.fault.bound[row, 1]
        assert (alarm.size, alarm.bound) == pytest.approx(known)


@pytest.mark.parametrize(('rate', 'seed'), [(0.02, 2), (0.05, 4), (-0.05, 4)])
def test_given_a_slow_drift_then_it_is_no_scale_error_which_would_have_jumped(rate, seed):
    arm = shoulder_arm('independent')
    drift = Fault('encoder1', 'drift', 4.0, rate=rate)
    answers = answered(arm, simulated(arm, drift, duration=7.0, seed=seed))
    assert [(event.sensor, event.kind) for _, event in answers.events] == [('encoder1', 'drift')]


def test_given_a_step_when_its_reading_is_noisy_for_a_while_then_the_step_remains():
    faults = Fault('encoder1', 'bias', 3.0, size=0.3), Fault('encoder1', 'noise', 5.0, 1.0, 0.02)
    monitor = watch(shoulder_arm(), simulated(shoulder_arm(), *faults, duration=8.0))
    own = [alarm for alarm in monitor.alarms if alarm.sensor]
    assert [alarm.kind for alarm in own] == ['bias', 'noise', 'bias']
    assert [alarm.event.name for alarm in own] == ['RAISED', 'UPDATED', 'UPDATED']
    known = monitor.estimate()
    assert known.state[0] is SensorState.ERROR and known.fault[0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize('sensor', ['encoder1', 'encoder2'])
def test_given_a_rate_bias_when_it_ends_then_nothing_else_is_found_and_rates_were_right(sensor):
    arm, joint = shoulder_arm('independent'), int(sensor[-1]) - 1
    for seed in (1, 2):
        run = simulated(arm, Fault(sensor, 'rate_bias', 4.0, 3.0, 0.3), duration=9.0, seed=seed)
        answers = answered(arm, run)
        told = [(event.kind, event.event.name) for _, event in answers.events]
        assert told == [('rate_bias', 'RAISED'), ('rate_bias', 'CLEARED')]
        error = answers.state.velocity - true_rates(arm, run)
        assert abs(error[2250:3500, joint].mean()) < 0.05


@pytest.mark.parametrize('size', [0.6, -1.0, 2.0])
@pytest.mark.parametrize('arm', ['shoulder', 'ur10'])
def test_given_a_rate_bias_beyond_the_smallest_step_then_no_reading_is_blamed(arm, size):
    arm = shoulder_arm() if arm == 'shoulder' else load_arm(arm)
    arm = with_rates(arm, 'independent', sample_time=0.01)
    for joint in (1, 2):
        sensor = arm.sensor_names[joint]
        run = simulated(arm, Fault(sensor, 'rate_bias', 4.0, size=size))
        answers = answered(arm, run)
        ((_, event),) = answers.events
        assert (event.sensor, event.kind) == (sensor, 'rate_bias')
        assert event.detected < run.stamps[400] + 250_000_000
        assert (np.abs(answers.fault.estimate) <= answers.fault.bound + 1e-3).all()


@pytest.mark.parametrize('count', [3, 5, 8])
def test_given_independent_rates_when_a_reading_slips_within_samples_then_its_bound_holds(count):
    arm = shoulder_arm('independent')
    run = simulated(arm, seed=2)
    error = 0.2 * np.clip((np.arange(len(run.stamps)) - 2000.0) / count, 0.0, 1.0)
    run.samples[:, 0, 1] += error
    answers = answered(arm, run)
    assert {event.sensor for _, event in answers.events} == {'encoder2'}
    apart = np.abs(answers.fault.estimate[:, 1] - error) > answers.fault.bound[:, 1] + 1e-3
    assert (apart & answers.state.trustworthy).mean() < 0.03
    assert answers.fault.estimate[-1, 1] == pytest.approx(0.2, abs=0.03)


def test_given_a_rate_that_reads_0_then_its_reading_is_not_blamed():
    arm = replace(shoulder_arm('independent'), sample_time=0.01)
    run = simulated(arm)
    run.samples[400:, 1, 1] = 0.0
    assert {(one.sensor, one.kind) for one in watch(arm, run).alarms} == {('encoder2', 'rate_bias')}


def test_given_a_derived_rate_that_wraps_then_differences_are_published():
    arm, run = shoulder_arm(), simulated(shoulder_arm(), duration=6.0)
    rate = run.samples[1000:, 1, 1]
    rate[:] = (rate + 0.25) % 0.5 - 0.25
    error = answered(arm, run).state.velocity[:, 1] - true_rates(arm, run)[:, 1]
    assert np.abs(averaged(error[1500:])).max() < 0.05


@pytest.mark.parametrize('size', [0.25, -0.45])
def test_given_a_known_scale_error_then_published_rates_are_without_it(size):
    arm = shoulder_arm()
    wrong = []
    for seed in range(1, 5):
        run = simulated(arm, Fault('encoder2', 'scale', 3.0, size=size), duration=8.0, seed=seed)
        true = true_rates(arm, run)[2500:, 1]
        answers = answered(arm, run)
        wrong.append([
            averaged(rate[2500:, 1] - true) for rate in (run.samples[:, 1], answers.state.velocity)
        ])  # fmt: skip
        error = answers.fault.estimate - (run.samples[:, 0] - run.position)
        assert np.abs(error[2500:, 1]).max() < 0.03
    read, found = np.sqrt(np.mean(np.square(wrong), axis=(0, 2)))
    assert found < 0.4 * read


@pytest.mark.parametrize('kind', ['drift', 'scale', 'stuck'])
@pytest.mark.parametrize('apart', [0.04, -0.04])
def test_given_a_fault_when_another_moment_is_asked_for_then_less_is_known_of_it(kind, apart):
    one = FaultFilter(0, kind, 0.0, acceleration=1.0)
    one.mean, one.updated = np.array([0.2, 3.0, 400.0]), 1.0
    one.predict(1.0 + apart)
    assert np.linalg.eigvalsh(one.covariance).min() > -1e-12 and one.covariance[0, 0] > 0.0


def test_given_a_frozen_reading_when_all_others_come_to_rest_then_its_joint_may_do_so_too():
    one = FaultFilter(0, 'stuck', 0.0)
    one.mean[:2] = 0.2, 3.0
    for rests, way in ((False, 0.0), (True, 1.5), (True, 1.5), (False, 0.0)):
        one.watch_rest(rests)
        assert one.since_rest(0.5) == pytest.approx(way)
    one.watch_rest(True)
    one.stopped = 0.0
    one.watch_rest(True)
    assert one.since_rest(0.5) == 0.0  # brakes were seen


@pytest.mark.parametrize('size', [0.3, -0.5])
def test_given_an_uncertain_scale_error_then_sigma_is_that_of_draws(size):
    one, rng = FaultFilter(0, 'scale', 0.0), np.random.default_rng(1)
    one.mean, one.covariance = np.array([size, 0.1, 0.0]), np.diag([0.01, 0.01, 0.0]) ** 2
    reading, (scale, offset, _) = 1.2, rng.multivariate_normal(one.mean, one.covariance, 10000).T
    drawn = reading - (reading - offset) / (1.0 + scale)
    fault, sigma = one.fault(reading, 0.0)
    assert fault == pytest.approx(drawn.mean(), abs=0.01)
    assert sigma == pytest.approx(drawn.std(), rel=0.05)


def test_given_alarms_that_clear_at_once_when_a_frozen_reading_jumps_then_it_is_judged():
    faults = Fault('encoder2', 'stuck', 4.0, 1.015), Fault('encoder2', 'bias', 5.035, size=0.2)
    run = simulated(shoulder_arm(), *faults, duration=5.5)
    monitor = Watched(shoulder_arm(), clear_dwell=0.0)
    monitor.take(run.stamps, run.samples)
    assert any(alarm.kind == 'stuck' for alarm in monitor.alarms)


def test_given_a_known_rate_bias_when_its_readings_freeze_then_it_is_there_afterwards():
    arm = shoulder_arm('independent')
    run = simulated(arm, Fault('encoder2', 'rate_bias', 2.0, size=0.3), duration=9.0)
    run.samples[2500:3000, :2, 1] = run.samples[2499, :2, 1]
    answers = answered(arm, run)
    assert [(event.event.name, event.kind) for _, event in answers.events] == [
        ('RAISED', 'rate_bias'), ('RAISED', 'stuck'), ('CLEARED', 'stuck'),
    ]  # fmt: skip


@pytest.mark.parametrize('latch', [False, True])
def test_given_a_known_step_when_samples_return_after_a_break_then_answers_are_trusted(latch):
    arm = shoulder_arm()
    run = simulated(arm, Fault('encoder2', 'bias', 3.0, size=0.3), duration=9.0)
    stamps = np.where(run.stamps > 5_000_000_000, run.stamps + 3_000_000_000, run.stamps)
    answers = answered(arm, run._replace(stamps=stamps), latch=latch)
    assert answers.state.trustworthy[-1]
    assert [event.event.name for _, event in answers.events] == ['RAISED']


@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_fault_that_ends_while_its_readings_are_missing_then_it_is_not_corrected(rates):
    arm = shoulder_arm(rates)
    run = simulated(arm, Fault('encoder2', 'bias', 2.0, 2.05, 0.5), duration=7.0)
    run.samples[2000:2050, :2, 1] = np.nan
    answers = answered(arm, run)
    assert [(event.event.name, event.kind) for _, event in answers.events] == [
        ('RAISED', 'bias'), ('UPDATED', 'dropout'), ('CLEARED', 'bias'),
    ]  # fmt: skip
    error = answers.state.compensated_position - run.position
    assert answers.state.trustworthy[2052:].all() and np.abs(error[2052:]).max() < 0.01


def test_given_a_gap_when_samples_return_then_bounds_hold_what_may_have_begun_in_it():
    """Where all sensors had no readings, an offset is as likely as ever, and looked for anew."""
    run = simulated(shoulder_arm(), Fault('encoder2', 'bias', 8.05, size=0.3), duration=8.6)
    run = without(run, slice(4000, 4050))
    answers = answered(shoulder_arm(), run)
    error = np.abs(answers.fault.estimate - (run.samples[:, 0] - run.position))
    assert (error < answers.fault.bound)[4000:].all()
    assert answers.fault.bound[3999, 1] < 0.3  # it would not, else


@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_fault_that_begins_while_its_readings_are_missing_then_it_is_corrected(rates):
    """An incremental encoder has not counted meanwhile."""
    arm = shoulder_arm(rates)
    run = simulated(arm, Fault('encoder2', 'bias', 4.05, size=0.5), duration=7.0)
    run.samples[2000:2050, :2, 1] = np.nan
    answers = answered(arm, run)
    *_, (_, alarm) = answers.events
    assert (alarm.sensor, alarm.kind) == ('encoder2', 'bias')
    assert abs(alarm.size - 0.5) < alarm.bound < 0.2
    error = answers.state.compensated_position - run.position
    assert answers.state.trustworthy[2052:].all() and np.abs(error[2052:]).max() < 0.05


@pytest.mark.parametrize(('length', 'is_trusted'), [(50, True), (500, False)])
def test_given_a_fault_that_may_have_ended_unread_then_trust_waits_for_it(length, is_trusted):
    arm = shoulder_arm('independent')
    run = simulated(arm, Fault('encoder2', 'bias', 2.0, size=0.3), duration=9.0)
    run.samples[2000 : 2000 + length, :2, 1] = np.nan
    answers = answered(arm, run)
    assert (answers.state.trustworthy[2000 + length :][:50] == is_trusted).all()
    assert answers.state.trustworthy[-1] and answers.fault.alarm[-1, 1]


def test_given_rates_that_are_found_to_be_derived_then_the_bound_of_jumps_is_that_of_differences():
    sensors = {'velocity_noise': 0.0002, 'position_noise': 2e-4}
    said = with_joints(shoulder_arm('independent'), rotor_inertia=0.2, sensors=sensors)
    true = with_rates(said, 'derived')
    run = simulated(true, duration=1.5, seed=3)
    monitor = watch(said, run)
    assert len(monitor.misnamed) == 3
    np.testing.assert_array_equal(monitor._jump_bound, jump_bound(true))


@pytest.mark.parametrize(('rates', 'seed'), [('derived', 1), ('derived', 3), ('independent', 1)])
def test_given_a_recording_that_is_repeated_while_an_alarm_is_up_then_the_arm_stays_known(
    rates, seed
):
    """The readings became right unseen, a radian from what was taken out of them."""
    arm = shoulder_arm(rates)
    run = simulated(arm, Fault('encoder2', 'drift', 3.0, rate=0.2), duration=8.0, seed=seed)
    monitor = SerialSensorMonitor('/uio', arm)
    parts = [monitor.take_many(run.stamps + 1, *np.moveaxis(run.samples, 1, 0)) for _ in range(3)]
    for answers in parts:
        raised = [e for _, e in answers.events if e.event is AlarmEvent.RAISED]
        assert [(event.sensor, event.kind) for event in raised] == [('encoder2', 'drift')]
    for answers in parts[1:]:
        error = answers.fault.estimate - (run.samples[:, 0] - run.position)
        assert (np.abs(error[500:]) < answers.fault.bound[500:]).all(1).mean() > 0.95
    assert sum((answers.warnings for answers in parts), []) == []


def test_given_a_suspicion_when_efforts_are_lost_then_it_is_dropped():
    run = simulated(shoulder_arm(), pushes=(Push(3.0, 3.4, (0.0, 15.0, 0.0)),), duration=12.0)
    run.samples[1650:, 2] = np.nan
    inconsistent = answered(shoulder_arm(), run).inconsistent
    assert inconsistent[1600:1650].any() and not inconsistent[-1]


SECOND = np.array([0.0, 1.0, 0.0])
COURSES = {
    'slips within 5 samples': lambda y, since: 0.2 * np.clip(since / 0.01, 0.0, 1.0) * SECOND,
    'slips within 25 samples': lambda y, since: -0.3 * np.clip(since / 0.05, 0.0, 1.0) * SECOND,
    'swings': lambda y, since: 0.2 * np.sin(4.4 * np.maximum(since, 0.0)) * SECOND,
    'turns its sign': lambda y, since: -2.0 * (since > 0.0) * y * SECOND,
    'is swapped': lambda y, since: (since > 0.0) * (y[:, [0, 2, 1]] - y),
}
"""Faults of the second encoder, by readings and the time since their onset [s]."""


@pytest.mark.slow
@pytest.mark.parametrize('name', COURSES)
def test_given_a_fault_that_no_hypothesis_describes_then_its_bound_holds_or_it_is_not_trusted(name):
    arm, outside = shoulder_arm(), []
    for seed in (1, 2):
        run = simulated(arm, duration=12.0, seed=seed)
        since = arm.sample_time * np.arange(len(run.stamps))[:, None] - 4.0
        error = COURSES[name](run.position, since)
        run.samples[:, 0] += error
        run.samples[1:, 1] = np.diff(run.samples[:, 0], axis=0) / arm.sample_time
        answers = answered(arm, run)
        beyond = np.abs(answers.fault.estimate - error) > answers.fault.bound + 1e-3
        outside.append(beyond.any(axis=1) & answers.state.trustworthy)
    assert np.mean(outside) < 0.05


def test_given_a_push_then_it_is_trusted_and_bounds_of_readings_that_do_not_explain_it_stay():
    arm, push = shoulder_arm(), Push(5.0, 6.0, (20.0, 0.0, 0.0))
    pushed, free = (answered(arm, simulated(arm, pushes=one)) for one in ((push,), ()))
    assert pushed.state.trustworthy[500:].all()
    assert (pushed.fault.bound[2500:3000, 1:] < 1.5 * free.fault.bound[2500:3000, 1:]).all()


def test_given_a_gap_behind_a_scale_error_beside_an_offset_then_the_offset_is_no_part_of_it():
    arm = shoulder_arm()
    faults = Fault('encoder2', 'bias', 0.0, size=0.5), Fault('encoder2', 'scale', 4.5, size=-0.25)
    run = without(simulated(arm, *faults, seed=3, duration=5.2), slice(2266, 2415))
    answers = answered(arm, run)
    named, alarm = answers.events[-1]
    assert alarm.kind == 'scale'
    error = answers.fault.estimate - (run.samples[:, 0] - run.position)
    assert (np.abs(error) < answers.fault.bound)[named:].all()


def test_given_an_offset_larger_than_the_scale_error_beside_it_then_the_alarm_stays():
    arm = shoulder_arm()
    faults = Fault('encoder2', 'bias', 0.0, size=0.5), Fault('encoder2', 'scale', 5.0, size=-0.25)
    run = without(simulated(arm, *faults, seed=4, duration=6.8), slice(2526, 2675))
    told = [event for _, event in answered(arm, run).events if event.sensor == 'encoder2']
    assert told[-1].kind == 'scale' and told[-1].event is AlarmEvent.UPDATED
