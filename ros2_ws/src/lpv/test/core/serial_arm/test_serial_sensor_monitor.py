import os
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from fault_injection import with_joints
from scipy.signal import lfilter
from serial_arms import shoulder_arm, simulated, without

from lpv import ConfigError, DiagnosisParameters, Fault, SampleError
from lpv.core.monitoring.alarm_text import UNUSABLE
from lpv.core.monitoring.message_fields import ERROR, Report
from lpv.core.monitoring.serial_monitor import _MISNAMED, SerialSensorMonitor
from lpv.core.monitoring.stamp_gate import JUMP
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import JointLimits
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, Mode, SensorState
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.rate_independence import SAMPLES
from lpv.core.serial_arm.turns import Turns
from lpv.core.support.jit import COMPILED

ARM = shoulder_arm()
LARGE = Fault('encoder2', 'bias', 1.0, size=0.3)
HOUR, STEP = 3600 * 10**9, 2_000_000
START, FUTURE = 1_700_000_000 * 10**9, 2**31 * 10**9 - 1
RAISED = [(AlarmEvent.RAISED, 'encoder2')]


stepped = cache(lambda size, duration: simulated(ARM, replace(LARGE, size=size), duration=duration))


def recorded(size=0.05, duration=2.0):
    """Stamps, samples and true positions with a step on the second encoder after 1 s."""
    stamps, samples, position = stepped(size, duration)
    return stamps + 5, samples.copy(), position


def observe(stamps, samples, monitor=None):
    monitor = monitor or SerialSensorMonitor('/uio', ARM)
    return monitor, monitor.take_many(stamps, *np.moveaxis(samples, 1, 0))


def told(answers):
    return [(e.event, e.sensor) for _, e in answers.events]


def message(names=ARM.joint_names, **fields):
    zeros = [0.0] * len(names)
    values = {'position': zeros, 'velocity': zeros, 'effort': zeros, **fields}
    return SimpleNamespace(name=list(names), **values)


OTHER_RATE = 'measurements come at another rate than the arm file says; one in 0.0'


@pytest.mark.parametrize(('kept', 'said'), [
    (lambda k: k % 12 == 0, ['measurements are more than ten sample times']),
    (lambda k: k % 8 == 0, [OTHER_RATE]),
    # As of a bag that is played faster than a machine can follow.
    (lambda k: (k % 500 < 250) | (k % 13 < 2), ['measurements are lost']),
    (lambda k: k % 400 < 380, []),  # now and then, as of any network
    (lambda k: k % 80 < 65, ['measurements are lost']),  # so often that decisions are few
])  # fmt: skip
def test_given_rare_samples_or_bursts_with_losses_between_then_it_is_told(kept, said):
    stamps, samples, _ = recorded(duration=4.0)
    rows = kept(np.arange(len(stamps)))
    texts = [text for _, text in observe(stamps[rows], samples[rows])[1].warnings]
    assert len(texts) == len(said) and all(map(str.startswith, texts, said))


def test_given_stamps_of_two_clocks_in_turn_then_it_is_told_once_how_many_are_not_used():
    stamps, samples, _ = simulated(ARM, duration=4.0)
    stamps[1::2] += HOUR
    monitor, answers = observe(stamps, samples)
    (told,) = (text for _, text in answers.warnings)
    assert told.startswith('many measurements cannot be used; of 50') and 'fits no stream' in told
    assert told in answers.reports[1][1][0]['message']
    stamps, samples, _ = simulated(ARM, duration=4.0)
    _, answers = observe(stamps + 10 * STEP * 500, samples, monitor)  # of one clock again
    assert 'cannot be used' not in answers.reports[-1][1][0]['message']


def test_given_readings_in_degrees_then_their_unit_is_asked_for():
    stamps, samples, _ = recorded(duration=4.0)
    samples[:, :2] = np.degrees(samples[:, :2])
    _, answers = observe(stamps, samples)
    told = [text for _, text in answers.warnings if 'another unit' in text]
    assert len(told) == 1 and told[0].endswith('beyond its limits: degrees?')


def test_given_balances_that_stay_away_then_no_fault_is_confirmed_and_a_reset_ends_the_warning():
    stamps, samples, _ = simulated(ARM, duration=4.0)
    monitor, answers = observe(stamps[::12] + 5, samples[::12])
    assert not answers.state.trustworthy[-1] and told(answers) == []
    message = answers.reports[-1][1][0]['message']
    assert message.startswith('no motion could be compared with torques for 2.5 s')
    assert 'ten sample times' in message
    monitor.reset()
    _, answers = observe(stamps[-1] + 10 + stamps, samples, monitor)
    assert answers.warnings == [] and len(answers.reports) > 2
    assert not any('ten sample times' in str(statuses) for _, statuses in answers.reports)


