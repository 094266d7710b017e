"""The monitor that node and replay share: an answer to every sample, on the clock of the data."""

import math
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpv_core.decision.diagnosis import Alarm, AlarmEvent, SensorState
from lpv_core.model.dynamics import inverse_dynamics
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.alarm_text import COUNTER_TEXT, describe
from lpv_core.monitoring.message_fields import OK
from lpv_core.monitoring.message_fields import STALE as STALE_LEVEL
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.observer.sampled_observer import Counters, Mode
from lpv_core.support.errors import ConfigError, SampleError
from lpv_core.support.timestamps import NANOSECONDS

TS = 2_000_000
"""Sample time of the arm [ns]."""
START = 5 * NANOSECONDS

STATE_VECTORS = (
    'position',
    'velocity',
    'compensated_position',
    'measured_position',
    'measured_velocity',
)
FAULT_VECTORS = ('estimate', 'bound', 'threshold')


@pytest.fixture
def monitor(paper_arm, paper_gains):
    return SensorMonitor('/lpv/uio', paper_arm, paper_gains)


@pytest.fixture(scope='session')
def sample(paper_arm):
    """Makes JointState-like measurements of a slow swing about the vertical."""
    joints, constants = JointMap(paper_arm), paper_arm.constants()

    def motion(t):
        return (
            np.array([0.3 * math.sin(1.1 * t), 0.2 * math.sin(1.7 * t)]),
            np.array([0.33 * math.cos(1.1 * t), 0.34 * math.cos(1.7 * t)]),
            np.array([-0.363 * math.sin(1.1 * t), -0.578 * math.sin(1.7 * t)]),
        )

    def make(k, fault=(0.0, 0.0), **changes):
        theta, rate, _ = motion(k * 0.002)
        torque = inverse_dynamics(*np.concatenate(motion((k - 0.5) * 0.002)), constants)
        fields = {
            'name': list(paper_arm.joint_names),
            'position': joints.joint_from_sensor(theta + np.asarray(fault)),
            'velocity': joints.joint_velocity(rate),
            'effort': joints.joint_torque(np.array(torque)),
        }
        return SimpleNamespace(**{**fields, **changes})

    return make


def feed(monitor, sample, first, last, fault=(0.0, 0.0), start=START):
    """Answers to samples first..last."""
    return [monitor.take(start + k * TS, sample(k, fault)) for k in range(first, last + 1)]


def same(one, two):
    """Whether two dicts of fields hold the same bits."""
    return one.keys() == two.keys() and all(np.array_equal(one[k], two[k]) for k in one)


# ------------------------------------------------------------------ ordinary samples


def test_given_samples_when_taken_then_each_is_answered_at_its_own_stamp(monitor, sample):
    answers = feed(monitor, sample, 0, 20)
    assert [a.stamp for a in answers] == [START + k * TS for k in range(21)]
    assert [a.state['mode'] for a in answers] == [Mode.INITIALISING] + [Mode.OBSERVING] * 20
    assert answers[0].fault['state'] == [SensorState.NOT_DIAGNOSABLE] * 2
    assert answers[-1].fault['state'] == [SensorState.OK] * 2
    assert answers[-1].fault['sensor_names'] == ['link1_angle', 'link2_angle']
    assert not any(a.restarted or a.alarms or a.events for a in answers)


def test_given_healthy_samples_when_taken_then_answers_follow_the_motion(monitor, sample):
    answer = feed(monitor, sample, 0, 500)[-1]
    for name in ('position', 'compensated_position', 'measured_position'):
        np.testing.assert_allclose(answer.state[name], sample(500).position, atol=1e-3)
    np.testing.assert_allclose(answer.state['velocity'], sample(500).velocity, atol=5e-3)
    np.testing.assert_allclose(answer.fault['estimate'], 0.0, atol=1e-3)
    assert np.all(answer.fault['threshold'] >= answer.fault['bound'])


def test_given_joints_in_another_order_when_taken_then_the_answer_is_the_same(
    monitor, sample, paper_arm, paper_gains
):
    twin = SensorMonitor('/lpv/uio', paper_arm, paper_gains)
    for k in range(20):
        one = sample(k)
        two = sample(
            k,
            name=['joint2', 'finger', 'joint1'],
            **{
                field: [values[1], 99.0, values[0]]
                for field, values in vars(one).items()
                if field != 'name'
            },
        )
        answers = [m.take(START + k * TS, s) for m, s in ((monitor, one), (twin, two))]
        assert same(answers[0].state, answers[1].state)
        assert same(answers[0].fault, answers[1].fault)


