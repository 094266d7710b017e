"""A serial arm's diagnosis behind the interface that node and replay use."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from serial_arms import shoulder_arm, wrong_plant

from lpv_core.monitoring.parameters import DiagnosisParameters
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent, Mode, SensorState
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.serial_arm.simulation import EncoderFault, SerialSimulator
from lpv_core.support.errors import ConfigError, SampleError

ARM = shoulder_arm()
STEP, LARGE = EncoderFault(1, 'bias', 1.0, 0.05), EncoderFault(1, 'bias', 1.0, 0.3)


@pytest.fixture(scope='module')
def recording():
    """Stamps, and readings, rates, efforts of 2 s with a step on the second encoder after 1 s."""
    run = SerialSimulator(ARM, wrong_plant(ARM, 1), 1).run(2.0, [STEP], ())
    return run.stamps + 5, run.samples.copy(), run.position


def observe(recording, monitor=None, parts=1):
    """Answers of a monitor to a recording that is handed over in some parts."""
    monitor = monitor or SerialSensorMonitor('/uio', ARM)
    stamps, samples = recording[:2]
    edges = np.linspace(0, len(stamps), parts + 1).astype(int)
    return monitor, [
        monitor.take_many(stamps[a:b], *(samples[a:b, k] for k in range(3)))
        for a, b in zip(edges, edges[1:])
    ]


def message(names=ARM.joint_names, **fields):
    zeros = [0.0] * len(names)
    values = {'position': zeros, 'velocity': zeros, 'effort': zeros, **fields}
    return SimpleNamespace(name=list(names), **values)


def spoiled(recording):
    """The recording with samples that are lost, repeated, not finite, or without efforts."""
    stamps, samples = recording[0].copy(), recording[1].copy()
    samples[100, 0, 1] = samples[150, 1, 0] = np.nan
    samples[700:800, 2] = np.nan
    stamps[200] = stamps[199]
    stamps[300] -= 50_000_000
    stamps[400:] += 100_000_000
    stamps[900:] -= 3_000_000_000
    return stamps, samples


def arrays(answers):
    """All values of answers by name, without the padding of their records."""
    found = {'answered': answers.answered, 'restarted': answers.restarted}
    for part in ('state', 'fault'):
        rows = np.asarray(getattr(answers, part))
        found |= {f'{part}.{name}': np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
    return found


@pytest.mark.parametrize('spoil', [False, True])
def test_given_a_recording_when_taken_in_any_parts_then_every_answer_is_the_same(recording, spoil):
    data = spoiled(recording) if spoil else recording
    _, [whole] = observe(data)
    for parts in (7, len(data[0])):
        monitor, answers = observe(data, parts=parts)
        for name, expected in arrays(whole).items():
            found = np.concatenate([arrays(one)[name] for one in answers])
            assert found.tobytes() == expected.tobytes(), name
        assert [e for one in answers for _, e in one.events] == [e for _, e in whole.events]
        assert [s for one in answers for _, s in one.reports] == [s for _, s in whole.reports]
    assert np.isfinite(whole.state.position).all() and np.isfinite(whole.fault.bound).all()
    counted = {name for name, count in vars(monitor.counters).items() if count}
    spoils = {'duplicates', 'out_of_order', 'not_finite', 'gaps', 'without_effort', 'restarts'}
    assert counted == (spoils | {'refused_stamps'} if spoil else set())


def test_given_a_step_when_found_then_the_alarm_names_it_and_its_reading_is_corrected(recording):
    stamps, samples, position = recording
    _, [answers] = observe(recording)
    assert [(e.event, e.sensor, e.kind) for _, e in answers.events] == [
        (AlarmEvent.RAISED, 'encoder2', 'bias')
    ]
    row, event = answers.events[0]
    assert event.detected == stamps[row] < stamps[500] + 20_000_000
    assert event.size == pytest.approx(0.05, abs=2e-3)
    assert list(answers.fault.alarm[row]) == [False, True, False]
    assert (answers.fault.state[:row, 1] != SensorState.ERROR).all()
    error = answers.state.compensated_position - position
    assert np.abs(error).max() < 5e-3  # carried on by its rate until the jump is known
    assert answers.state.trustworthy.all()


def test_given_no_efforts_when_observed_then_jumps_are_found_and_offsets_are_not_diagnosable(
    recording,
):
    samples = recording[1].copy()
    samples[:, 2] = np.nan
    monitor, [answers] = observe((recording[0], samples))
    assert [e.sensor for _, e in answers.events] == ['encoder2']
    assert set(answers.state.mode) == {Mode.HOLDING}
    assert (answers.fault.state[:400] == SensorState.NOT_DIAGNOSABLE).all()
    assert 'no efforts' in answers.reports[0][1][0]['message']


def test_given_efforts_without_the_weight_when_observed_then_no_offset_is_made_of_it(recording):
    arm = replace(ARM, effort_includes_gravity=False)
    stamps, samples, position = recording
    samples = samples.copy()
    model = SerialModel(compile_chain(arm))
    samples[:, 2] -= [model.gravity(q) for q in position]
    _, [answers] = observe((stamps, samples), SerialSensorMonitor('/uio', arm))
    assert [e.sensor for _, e in answers.events] == ['encoder2']
    assert np.abs(answers.fault.estimate[:400]).max() < 0.01
    assert (answers.fault.state[:400] == SensorState.NOT_DIAGNOSABLE).all()
    assert set(answers.state.mode) == {Mode.HOLDING}
    assert 'leave out the weight' in answers.reports[0][1][0]['message']


def test_given_no_rates_when_observed_then_they_are_differences_of_the_readings(recording):
    samples = recording[1].copy()
    samples[:, 1] = np.nan
    _, [answers] = observe((recording[0], samples))
    assert answers.state.mode[0] == Mode.NO_ESTIMATE and not answers.has_fault[0]
    expected = np.diff(samples[:, 0], axis=0) / np.diff(recording[0])[:, None] * 1e9
    np.testing.assert_allclose(answers.state.measured_velocity[1:], expected, atol=1e-9)
    assert [e.sensor for _, e in answers.events] == ['encoder2']


def test_given_independent_rates_when_they_are_missing_then_samples_are_not_used():
    monitor = SerialSensorMonitor('/uio', shoulder_arm('independent'))
    answer = monitor.take(1, message(velocity=[]))
    assert answer.state['mode'] == Mode.NO_ESTIMATE and not answer.state['trustworthy']
    assert answer.fault is None and answer.corrected is None and monitor.counters.not_finite == 1


@pytest.mark.parametrize('parts', [1, 7])
def test_given_readings_of_one_joint_missing_when_observed_then_its_sensor_is_named(
    recording, parts
):
    stamps, samples = recording[0], recording[1].copy()
    samples[100:200, 0, 2] = np.nan
    _, answers = observe((stamps, samples), parts=parts)
    events = [event for part in answers for _, event in part.events if event.kind == 'dropout']
    assert [(one.event, one.sensor) for one in events] == [
        (AlarmEvent.RAISED, 'encoder3'), (AlarmEvent.CLEARED, 'encoder3')]  # fmt: skip
    assert events[0].onset == stamps[100]
    assert 50e6 < events[0].detected - stamps[100] < 60e6


def test_given_joints_in_another_order_and_more_of_them_when_taken_then_names_decide():
    monitor = SerialSensorMonitor('/uio', ARM)
    names = ('gripper', 'joint3', 'joint1', 'joint2')
    answer = monitor.take(1, message(names, position=[9.0, 0.3, 0.1, 0.2]))
    np.testing.assert_array_equal(answer.state['measured_position'], [0.1, 0.2, 0.3])
    assert answer.corrected['name'] == ['joint1', 'joint2', 'joint3']
    assert answer.fault['sensor_names'] == ['encoder1', 'encoder2', 'encoder3']


@pytest.mark.parametrize(
    'wrong', [{'names': ('joint1', 'joint2')}, {'position': [0.0]}, {'effort': [0.0] * 7}]
)
def test_given_messages_that_do_not_fit_when_taken_then_they_are_refused_and_counted(wrong):
    monitor = SerialSensorMonitor('/uio', ARM)
    with pytest.raises(SampleError):
        monitor.take(1, message(**wrong))
    with pytest.raises(SampleError, match='2 values for 3 joints'):
        monitor.take(1, message(), torque=[0.0, 0.0])
    assert monitor.rejected == 2


def test_given_a_confirmed_fault_when_reported_then_sensor_and_joint_are_marked(recording):
    _, [answers] = observe(recording)
    observer, *sensors = answers.reports[-1][1]
    assert observer['values']['corrected joints'] == 'joint2'
    assert observer['values']['bounds'] == 'statistical, 4 standard deviations'
    assert [status['message'] for status in sensors][1] == 'fault confirmed'


def test_given_a_fault_that_is_not_known_well_enough_when_confirmed_then_it_is_not_trusted():
    faults = [EncoderFault(2, 'stuck', 4.3)]
    run = SerialSimulator(ARM, wrong_plant(ARM, 1), 1).run(6.0, faults, ())
    _, [answers] = observe((run.stamps, run.samples))
    assert [e.kind for _, e in answers.events] == ['stuck']
    assert answers.state.trustworthy[2000] and not answers.state.trustworthy[-1]


def test_given_gains_when_the_arm_has_no_region_then_they_are_refused(paper_gains):
    with pytest.raises(ConfigError, match='lpv: is missing'):
        SerialSensorMonitor('/uio', ARM, gains=paper_gains)


def test_given_smaller_sigmas_when_retuned_then_bounds_shrink_at_once(recording):
    monitor, [answers] = observe(recording)
    monitor.retune(replace(DiagnosisParameters(), sigmas=2.0))
    stamps, samples = recording[0][-1:] + 2_000_000, recording[1][-1:]
    after = monitor.take_many(stamps, *(samples[:, k] for k in range(3)))
    np.testing.assert_allclose(after.fault.bound[0], 0.5 * answers.fault.bound[-1])


HOUR = 3600 * 10**9


@pytest.mark.parametrize('odd', [0, 2**31 * 10**9 - 1])
def test_given_one_stamp_of_another_clock_when_observed_then_its_sample_alone_is_stale(
    recording, odd
):
    stamps, samples = recording[0].copy(), recording[1]
    stamps[800] = odd
    monitor, [answers] = observe((stamps, samples))
    assert (answers.state.mode[799:802] == [Mode.OBSERVING, Mode.STALE, Mode.OBSERVING]).all()
    assert not answers.state.trustworthy[800] and answers.state.trustworthy[801:].all()
    assert np.isfinite(answers.state.position).all() and not answers.restarted.any()
    assert (answers.fault.alarm[600:] == [0, 1, 0]).all()
    assert [event.event for _, event in answers.events] == [AlarmEvent.RAISED]
    assert monitor.counters.refused_stamps == 1 and monitor.counters.restarts == 0


@pytest.fixture(scope='module')
def long_recording():
    """8 s with a larger step, which gravity shows."""
    run = SerialSimulator(ARM, wrong_plant(ARM, 1), 1).run(8.0, [LARGE], ())
    return run.stamps + 5, run.samples, run.position


@pytest.mark.parametrize('shift', [HOUR, -HOUR])
def test_given_a_confirmed_fault_when_the_clock_is_set_then_it_stays_untrusted_until_seen(
    long_recording, shift
):
    stamps, samples, position = long_recording
    stamps = stamps + np.where(np.arange(len(stamps)) < 1000, 2 * HOUR, 2 * HOUR + shift)
    monitor, [answers] = observe((stamps, samples))
    assert [event.event for _, event in answers.events] == [AlarmEvent.RAISED]
    assert (answers.fault.alarm[600:] == [0, 1, 0]).all()
    error = answers.state.compensated_position - position
    assert np.abs(error[600:1000]).max() < 5e-3 and np.abs(error[1002:]).max() < 5e-3
    assert list(np.nonzero(answers.restarted)[0]) == [1002]
    trusted = answers.state.trustworthy
    assert trusted[999] and not trusted[1000:1050].any() and trusted[-1]
    assert np.isfinite(answers.state.position).all() and np.isfinite(answers.fault.bound).all()


def test_given_a_fault_that_ended_while_the_clock_was_set_when_shown_then_it_is_cleared(
    long_recording,
):
    stamps, samples = long_recording[0].copy(), long_recording[1].copy()
    samples[1000:, 0, 1] -= LARGE.size
    stamps[1000:] += HOUR
    _, [answers] = observe((stamps, samples))
    (_, raised), (row, cleared) = answers.events
    assert (raised.event, cleared.event) == (AlarmEvent.RAISED, AlarmEvent.CLEARED)
    assert not answers.state.trustworthy[1000:row].any() and answers.state.trustworthy[row:].all()


@pytest.mark.parametrize('shift', [HOUR, -HOUR, 100_000_000])
def test_given_a_confirmed_offset_when_stamps_make_a_gap_then_it_stays_removed(shift):
    fault = EncoderFault(1, 'bias', 0.0, 0.3)
    run = SerialSimulator(ARM, wrong_plant(ARM, 1), 1).run(12.0, [fault], ())
    stamps = run.stamps + 2 * HOUR
    stamps[4000:] += shift
    _, [answers] = observe((stamps, run.samples))
    assert {event.sensor for _, event in answers.events} == {'encoder2'}
    assert answers.fault.alarm[3999:, 1].all()
    error = answers.state.compensated_position[3999:, 1] - run.position[3999:, 1]
    assert np.abs(error).max() < 0.15