def test_given_reports_when_the_monitor_goes_on_then_they_say_what_was_and_only_if_asked(
    monkeypatch,
):
    stamps, samples, _ = simulated(ARM, duration=4.0)
    monitor, answers = observe(stamps, samples)
    said = answers.reports
    monitor.rejected += 1
    observe(stamps + stamps[-1], np.full_like(samples, np.nan), monitor)
    assert len(said) > 2 and answers.reports == said
    monkeypatch.setattr(Report, 'statuses', Mock(side_effect=ValueError))
    _, answers = observe(stamps, samples)  # no text is made that nobody reads
    with pytest.raises(ValueError):
        answers.reports  # noqa: B018


def test_given_samples_that_are_lost_repeated_or_no_numbers_then_each_is_counted():
    """Their answers do not depend on the parts they come in: `test_any_data`."""
    stamps, samples, _ = recorded()
    samples[100, 0, 1] = samples[150, 1, 0] = np.nan
    samples[700:800, 2] = np.nan
    stamps[200] = stamps[199]
    stamps[300] -= 50_000_000
    stamps[400:] += 100_000_000
    stamps[900:] -= 3_000_000_000
    spoils = {'duplicates', 'out_of_order', 'not_finite', 'gaps', 'without_effort', 'restarts'}
    spoils |= {'refused_stamps'}
    for data, expected in ((recorded()[:2], set()), ((stamps, samples), spoils)):
        monitor, answers = observe(*data)
        assert np.isfinite(answers.state.position).all() and np.isfinite(answers.fault.bound).all()
        assert {name for name, count in vars(monitor.counters).items() if count} == expected


def test_given_readings_that_end_when_reported_then_it_is_said_why_none_can_be_used():
    stamps, samples, _ = recorded()
    samples[500:, 0] = np.nan
    _, answers = observe(stamps, samples)
    row, (status, *_) = answers.reports[-1]
    assert row > 500
    assert re.fullmatch(rf'{UNUSABLE}: \d+ measurements with NaN .*', status['message'])


@pytest.mark.parametrize(('rates', 'meanwhile', 'parts'), [
    ('derived', 1.0, 3), ('derived', 0.0, 3), ('derived', np.nan, 3),
    ('independent', 1.0, 3), ('independent', 1.0, 2),  # efforts go on
])  # fmt: skip
def test_given_a_driver_that_repeats_itself_then_no_sensor_is_blamed(rates, meanwhile, parts):
    arm = shoulder_arm(rates)
    stamps, samples, _ = simulated(arm, duration=4.0)
    samples[1000:1050, :parts] = samples[999, :parts]
    samples[1000:1050, 1] *= meanwhile
    stamps[1500:] -= 500_000_000
    monitor, answers = observe(stamps, samples, SerialSensorMonitor('/uio', arm))
    assert told(answers) == [] and monitor.counters.repeated > 40
    assert set(answers.state.mode[1010:1050]) == {Mode.STALE}
    assert monitor.counters.out_of_order == 249


@pytest.mark.parametrize('law', ['braked', 'rounded', 'noisy'])
def test_given_an_arm_that_comes_to_rest_then_its_driver_does_not_repeat_itself(law):
    stamps, step = STEP * (1 + np.arange(2500)), STEP * 1e-9
    time = step * np.arange(2500) % 1.25
    rate = np.clip(time / 0.1, 0.0, 1.0) * np.clip((0.75 - time) / 0.06, 0.0, 1.0)
    samples = np.full((2500, 3, len(ARM.joints)), np.nan)
    samples[:, 0] = step * np.cumsum(rate)[:, None] * [0.4, -0.7, 1.0]
    samples[:, 2] = [3.0, 1.0, 0.2] + samples[:, 0] + 2.0 * np.gradient(rate)[:, None]
    if law != 'braked':
        noise = 2e-5 * np.random.default_rng(3).normal(size=samples[:, 0].shape)
        samples[:, 0] = 1e-4 * np.round((samples[:, 0] + noise * (law == 'noisy')) / 1e-4)
        samples[:, 2] = 0.01 * np.round(samples[:, 2] / 0.01)
    monitor, answers = observe(stamps, samples)
    assert monitor.counters.repeated == 0 and answers.state.trustworthy[10:].all()