def test_given_a_torque_when_taken_then_it_stands_in_for_the_effort(
    monitor, sample, paper_arm, paper_gains
):
    twin = SensorMonitor('/lpv/uio', paper_arm, paper_gains)
    for k in range(20):
        one = monitor.take(START + k * TS, sample(k))
        two = twin.take(START + k * TS, sample(k, effort=[]), sample(k).effort)
        assert same(one.state, two.state)
    pushed = twin.take(START + 20 * TS, sample(20), sample(20).effort + 50.0)
    assert not same(pushed.state, monitor.take(START + 20 * TS, sample(20)).state)


def test_given_a_warm_up_when_samples_are_taken_then_it_has_left_no_trace(
    monitor, sample, paper_arm, paper_gains
):
    warm = SensorMonitor('/lpv/uio', paper_arm, paper_gains)
    warm.warm_up()
    assert warm.counters == Counters()
    for one, two in zip(feed(monitor, sample, 0, 30), feed(warm, sample, 0, 30)):
        assert same(one.state, two.state)
        assert same(one.fault, two.fault)
        assert one.status == two.status


def test_given_gains_of_another_arm_when_made_then_they_are_refused(real_arm, paper_gains):
    with pytest.raises(ConfigError):
        SensorMonitor('/uio', real_arm, paper_gains)


# ------------------------------------------------------------------ before the first estimate


@pytest.mark.parametrize(
    'changes',
    [
        {'effort': []},
        {'effort': [math.nan, 0.0]},
        {'velocity': [0.0, math.inf]},
        {'position': [math.nan, 0.0]},
        {'position': [1e9, 0.0]},
    ],
)
def test_given_unusable_samples_only_when_taken_then_it_is_answered_that_nothing_is_known(
    monitor, sample, changes
):
    for k in range(5):
        answer = monitor.take(START + k * TS, sample(k, **changes))
        assert answer.stamp == START + k * TS
        assert {name: list(answer.state.pop(name)) for name in STATE_VECTORS} == {
            name: [0.0, 0.0] for name in STATE_VECTORS
        }
        assert answer.state == {'mode': Mode.NO_ESTIMATE, 'trustworthy': False}
        assert answer.fault is None
        assert (answer.alarms, answer.events, answer.restarted) == ([], [], False)
        assert monitor.stale_fault() is None
    assert monitor.take(START + 5 * TS, sample(5)).state['mode'] == Mode.INITIALISING


@pytest.mark.parametrize('usable', [0, 100])
def test_given_unusable_samples_for_seconds_when_taken_then_a_stale_status_is_due(
    monitor, sample, usable
):
    feed(monitor, sample, 0, usable - 1)
    answers = [monitor.take(START + k * TS, sample(k, effort=[])) for k in range(usable, 1500)]
    due = [a.status for a in answers if a.status is not None]
    assert len(due) >= 2
    assert due[-1][0]['level'] == STALE_LEVEL


# ------------------------------------------------------------------ samples that are not usable


def test_given_an_unusable_sample_when_taken_then_the_last_answer_is_repeated_as_stale(
    monitor, sample
):
    last = feed(monitor, sample, 0, 50)[-1]
    for k in (51, 52):
        answer = monitor.take(START + k * TS, sample(k, effort=[math.nan, 0.0]))
        assert answer.stamp == START + k * TS
        assert same(answer.state, {**last.state, 'mode': Mode.STALE})
        assert same(answer.fault, {**last.fault, 'state': [SensorState.STALE] * 2})
        assert (answer.alarms, answer.status, answer.restarted) == ([], None, False)
    assert same(monitor.stale_fault(), {**last.fault, 'state': [SensorState.STALE] * 2})
    again = monitor.take(START + 53 * TS, sample(53))
    assert again.state['mode'] == Mode.OBSERVING
    assert again.fault['state'] == [SensorState.OK] * 2


def test_given_an_alarm_when_samples_are_unusable_then_it_is_not_forgotten(monitor, sample):
    feed(monitor, sample, 0, 50)
    feed(monitor, sample, 51, 100, (0.3, 0.0))
    answer = monitor.take(START + 101 * TS, sample(101, velocity=[math.nan, 0.0]))
    assert answer.fault['alarm'] == [True, False]
    assert answer.fault['estimate'][0] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize('back', [0, 1, 10])