def test_given_a_step_when_found_then_the_alarm_names_it_and_its_reading_is_corrected():
    stamps, samples, position = recorded()
    _, answers = observe(stamps, samples)
    assert told(answers) == RAISED
    row, event = answers.events[0]
    assert event.detected == stamps[row] < stamps[500] + 20_000_000
    assert (event.kind, event.size) == ('bias', pytest.approx(0.05, abs=2e-3))
    assert list(answers.fault.alarm[row]) == [False, True, False]
    assert (answers.fault.state[:row, 1] != SensorState.ERROR).all()
    error = answers.state.compensated_position - position
    assert np.abs(error).max() < 5e-3  # carried on by its rate until the jump is known
    assert answers.state.trustworthy.all()
    observer, *sensors = answers.reports[-1][1]
    assert observer['values']['corrected joints'] == 'joint2'
    assert observer['values']['bounds'] == 'statistical, 4 standard deviations'
    assert [status['message'] for status in sensors][1] == 'fault confirmed'


@pytest.mark.parametrize('lacking', ['all', 'weight'])
def test_given_no_efforts_or_none_of_the_weight_then_no_offsets_are_diagnosable(lacking):
    stamps, samples, position = recorded()
    arm, said = ARM, 'no efforts: '
    if lacking == 'all':
        samples[:, 2] = np.nan
    else:
        arm, said = replace(ARM, effort_includes_gravity=False), 'leave out the weight'
        model = SerialModel(compile_chain(arm))
        samples[:, 2] -= model.gravity(position)
    _, answers = observe(stamps, samples, SerialSensorMonitor('/uio', arm))
    assert told(answers) == RAISED  # jumps are found
    assert np.abs(answers.fault.estimate[:400]).max() < 0.01
    assert set(answers.state.mode) == {Mode.HOLDING}
    assert (answers.fault.state[:400] == SensorState.NOT_DIAGNOSABLE).all()
    assert said in answers.reports[0][1][0]['message']


@pytest.mark.parametrize(('fault', 'named', 'said'), [
    (Fault('encoder2', 'stuck', 2.0), [('encoder2', 'stuck')], 'leave out the weight'),
    (Fault('encoder2', 'drift', 2.0, rate=0.3), [], 'encoder2:drift, encoder2:rate_bias'),
])  # fmt: skip
def test_given_no_efforts_of_the_weight_then_rates_contradict_readings(fault, named, said):
    arm = replace(shoulder_arm('independent'), effort_includes_gravity=False)
    run = simulated(arm, fault, duration=4.0)
    _, answers = observe(run.stamps + 5, run.samples, SerialSensorMonitor('/uio', arm))
    assert [(event.sensor, event.kind) for _, event in answers.events] == named
    assert said in answers.reports[-1][1][0]['message']


@pytest.mark.parametrize(('joint', 'span', 'effort'), [
    (2, (0.0, 9.0), np.nan), (2, (2.0, 4.5), -1e300), (0, (0.0, 9.0), np.inf),
    (1, (0.002, 9.0), 0.0),  # as of a drive that measures none, from where others do
])  # fmt: skip
@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_joint_without_efforts_then_faults_are_found(rates, joint, span, effort):
    arm, said = shoulder_arm(rates), f'no efforts of {ARM.joint_names[joint]}: '
    run = simulated(arm, Fault('encoder2', 'drift', 3.0, rate=0.2), duration=6.0)
    begin, end = (round(moment / arm.sample_time) for moment in span)
    run.samples[begin:end, 2, joint] = effort
    monitor, answers = observe(run.stamps + 5, run.samples, SerialSensorMonitor('/uio', arm))
    assert told(answers) == RAISED and answers.state.trustworthy.all()
    assert set(answers.state.mode) == {Mode.INITIALISING, Mode.OBSERVING}
    waited = 0 if effort else round(0.05 / arm.sample_time)  # for one that is not 0
    assert monitor.counters.without_effort == min(end, 3000) - begin - waited
    messages = [statuses[0]['message'] for _, statuses in answers.reports]
    assert sum(map(str.startswith, messages, [said] * len(messages))) > 1
    assert messages[-1].startswith(said) == (end > 3000)
    (warned,) = (text for _, text in answers.warnings if text.startswith('no efforts'))
    assert warned.startswith(said)


@pytest.mark.parametrize(('ratio', 'lost', 'told'), [
    (1.0, 0.0, 0), (1.0, 0.6, 0), (4.0, 0.0, 1), (0.25, 0.0, 1),
])  # fmt: skip
def test_given_a_file_of_another_sample_time_when_observed_then_it_is_said_once(ratio, lost, told):
    run, arm = simulated(ARM, duration=12.0), replace(ARM, sample_time=ARM.sample_time / ratio)
    kept = np.random.default_rng(1).random(len(run.stamps)) >= lost
    monitor = SerialSensorMonitor('/uio', arm)
    _, answers = observe(run.stamps[kept] + 5, run.samples[kept], monitor)
    said = [text for _, text in answers.warnings if 'at another rate' in text]
    assert len(said) == told
    assert all(f'sample_time is {arm.sample_time:.3g} s' in text for text in said)


@pytest.mark.parametrize('missing', [0, slice(None)])
def test_given_efforts_that_are_missing_now_and_then_then_no_sample_is_lost(missing):
    stamps, samples, _ = recorded(duration=4.0)
    samples[50::100, 2, missing] = np.nan
    monitor, answers = observe(stamps, samples)
    assert told(answers) == RAISED and monitor.counters.without_effort == 20
    assert Mode.STALE not in answers.state.mode and monitor.decisions > 70


@pytest.mark.parametrize('zero', [0.0, -5e-324])
def test_given_efforts_that_are_always_0_when_the_arm_moves_then_there_are_none(zero):
    """As of drivers that measure none; before the arm moves, brakes may hold it."""
    run = simulated(ARM, duration=8.0)
    stamps, samples = run.stamps + 5, run.samples
    samples[:2000, 2] = zero
    monitor, answers = observe(stamps[:2000], samples[:2000])
    ((_, warned),) = answers.warnings
    assert told(answers) == [] and warned.startswith('no efforts')
    assert answers.state.mode[-1] == Mode.HOLDING
    assert (answers.fault.state[-1] == SensorState.NOT_DIAGNOSABLE).all()
    # Efforts that come at last are used.
    _, answers = observe(stamps[2000:], samples[2000:], monitor)
    assert answers.state.mode[-1] == Mode.OBSERVING and told(answers) == []


@pytest.mark.parametrize('rate', [0.0, np.nan])
def test_given_rates_that_are_always_0_when_the_arm_moves_then_readings_give_them(rate):
    """As of drivers that fill in what they do not measure."""
    run = simulated(ARM, Fault('encoder2', 'drift', 2.0, rate=0.1), duration=4.0)
    run.samples[:, 1] = rate
    monitor, answers = observe(run.stamps + 5, run.samples)
    assert told(answers) == RAISED and monitor.counters.not_finite == 0


@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize(('begin', 'count', 'values'), [
    (0, 100, (0.0, 0.0, 0.0)), (0, 100, (np.nan, np.nan, np.nan)),
    (0, 50, (0.0, 0.0, np.nan)),  # of an interface that is missing
    (0, 100, (np.nan, 0.0, 3.0)),  # efforts come from elsewhere
    *((600, count, (0.0, 0.0, 0.0)) for count in (1, 5, 100, 700)),  # the driver connects again
    (600, 100, (0.0, 0.0, 3.0)), (600, 100, (0.0, -20.0, 0.0)),  # rates are differences
])  # fmt: skip
def test_given_a_driver_that_has_read_nothing_then_no_sensor_failed(begin, count, values, rates):
    arm = shoulder_arm(rates)
    run = simulated(arm, duration=3.0)
    samples, stamps = run.samples.copy(), run.stamps + 5
    samples[begin : begin + count] = np.array(values)[:, None]
    stamps[600:] += 5 * JUMP * (count == 700)  # silence comes first
    monitor, answers = observe(stamps, samples, SerialSensorMonitor('/uio', arm))
    counters = monitor.counters
    assert told(answers) == [] and counters.unread + counters.refused_stamps == count
    assert answers.state.mode[-1] == Mode.OBSERVING and answers.state.trustworthy[-1]


def test_given_readings_of_0_that_joints_may_have_then_they_are_read():
    """A sensor fails, an arm was taken to zero in a silence, another comes to rest there."""
    run = simulated(ARM, duration=3.0)
    stamps, samples = run.stamps + 5, run.samples.copy()
    failed = samples.copy()
    failed[700:, :, 1] = 0.0
    monitor, answers = observe(stamps, failed)
    assert monitor.counters.unread == 0 and told(answers)[0] == RAISED[0]
    stamps[700:] += 5 * JUMP
    samples[700:, :2] = 0.0
    monitor, answers = observe(stamps, samples)
    assert monitor.counters.unread == 0 and answers.state.measured_position[-1].any() == 0.0
    fade = np.maximum(0.0, 1.0 - np.arange(1500) / 700.0)[:, None]
    path = np.stack([fade * [0.5, -0.4, 0.3], np.gradient(fade, 2e-3, axis=0) * [0.5, -0.4, 0.3],
                     0.0 * fade + [0.0, 4.0, 2.0]], axis=1)  # fmt: skip
    monitor, _ = observe(run.stamps + 5, path)
    assert monitor.counters.unread == 0 and (path[700:, 0] == 0.0).all()