def test_given_a_stamp_that_is_not_newer_when_taken_then_there_is_no_answer(monitor, sample, back):
    feed(monitor, sample, 0, 50)
    assert monitor.take(START + (50 - back) * TS, sample(50)) is None
    counters = monitor.counters
    assert (counters.duplicates, counters.out_of_order) == ((1, 0) if back == 0 else (0, 1))


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'name': ['joint1', 'other']}, "'joint2' occurs 0 times"),
        ({'name': ['joint1', 'joint2', 'joint2']}, "'joint2' occurs 2 times"),
        ({'name': []}, "'joint1' occurs 0 times"),
        ({'position': [0.1]}, 'position has 1 values for 2 joints'),
        ({'velocity': []}, 'velocity has 0 values for 2 joints'),
        ({'effort': [0.1, 0.2, 0.3]}, 'effort has 3 values for 2 joints'),
    ],
)
def test_given_a_message_that_does_not_fit_when_taken_then_it_is_counted_and_harmless(
    monitor, sample, paper_arm, paper_gains, changes, reason
):
    twin = SensorMonitor('/lpv/uio', paper_arm, paper_gains)
    for m in (monitor, twin):
        feed(m, sample, 0, 20)
    for _ in range(2):
        with pytest.raises(SampleError, match=reason):
            monitor.take(START + 21 * TS, sample(21, **changes))
    assert monitor.rejected == 2
    one, two = (m.take(START + 21 * TS, sample(21)) for m in (monitor, twin))
    assert same(one.state, two.state)
    assert monitor.status(Mode.OBSERVING)[0]['values']['rejected messages'] == '2'


def test_given_input_of_any_kind_when_taken_then_answers_are_finite(monitor, sample):
    rng = np.random.default_rng(2)
    odd = [math.nan, math.inf, -math.inf, 1e300, -1e18, 1e5, 0.0]
    for k in range(2000):
        changes = {}
        for field in ('position', 'velocity', 'effort'):
            if rng.random() < 0.05:
                values = np.array(getattr(sample(k), field))
                values[rng.integers(2)] = rng.choice(odd)
                changes[field] = values
        jump = int(rng.choice([0, 0, 0, 0, -1, 50])) if rng.random() < 0.05 else 0
        answer = monitor.take(START + (k + jump) * TS, sample(k, **changes))
        if answer is None:
            continue
        for fields, names in ((answer.state, STATE_VECTORS), (answer.fault or {}, FAULT_VECTORS)):
            for name in names if fields else ():
                assert np.isfinite(fields[name]).all(), (k, name)
    counters = monitor.counters
    assert min(counters.not_finite, counters.implausible, counters.out_of_order) > 0


# ------------------------------------------------------------------ time that restarts


def test_given_time_that_restarts_when_taken_then_all_is_as_at_the_first_start(monitor, sample):
    first = feed(monitor, sample, 0, 600)
    second = feed(monitor, sample, 0, 600, start=0)
    assert [a.restarted for a in second] == [True] + [False] * 600
    assert monitor.counters.restarts == 1
    for one, two in zip(first, second):
        assert same(one.state, two.state)
        assert same(one.fault, two.fault)
    assert second[0].status is not None


def test_given_an_alarm_when_time_restarts_then_it_is_over_and_can_be_raised_again(monitor, sample):
    feed(monitor, sample, 0, 50)
    raised = [e for a in feed(monitor, sample, 51, 100, (0.3, 0.0)) for e in a.events]
    assert [e.event for e in raised] == [AlarmEvent.RAISED]
    early = START - 3 * NANOSECONDS
    again = feed(monitor, sample, 0, 50, start=early)
    assert not any(any(a.fault['alarm']) for a in again)
    events = [e for a in feed(monitor, sample, 51, 100, (0.3, 0.0), early) for e in a.events]
    assert [e.event for e in events] == [AlarmEvent.RAISED]
    assert events[0].onset == early + 51 * TS


def test_given_an_alarm_when_time_restarts_without_an_encoder_then_nothing_is_known_any_more(
    monitor, sample
):
    feed(monitor, sample, 0, 50)
    feed(monitor, sample, 51, 100, (0.3, 0.0))
    answer = monitor.take(NANOSECONDS, sample(0, position=[math.nan, 0.0]))
    assert answer.restarted
    assert answer.state['mode'] == Mode.NO_ESTIMATE
    assert answer.fault is None


def test_given_a_reset_when_more_samples_come_then_the_monitor_starts_anew_and_keeps_counting(
    monitor, sample
):
    first = feed(monitor, sample, 0, 20)
    monitor.take(START + 20 * TS, sample(20))
    monitor.reset()
    assert monitor.stale_fault() is None
    second = feed(monitor, sample, 0, 20)
    assert [a.state['mode'] for a in second] == [a.state['mode'] for a in first]
    assert all(same(one.state, two.state) for one, two in zip(first, second))
    assert second[0].status is not None
    assert monitor.counters.duplicates == 1