def test_given_no_rates_then_they_are_differences_and_independent_ones_are_waited_for():
    stamps, samples, _ = recorded()
    samples[:, 1] = np.nan
    _, answers = observe(stamps, samples)
    assert answers.state.mode[0] == Mode.NO_ESTIMATE and not answers.has_fault[0]
    expected = np.diff(samples[:, 0], axis=0) / np.diff(stamps)[:, None] * 1e9
    np.testing.assert_allclose(answers.state.measured_velocity[1:], expected, atol=1e-9)
    assert told(answers) == RAISED
    monitor = SerialSensorMonitor('/uio', shoulder_arm('independent'))
    record = monitor.take(1, message(position=[0.1] * 3, velocity=[])).record
    assert record['state']['mode'] == Mode.NO_ESTIMATE and not record['state']['trustworthy']
    assert not record['has_fault'] and monitor.counters.not_finite == 1


def test_given_messages_or_gains_when_taken_then_names_decide_or_misfits_are_refused(paper_gains):
    monitor = SerialSensorMonitor('/uio', ARM)
    names = ('gripper', 'joint3', 'joint1', 'joint2')
    record = monitor.take(1, message(names, position=[9.0, 0.3, 0.1, 0.2])).record
    np.testing.assert_array_equal(record['state']['measured_position'], [0.1, 0.2, 0.3])
    assert record['has_fault'] and record['state']['mode'] < Mode.STALE
    monitor = SerialSensorMonitor('/uio', ARM)
    for wrong in ({'names': ('joint1', 'joint2')}, {'position': [0.0]}, {'effort': [0.0] * 7}):
        pytest.raises(SampleError, monitor.take, 1, message(**wrong))
    with pytest.raises(SampleError, match='2 values for 3 joints'):
        monitor.take(1, message(), torque=[0.0, 0.0])
    assert monitor.rejected == 4
    with pytest.raises(ConfigError, match='lpv: is missing'):
        SerialSensorMonitor('/uio', ARM, gains=paper_gains)  # designed for its region


def test_given_a_fault_that_is_hardly_known_when_confirmed_then_it_is_not_trusted():
    run = simulated(ARM, Fault('encoder3', 'stuck', 4.3), duration=6.0)
    for limit, trusted in ((1.5, True), (0.1, False)):
        monitor = SerialSensorMonitor('/uio', ARM, DiagnosisParameters(safe_stop_bound=limit))
        _, answers = observe(run.stamps, run.samples, monitor)
        ((_, alarm),) = answers.events
        named = run.stamps >= alarm.detected
        assert alarm.kind == 'stuck' and answers.state.trustworthy[named][0]
        assert answers.state.trustworthy[named].all() == trusted
    k = np.flatnonzero(~answers.state.trustworthy & named)[0]
    rows = answers.state[k], answers.fault[k]
    report = Report('', ARM, *rows, '', {}, 0, '', 3.0, 1.5, False, None)
    observer, _, _, third = report.statuses()
    assert observer['message'] == 'a confirmed fault cannot be compensated safely: stop'
    assert (observer['level'], third['message']) == (ERROR, 'fault confirmed')


def test_given_smaller_sigmas_when_retuned_then_bounds_shrink_and_hold_what_is_undecided():
    stamps, samples, _ = recorded()
    monitor, answers = observe(stamps, samples)
    monitor.retune(replace(DiagnosisParameters(), sigmas=2.0))
    _, after = observe(stamps[-1:] + STEP, samples[-1:], monitor)
    undecided = np.array([0.0, 0.05, 0.0])  # whether the step was the end of a fault
    bound = undecided + 0.5 * (answers.fault.bound[-1] - undecided)
    np.testing.assert_allclose(after.fault.bound[0], bound, rtol=1e-2)


def test_given_a_drift_with_its_derived_rate_when_followed_then_onset_size_and_rates_are_right():
    run = simulated(ARM, Fault('encoder2', 'drift', 2.0, rate=0.3), duration=6.0)
    _, answers = observe(run.stamps, run.samples)
    assert {event.sensor for _, event in answers.events} == {'encoder2'}
    assert 1e-9 * answers.events[0][1].onset == pytest.approx(2.0, abs=0.03)
    fault = (run.samples[-1, 0] - run.position[-1])[1]
    assert answers.fault.estimate[-1, 1] == pytest.approx(fault, abs=0.1)
    last = slice(-1000, None)
    true = np.gradient(run.position[:, 1], ARM.sample_time)[last].mean()
    assert answers.fault.alarm[last, 1].all()
    assert answers.state.measured_velocity[last, 1].mean() - true == pytest.approx(0.3, abs=0.02)
    assert answers.state.velocity[last, 1].mean() == pytest.approx(true, abs=0.1)


@pytest.mark.parametrize('odd', [0, -1, FUTURE - 50 * JUMP])
@pytest.mark.parametrize(('rows', 'step'), [
    ((800,), 0), (range(700, 710), 0), (range(700, 710), 5 * JUMP), (range(700, 900, 2), STEP),
])  # fmt: skip
def test_given_stamps_of_other_clocks_then_their_samples_alone_are_stale(odd, rows, step):
    stamps, samples, _ = recorded()
    stamps[list(rows)] = odd + step * np.arange(len(rows))
    monitor, answers = observe(stamps, samples)
    modes = np.where(np.isin(np.arange(len(stamps)), rows), Mode.STALE, Mode.OBSERVING)
    assert (answers.state.mode[699:] == modes[699:]).all()
    assert (answers.state.trustworthy[699:] == (modes[699:] == Mode.OBSERVING)).all()
    assert np.isfinite(answers.state.position).all() and not answers.restarted.any()
    assert (answers.fault.alarm[600:] == [0, 1, 0]).all()
    assert told(answers) == RAISED
    assert monitor.counters.refused_stamps == len(rows) and monitor.counters.restarts == 0


@pytest.mark.parametrize(('back', 'lost'), [(3, 0), (9, 0), (9, 40)])
def test_given_a_clock_that_is_set_back_when_healthy_then_no_sensor_is_blamed(back, lost):
    run = simulated(ARM, duration=4.0)
    places = np.arange(len(run.stamps))
    stamps = run.stamps - np.where(places <= 700 + lost, 0, back * STEP)
    kept = (places < 700) | (places >= 700 + lost)
    monitor, answers = observe(stamps[kept], run.samples[kept])
    assert not answers.events and monitor.counters.out_of_order == back - 1
    assert monitor.counters.gaps == 1 + (lost > 0)


@pytest.mark.parametrize('start', [3 * HOUR, HOUR, 10**9, FUTURE - 2 * HOUR])
def test_given_a_fault_when_the_clock_is_set_then_trust_waits_for_it(start):
    stamps, samples, position = recorded(LARGE.size, 6.0)
    stamps = stamps + np.where(np.arange(len(stamps)) < 1000, 2 * HOUR, start)
    _, answers = observe(stamps, samples)
    assert told(answers) == RAISED
    assert (answers.fault.alarm[600:] == [0, 1, 0]).all()
    error = answers.state.compensated_position - position
    assert np.abs(error[600:1000]).max() < 5e-3 and np.abs(error[1002:]).max() < 5e-3
    assert list(np.nonzero(answers.restarted)[0]) == [1002]  # the third
    trusted = answers.state.trustworthy
    assert trusted[999] and not trusted[1000:1050].any() and trusted[-1]
    assert np.isfinite(answers.state.position).all() and np.isfinite(answers.fault.bound).all()


def test_given_a_fault_that_ended_while_the_clock_was_set_then_it_is_cleared():
    stamps, samples, _ = recorded(LARGE.size, 6.0)
    samples[1000:, 0, 1] -= LARGE.size
    stamps[1000:] += HOUR
    _, answers = observe(stamps, samples)
    (_, raised), (row, cleared) = answers.events
    assert (raised.event, cleared.event) == (AlarmEvent.RAISED, AlarmEvent.CLEARED)
    assert not answers.state.trustworthy[1000:row].any() and answers.state.trustworthy[row:].all()


def test_given_a_confirmed_offset_when_stamps_make_a_gap_then_it_stays_removed():
    run = simulated(ARM, Fault('encoder2', 'bias', 0.0, size=0.3), duration=10.0)
    for shift in (HOUR, -HOUR, 100_000_000):
        stamps = run.stamps + 2 * HOUR
        stamps[4000:] += shift
        _, answers = observe(stamps, run.samples)
        assert {event.sensor for _, event in answers.events} == {'encoder2'}
        assert answers.fault.alarm[3999:, 1].all()
        error = answers.state.compensated_position[3999:, 1] - run.position[3999:, 1]
        assert np.abs(error).max() < 0.15