# ------------------------------------------------------------------ reports


def test_given_samples_when_taken_then_a_status_is_due_every_second_of_the_data(monitor, sample):
    answers = feed(monitor, sample, 0, 1600)
    due = [(a.stamp - START) / NANOSECONDS for a in answers if a.status is not None]
    assert due == [0.0, 1.0, 2.0, 3.0]
    observer, *sensors = answers[500].status
    assert (observer['name'], observer['level']) == ('/lpv/uio: observer', OK)
    assert observer['hardware_id'] == 'paper'
    assert [s['name'] for s in sensors] == ['/lpv/uio: link1_angle', '/lpv/uio: link2_angle']
    assert [s['level'] for s in sensors] == [OK, OK]
    assert float(sensors[0]['values']['fault estimate [rad]']) == pytest.approx(
        answers[500].fault['estimate'][0], abs=1e-6
    )


def test_given_lost_samples_when_a_status_is_overdue_then_the_next_sample_brings_it(
    monitor, sample
):
    feed(monitor, sample, 0, 490)
    late = monitor.take(START + 520 * TS, sample(520))
    assert late.status is not None
    assert late.status[0]['values']['late_steps'] == '1'
    following = feed(monitor, sample, 521, 1030)
    assert [a.stamp for a in following if a.status is not None] == [START + 1020 * TS]


def test_given_an_alarm_when_raised_and_cleared_then_both_are_answered_with_a_status(
    monitor, sample
):
    answers = (
        feed(monitor, sample, 0, 100)
        + feed(monitor, sample, 101, 200, (0.0, -0.3))
        + feed(monitor, sample, 201, 450)
    )
    told = [a for a in answers if a.alarms]
    assert [[(f['event'], f['kind']) for f in a.alarms] for a in told] == [
        [(AlarmEvent.RAISED, 'unclassified')],
        [(AlarmEvent.UPDATED, 'bias')],
        [(AlarmEvent.CLEARED, 'bias')],
    ]
    raised, _, cleared = told
    assert raised.stamp == START + 106 * TS  # a dwell of 10 ms
    (fields,) = raised.alarms
    assert (fields['sensor'], fields['sensor_index']) == ('link2_angle', 1)
    assert (fields['onset'], fields['detected']) == (START + 101 * TS, raised.stamp)
    # Seen as a change: its size is that of the change, less the healthy error before.
    assert fields['size'] == pytest.approx(-0.3, abs=0.01)
    assert raised.fault['estimate'][1] == pytest.approx(-0.3, abs=0.01)
    assert 0.005 < fields['bound'] == raised.fault['bound'][1] < 0.5 * raised.fault['threshold'][1]
    assert raised.fault['alarm'] == [False, True]
    assert cleared.fault['alarm'] == [False, False]
    assert cleared.stamp == pytest.approx(START + 301 * TS, abs=2 * TS)
    assert all(a.status is not None for a in told)
    assert raised.status[2]['message'] == 'fault confirmed'
    assert answers[200].state['compensated_position'] == pytest.approx(
        sample(200).position, abs=0.01
    )
    assert describe(raised.events[0]).startswith('ALARM, link2_angle: error -0.3')
    assert describe(raised.events[0]).endswith('kind not known yet, confidence > 99.9%')
    assert describe(cleared.events[0]).startswith('alarm cleared, link2_angle: ')


@pytest.mark.parametrize(
    ('fields', 'text'),
    [
        ({'kind': 'dropout'}, 'ALARM, a: no readings (dropout)'),
        ({'kind': 'stuck'}, 'reading stands still (stuck), confidence 95.0%'),
        (
            {'kind': 'inconsistent', 'confidence': 0.475},
            '(bound 0.010 rad) if it is this sensor, confidence 47.5%',
        ),
        ({'event': AlarmEvent.CLEARED}, 'bias is over, remaining error +0.250 rad'),
        ({'event': AlarmEvent.UPDATED}, 'alarm updated, a: error +0.250 rad (bound 0.010 rad), b'),
    ],
)
def test_given_an_alarm_when_described_then_the_line_says_what_an_operator_needs(fields, text):
    alarm = Alarm(AlarmEvent.RAISED, 0, 'a', 1, 2, 0.25, 0.01, 'bias', 0.95)
    assert text in describe(replace(alarm, **fields))


def test_given_the_counters_when_shown_then_each_has_a_text():
    assert set(COUNTER_TEXT) == set(asdict(Counters()))