def test_given_samples_too_sparse_for_a_balance_when_taken_then_trust_ends_until_there_is_one():
    k = np.arange(2000)  # a sixth of the samples, all of them from 3.6 s on
    run = without(simulated(ARM, duration=4.0), (k % 30 >= 5) & (k <= 1800))
    _, answers = observe(run.stamps, run.samples)
    time = run.stamps / 1e9
    trusted = answers.state.trustworthy
    assert trusted[time < 2.4].all() and not trusted[(time > 2.6) & (time < 3.6)].any()
    assert trusted[time > 3.8].all() and not answers.fault.alarm.any()


@pytest.mark.parametrize('share', [1.0, 0.4])
def test_given_derived_rates_when_the_file_calls_them_independent_then_they_are_found_out(share):
    """A wrong word of the file blinds for as long as it takes to see that it is wrong."""
    drift = Fault('encoder2', 'drift', 3.0, rate=0.3, size=0.6)
    stamps, samples, position = simulated(ARM, drift, duration=5.0)
    samples[:, 1] = lfilter([share], [1.0, share - 1.0], samples[:, 1], axis=0)
    said = shoulder_arm('independent')
    monitor, answers = observe(stamps, samples, SerialSensorMonitor('/uio', said))
    _, right = observe(stamps, samples)
    assert told(answers) == told(right) == RAISED
    assert [e.kind for _, e in answers.events] == ['drift']
    error = answers.fault.estimate - (samples[:, 0] - position)
    assert (np.abs(error) < answers.fault.bound)[2 * SAMPLES :].mean() > 0.99
    assert _MISNAMED.format(', '.join(ARM.joint_names)) in str(monitor.status(Mode.OBSERVING))


def test_given_rates_of_their_own_when_faults_come_then_the_file_is_believed():
    arm = shoulder_arm('independent')
    for fault in (None, replace(LARGE, kind='noise', size=0.02), replace(LARGE, size=0.02)):
        stamps, samples, _ = simulated(arm, *([fault] if fault else []), duration=2.0)
        monitor, _ = observe(stamps, samples, SerialSensorMonitor('/uio', arm))
        assert 'are derived' not in str(monitor.status(Mode.OBSERVING))


def wrapped(arm, joint, rates):
    """A run that turns a joint over, its wrapped readings and their differences, truth."""
    stamps, samples, _ = simulated(arm, duration=6.0)
    way = np.pi - np.quantile(samples[:, 0, joint], 0.6)
    samples[:, 0, joint] += way  # the joint is mounted so
    whole = samples.copy()
    samples[:, 0, joint] = (samples[:, 0, joint] + np.pi) % (2.0 * np.pi) - np.pi
    if rates == 'differences':
        samples[1:, 1] = np.diff(samples[:, 0], axis=0) / 2e-3
        whole[1:, 1] = np.diff(whole[:, 0], axis=0) / 2e-3
    return stamps, samples, whole


@pytest.mark.parametrize('rates', ['differences', 'own'])
def test_given_a_joint_without_limits_when_its_reading_wraps_then_it_goes_on(rates):
    """Drivers give positions of such joints within one turn."""
    arm = shoulder_arm('independent' if rates == 'own' else 'derived')
    arm = with_joints(arm, 0, limits=JointLimits(velocity=2.5))  # about the vertical
    stamps, samples, whole = wrapped(arm, 0, rates)
    first, *others = np.flatnonzero(np.abs(np.diff(samples[:, 0, 0])) > np.pi)
    assert others
    for readings in (samples, whole):  # it may turn over while it is not read
        readings[first - 50 : first + 50, 0] = np.nan
    _, answers = observe(stamps, samples, SerialSensorMonitor('/uio', arm))
    _, right = observe(stamps, whole, SerialSensorMonitor('/uio', arm))
    assert told(answers) == told(right)
    turns = (answers.state.position - right.state.position)[1:, 0] / (2.0 * np.pi)
    assert np.allclose(turns, np.round(turns[0]), atol=1e-9)
    limited = with_joints(arm, 0, limits=ARM.joints[0].limits)
    _, answers = observe(stamps, samples, SerialSensorMonitor('/uio', limited))
    assert any(event.sensor == 'encoder1' for _, event in answers.events)


def test_given_a_reading_that_fails_where_it_wraps_then_it_is_continued_as_one_without_wraps():
    arm = replace(ARM, joints=(replace(ARM.joints[0], limits=JointLimits(velocity=2.5)),))
    stamps, way = START + 2_000_000 * np.arange(500), np.linspace(2.9, 3.7, 500)[:, None]
    noisy = way + np.random.default_rng(1).normal(0.0, 0.3, way.shape)
    jumped, frozen = way + 1.0 * (way > np.pi), np.where(abs(way - np.pi) < 0.1, np.pi - 0.1, way)
    for faulty in (noisy, jumped, frozen):
        readings = (faulty + np.pi) % (2.0 * np.pi) - np.pi
        found, _ = Turns(arm).continued(stamps, readings, 0.0 * readings)
        np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * readings), atol=1e-9)
        np.testing.assert_allclose(found - found[0], faulty - faulty[0], atol=1e-9)


def test_given_half_a_turn_while_a_loop_took_the_samples_then_no_turn_is_taken_out():
    monitor = SerialSensorMonitor('/uio', with_joints(ARM, 0, limits=JointLimits(velocity=3.0)))
    stamps, ones = START + STEP * np.arange(20), np.ones((20, 3))
    answers = monitor.take_many(stamps, ones, ones, ones)
    turned = ones + 4.0 * np.eye(3)[0]
    monitor.went_on(int(stamps[-1]) + STEP, turned[0], answers.plain[-1:])
    answers = monitor.take_many(stamps + 30 * STEP, turned, 0.0 * ones, ones)
    np.testing.assert_array_equal(answers.state.measured_position[1:], turned[1:])


def test_given_a_joint_that_turns_for_an_hour_when_observed_then_its_readings_stay_plausible():
    endless = with_joints(ARM, 0, limits=JointLimits(velocity=3.0))
    monitor = SerialSensorMonitor('/uio', endless)
    step = np.pi / 2.0 * (np.arange(4000) % 4 - 1.5)  # a quarter of a turn from sample to sample
    readings = np.stack([step, 0.5 + 0.0 * step, -1.0 + 0.0 * step], axis=1)
    rates = np.tile([np.pi / 1.2, 0.0, 0.0], (len(step), 1))
    stamps = START + 600_000_000 * np.arange(len(step), dtype=np.int64)
    answers = monitor.take_many(stamps, readings, rates, np.zeros_like(rates))
    assert monitor.counters.implausible == 0
    assert answers.state.measured_position[-1, 0] > 6000.0
    for joint in range(2):
        readings[10 * joint :, joint] += 2000.0
        part = slice(10 * joint, 10 * joint + 10)
        later = stamps[part] + (joint + 1) * HOUR
        monitor.take_many(later, readings[part], rates[part], np.zeros((10, 3)))
        assert monitor.counters.implausible == 8 * (joint + 1)  # of a stream from the third on


WARMED = """
import sys
import numpy as np
from lpv.core.support import jit

made, compile_once = [], jit._compile_once

def noted(dispatcher, kind):
    compile_for = compile_once(dispatcher, kind)
    def compile_noted(types):
        if types not in dispatcher.overloads:
            made.append(dispatcher.py_func.__name__)
        return compile_for(types)
    return compile_noted

jit._compile_once = noted
from serial_arms import shoulder_arm
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor

arm, found = shoulder_arm(sys.argv[1]), np.load(sys.argv[2])
monitor = SerialSensorMonitor('/uio', arm)
monitor.warm_up()
monitor.warm_up_faults()
configured = len(made)
for stamps, samples in zip(found['stamps'], found['samples']):
    SerialSensorMonitor('/uio', arm).take_many(stamps, *np.moveaxis(samples, 1, 0))
print(configured > 10, made[configured:])
"""
"""Prints whether functions were loaded or compiled for a configured node, and which were later."""


@pytest.mark.skipif(not COMPILED, reason='without Numba nothing is compiled')
@pytest.mark.slow
@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_configured_monitor_when_sensors_fail_then_nothing_is_compiled(rates, tmp_path):
    faults = [
        Fault('encoder2', 'drift', 1.0, rate=0.3), Fault('encoder2', 'stuck', 1.0),
        Fault('encoder3', 'noise', 1.0, size=0.02), Fault('encoder1', 'bias', 1.0, 1.0, 0.3),
    ]  # fmt: skip
    runs = [simulated(shoulder_arm(rates), fault, duration=4.0) for fault in faults]
    file = tmp_path / 'runs.npz'
    np.savez(file, stamps=[r.stamps + 1 for r in runs], samples=[r.samples for r in runs])
    command = [sys.executable, '-c', WARMED, rates, str(file)]
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert said.stdout == 'True []\n'
