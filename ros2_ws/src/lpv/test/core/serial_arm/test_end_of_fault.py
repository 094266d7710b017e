from dataclasses import replace

import fault_injection as made
import numpy as np
import pytest
from fault_injection import BY_NAME, Injected, cells, derived, draw, inject, outside_bounds
from serial_arms import answered, shoulder_arm, simulated
from ur10e_twin import twin

from lpv.core.serial_arm.diagnosis import end_of_fault
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv.core.serial_arm.diagnosis.information import recent
from lpv.core.simulation.faults import Fault

pytestmark = pytest.mark.slow
ONSET, AFTER = 4.0, 4.0  # of the fault, and time that is watched after its end [s]
SETTLED = 0.1  # after a change, until samples that waited are used [s]


class Run:
    def __init__(self, arm, rates, fault, joint, duration, count_lost=False, lost=0, beside=0.0):
        subject, (kind, size) = _subject(arm).with_rates(rates), fault
        self.name, self.end = subject.arm.sensor_names[joint], ONSET + duration
        stream = subject.streams(joint)
        stream = derived(stream) if rates == 'derived' else stream
        one = Injected(joint, ONSET, self.end, float(np.sign(size)) or 1.0)
        part, rng = stream.part(2.0, 2.0 + self.end + AFTER), np.random.default_rng(1)
        injected = replace(BY_NAME['step 0.1'], kind=kind, size=abs(size))
        matrix = subject.arm.joints_to_sensors()
        window = inject(part, injected, [one], rates == 'derived', matrix, rng)
        stamps, samples, truth = window.stream.stamps, window.stream.samples, window.truth
        time = (stamps - stamps[0]) * 1e-9
        if count_lost:  # counting goes on from where it stopped
            later = time >= self.end
            way = truth[~later, joint][-1]
            samples[later, 0, joint] += way
            truth[later, joint] += way
            if rates == 'derived':
                samples[np.argmax(later), 1, joint] = samples[np.argmax(later) + 1, 1, joint]
        later = time >= 2.0  # another offset, from then on
        samples[later, 0, joint] += beside
        truth[later, joint] += beside
        kept = np.ones(len(stamps), bool)
        onset = np.searchsorted(time, ONSET)  # around which samples may be missing
        kept[onset - lost // 2 : onset + (lost + 1) // 2] = False
        self.stamps, self.truth, self.time = stamps[kept], truth[kept], time[kept]
        self.answers = subject.monitor().take_many(self.stamps, *np.moveaxis(samples[kept], 1, 0))
        self.estimate, self.bound = self.answers.fault.estimate, self.answers.fault.bound
        self.acting = (self.time > ONSET + SETTLED) & (self.time < self.end)
        # Shares of answers that are trusted with an estimate outside its bound.
        judged = self.answers, self.stamps, self.truth
        self.during = outside_bounds(*judged, (ONSET + SETTLED, self.end))
        self.after = outside_bounds(*judged, (self.end + SETTLED, self.end + AFTER))
        self.events = [(one.event.name, one.sensor, one.kind) for _, one in self.answers.events]


def _subject(arm):
    return made.subjects(arm, recorded=False)[0]


# Faults that leave the reading where it is not.
@pytest.mark.parametrize(('arm', 'joint', 'fault', 'duration'), [
    ('paper', 0, ('drift', 0.1), 3.0), ('paper', 1, ('drift', -0.3), 1.5),
    ('real_arm', 1, ('drift', -0.3), 0.5), ('real_arm', 0, ('drift', -0.05), 4.0),
    ('chain3', 1, ('drift', 0.3), 0.5), ('chain3', 2, ('drift', 0.3), 1.5),
    *((*one, ('stuck', 0.0), duration) for *one, duration in (
        ('paper', 1, 1.0), ('chain3', 1, 0.1), ('chain3', 2, 1.0), ('ur10', 1, 0.3))),
])  # fmt: skip
def test_given_a_fault_when_it_ends_then_bounds_hold_its_jump(arm, joint, fault, duration):
    run = Run(arm, 'derived', fault, joint, duration)
    assert run.after == 0.0
    assert {sensor for _, sensor, _ in run.events} <= {run.name}


@pytest.mark.parametrize(('arm', 'joint', 'rate'), [
    ('chain3', 2, -0.3), ('swinging', 1, -0.1), ('coarse', 1, 0.1), ('coarse', 1, 0.3),
])  # fmt: skip
def test_given_a_drift_that_nobody_has_named_yet_then_bounds_hold_it(arm, joint, rate):
    run = Run(arm, 'derived', ('drift', rate), joint, 2.0)
    assert run.during == run.after == 0.0
    assert run.events == [('RAISED', run.name, 'drift'), ('CLEARED', run.name, 'drift')]


@pytest.mark.parametrize('duration', [0.99, 1.0, 1.01])
def test_given_a_jump_within_an_interval_then_balances_are_those_of_whole_ones(
    monkeypatch, duration
):
    asked = []

    def course(estimator, joint, frozen, balances, blocks):
        asked.append(1)
        at = recent(estimator.window, len(blocks) // estimator.plan.blocks - 1)[::-1]
        again, held = estimator.rows_of(blocks), estimator.window.rows[at]
        # The very first balance was made before there was an epoch to count drifts from.
        np.testing.assert_allclose(again[1:], held[1:], rtol=1e-9, atol=1e-9)

    monkeypatch.setattr(end_of_fault, 'course_of_frozen', course)
    Run('paper', 'derived', ('stuck', 0.0), 1, duration)
    assert asked


def test_given_a_jump_that_hardly_was_an_end_then_bounds_hold_that_as_long_as_other_errors():
    """Half a percent is less than a name may be wrong by, and more than what bounds leave out."""
    (cell,) = cells(['coarse'], [False], ['derived'], [BY_NAME['drift 0.1']])
    assert made.run(cell, 414).outside == 0.0


def test_given_a_drift_that_nobody_named_when_it_ends_then_the_alarm_of_its_jump_is_cleared():
    run = Run('paper', 'derived', ('drift', 0.2), 0, 1.5)
    assert run.events == [('RAISED', run.name, 'bias'), ('CLEARED', run.name, 'bias')]
    assert abs(run.estimate[-1, 0]) < 0.1


@pytest.mark.parametrize(('arm', 'k'), [('real_arm', 3), ('pausing', 2)])
def test_given_an_offset_that_nobody_named_when_it_ends_then_the_alarm_of_its_jump_holds_none(
    arm, k
):
    (cell,) = cells([arm], [False], ['independent'], [BY_NAME['offset 0.2']])
    subject, window, _ = draw(cell, k, 101)
    alarm = subject.answers(window.stream).events[0][1]
    assert alarm.detected >= window.stream.stamps[0] + window.faults[0].end * 1e9
    assert abs(alarm.size) == pytest.approx(0.2, abs=0.01)
    assert abs(alarm.size) < alarm.bound


@pytest.mark.parametrize(('arm', 'kind', 'k', 'seed'), [
    ('coarse', 'drift 0.05', 8, 101), ('pausing', 'drift 0.1', 12, 202),
])  # fmt: skip
def test_given_an_end_that_passes_for_a_scale_error_then_bounds_still_hold_none(arm, kind, k, seed):
    (cell,) = cells([arm], [False], ['derived'], [BY_NAME[kind]])
    subject, window, _ = draw(cell, k, seed)
    answers, (first, second) = subject.answers(window.stream), window.faults
    own = [one for _, one in answers.events if one.sensor_index == first.sensor]
    (alarm,) = [one for one in own if one.kind == 'scale' and one.event is AlarmEvent.UPDATED]
    assert alarm.detected > window.stream.stamps[0] + first.end * 1e9
    assert abs(alarm.size) < alarm.bound
    span = first.end + SETTLED, second.onset
    assert outside_bounds(answers, window.stream.stamps, window.truth, span) < 0.01


@pytest.mark.parametrize(('arm', 'k'), [('pausing', 1), ('chain3', 2)])
def test_given_a_drift_that_nobody_named_when_it_ends_in_a_gap_then_its_alarm_holds_none(arm, k):
    subject = _subject(arm).with_rates('derived')
    part, drift = derived(subject.streams(k)).part(2.0, 8.0), Injected(0, ONSET, ONSET + 0.6, -0.2)
    matrix = np.eye(len(subject.arm.joints))
    window = inject(part, replace(BY_NAME['drift 0.3'], size=1.0), [drift], True, matrix, None)
    missing = slice(*map(window.stream.index, (ONSET + 0.5, ONSET + 0.7)))
    window.stream.samples[missing, :2, 0] = np.nan
    (alarm,) = [one for _, one in subject.answers(window.stream).events if one.kind == 'bias']
    assert alarm.detected >= window.stream.stamps[missing.stop]
    assert 0.1 < abs(alarm.size) < alarm.bound


@pytest.mark.parametrize(('arm', 'rate', 'duration'), [('chain3', -0.05, 1.0), ('ur10', 0.05, 4.0)])
def test_given_a_drift_taken_for_a_scale_error_when_it_ends_then_alarms_are_as_sure_as_estimates(
    arm, rate, duration
):
    run = Run(arm, 'independent', ('drift', rate), 0, duration)
    updates = [one for one in run.answers.events if one[1].event is AlarmEvent.UPDATED]
    assert updates[-1][1].detected >= run.stamps[0] + run.end * 1e9
    for row, alarm in updates:
        assert alarm.bound == pytest.approx(run.bound[row, 0])
        assert abs(alarm.size - run.truth[row, 0]) < alarm.bound


@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('size', [0.15, -0.3])
def test_given_an_offset_that_begins_with_a_jump_then_its_bound_does_not_stay_wide(rates, size):
    run = Run('chain3', rates, ('bias', size), 1, 9.0)
    assert run.during == 0.0
    assert abs(run.estimate[run.acting, 1] - size).max() < 0.05
    assert np.median(run.bound[run.acting, 1]) < 0.1
    assert [event for event, *_ in run.events] == ['RAISED', 'CLEARED']


@pytest.mark.parametrize(('arm', 'rates', 'fault', 'joint'), [
    *((arm, 'independent' if arm == 'paper' else 'derived', fault, 1)
      for arm in ('chain3', 'ur10', 'paper')
      for fault in (('scale', 0.2), ('scale', -0.1), ('bias', 0.2))),
    ('chain3', 'derived', ('scale', 0.45), 1), ('chain3', 'independent', ('scale', 0.45), 1),
    ('paper', 'independent', ('scale', 0.45), 1), ('ur10', 'derived', ('scale', -0.4), 2),
    ('ur10', 'independent', ('scale', 0.2), 2), ('ur10', 'independent', ('scale', 0.45), 4),
])  # fmt: skip
def test_given_a_jump_in_motion_then_offset_and_scale_error_are_told(arm, rates, fault, joint):
    run, (kind, _) = Run(arm, rates, fault, joint, 3.0), fault
    updated = [('UPDATED', run.name, 'scale')] if kind == 'scale' else []
    assert run.events == [('RAISED', run.name, 'bias'), *updated, ('CLEARED', run.name, kind)]
    assert run.during == run.after == 0.0
    settled = run.acting & (run.time > ONSET + 2.0)
    assert abs(run.estimate - run.truth)[settled, joint].max() < 0.03
    assert abs(run.estimate[-1, joint]) < 0.05


def test_given_a_frozen_count_when_it_goes_on_from_there_then_bounds_hold_the_way_lost():
    run = Run('chain3', 'derived', ('stuck', 0.0), 1, 0.5, count_lost=True)
    assert abs(run.truth[-1, 1]) > 0.1
    assert run.after == 0.0


@pytest.mark.parametrize('arm', ['chain3', 'real_arm'])
def test_given_a_drift_beside_a_known_offset_when_it_ends_then_the_offset_remains(arm):
    run = Run(arm, 'derived', ('drift', 0.3), 1, 1.5, beside=0.1)
    assert run.after == 0.0
    assert {event for event, *_ in run.events} == {'RAISED', 'UPDATED'}
    assert run.estimate[-1, 1] == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize('size', [-2.0, 1.2])
def test_given_a_jump_too_large_for_linear_rows_then_its_bound_holds_the_healthy_reading(size):
    run = Run('chain3', 'derived', ('bias', size), 1, 3.0)
    assert run.during == 0.0
    assert (run.bound[run.acting, 1] > abs(size)).all()


@pytest.mark.parametrize('arm', ['ur10', 'chain3'])
def test_given_a_jump_where_samples_are_missing_then_bounds_grow_by_what_may_be_hidden(arm):
    run, healthy = (Run(arm, 'derived', ('bias', size), 1, 4.0, lost=8) for size in (0.02, 0.0))
    assert run.during < 0.05
    assert np.median(run.bound[run.acting, 1]) > 1.05 * np.median(healthy.bound[run.acting, 1])
    assert healthy.events == []


@pytest.mark.parametrize('arm', ['chain3', 'ur10', 'panda'])
def test_given_a_reading_that_stays_frozen_when_its_joint_goes_on_then_it_is_followed(arm):
    """Its joint is carried on by momentum, torques and gravity."""
    (cell,) = cells([arm], [False], ['derived'], [BY_NAME['stuck']])
    last, trusted, wrong = [], [], []
    for k in range(6):
        subject, window, _ = draw(cell, k, 11)
        fault = window.faults[0]
        stream = window.stream.part(0.0, fault.onset + 2.0)
        answers = subject.answers(stream)
        # From the time at which it is named in any case.
        acts = slice(stream.index(fault.onset + 0.3), len(stream.stamps))
        error = np.abs(answers.fault.estimate[acts] - window.truth[acts])[:, fault.sensor]
        last.append(error[-1])
        trusted.extend(answers.state.trustworthy[acts])
        wrong.extend(error > answers.fault.bound[acts, fault.sensor])
    assert np.median(last) < 0.1
    assert (np.array(last) < 0.1).sum() >= 4
    assert np.mean(trusted) > 0.9
    assert (np.array(trusted) & np.array(wrong)).mean() < 0.02


@pytest.mark.parametrize(('arm', 'joints', 'apart'), [
    ('chain3', (1, 2), 0.3), ('chain3', range(3), 0.0), ('ur10', range(6), 0.0),
    ('panda', range(7), 0.0),
])  # fmt: skip
def test_given_readings_that_freeze_together_then_all_are_named(arm, joints, apart):
    subject, end, wrong = _subject(arm).with_rates('derived'), ONSET + 2.0, []
    faults = [Injected(i, ONSET + k * apart, end) for k, i in enumerate(joints)]
    names, last = subject.arm.sensor_names, faults[-1].onset
    for k in range(10):
        part = derived(subject.streams(k)).part(2.0, 2.0 + end)
        window = inject(part, BY_NAME['stuck'], faults, True, np.eye(len(names)), None)
        stamps, answers = window.stream.stamps, subject.answers(window.stream)
        raised = {
            one.sensor for _, one in answers.events
            if one.kind == 'stuck' and (one.detected - stamps[0]) * 1e-9 < last + 0.65
        }  # fmt: skip
        assert apart or raised == {names[i] for i in joints}
        wrong.append(outside_bounds(answers, stamps, window.truth, (last + SETTLED, end)))
    assert np.mean(wrong) < 0.1


@pytest.mark.parametrize('arm', ['chain3', 'ur10'])
def test_given_a_reading_that_drops_to_zero_and_stays_there_then_no_rate_is_blamed(arm):
    subject, joint = _subject(arm).with_rates('independent'), 1
    for k in range(3):
        stream = subject.streams(k).part(2.0, 8.0)
        truth, dead = np.zeros_like(stream.samples[:, 0]), stream.index(ONSET)
        truth[dead:, joint] = -stream.samples[dead:, 0, joint]
        samples = stream.samples.copy()
        samples[:, 0] += truth
        answers = subject.answers(replace(stream, samples=samples))
        assert {one.kind for _, one in answers.events} <= {'bias', 'stuck'}
        span = ONSET + SETTLED, ONSET + 2.0
        assert outside_bounds(answers, stream.stamps, truth, span) < 0.02


@pytest.mark.parametrize('back', [ONSET + 1.0, ONSET + 2.0])
@pytest.mark.parametrize('kept', [0.0, 1.0])
@pytest.mark.parametrize('arm', ['real_arm', 'chain3', 'ur10'])
def test_given_a_rate_that_freezes_with_its_reading_then_it_is_not_believed(arm, kept, back):
    """Its sensor reads 0, or what it read last, until the rate comes back."""
    subject, joint, wrong = _subject(arm).with_rates('independent'), 1, []
    for k in range(3):
        stream = subject.streams(k).part(2.0, 4.0 + ONSET)
        matrix = subject.arm.joints_to_sensors()
        fault = Injected(joint, ONSET, ONSET + 2.1)
        window = inject(stream, BY_NAME['stuck'], [fault], False, matrix, None)
        samples = window.stream.samples.copy()
        frozen = slice(stream.index(ONSET), stream.index(back))
        rates = samples[:, 1] @ matrix.T
        rates[frozen, joint] = kept * rates[frozen.start - 1, joint]
        samples[:, 1] = rates @ np.linalg.inv(matrix).T
        answers = subject.answers(replace(stream, samples=samples))
        assert {one.kind for _, one in answers.events} == {'stuck'}
        span = ONSET + SETTLED, ONSET + 2.0
        wrong.append(outside_bounds(answers, stream.stamps, window.truth, span))
    assert np.mean(wrong) < 0.05


def test_given_a_loop_closed_on_a_frozen_reading_then_its_joint_is_followed_all_the_same():
    """It accelerates ten times as much as the arm usually does."""
    arm, wrong = shoulder_arm(), []
    for seed in range(6):
        run = simulated(arm, Fault('encoder2', 'stuck', 4.0), duration=5.0, seed=seed)
        answers, truth = answered(arm, run), run.samples[:, 0] - run.position
        wrong.append(outside_bounds(answers, run.stamps, truth, (4.0, 5.0)))
        assert {event.kind for _, event in answers.events} == {'stuck'}
    assert np.mean(wrong) < 0.15


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_given_a_fast_drift_of_a_joint_that_bears_the_arm_then_it_is_named(sign):
    """Free torques explain the balance of its onset as well, and nothing after it."""
    subject = _subject('ur10').with_rates('derived')
    stream = derived(subject.streams(0)).part(1.0, 9.0)
    kind = replace(BY_NAME['drift 0.3'], size=0.8)
    window = inject(stream, kind, [Injected(1, ONSET, 9.0, sign)], True, np.eye(6), None)
    answers = subject.answers(window.stream)
    (_, event), *others = answers.events
    delay = (event.detected - window.stream.stamps[0]) * 1e-9 - ONSET
    assert (event.kind, others) == ('drift', []) and delay < 0.8
    span = ONSET + 0.8, 8.0
    assert outside_bounds(answers, window.stream.stamps, window.truth, span) < 0.02


def test_given_noise_that_begins_in_a_balance_then_its_size_is_told_and_no_other_is_blamed():
    cell = next(cells(['panda'], [False], ['derived'], [BY_NAME['noise 0.02']]))
    subject, window, _ = draw(cell, 3, 1)
    events = [event for _, event in subject.answers(window.stream).events]
    faulty = {subject.arm.sensor_names[fault.sensor] for fault in window.faults}
    assert {event.sensor for event in events} == faulty
    sizes = [event.size for event in events if event.kind == 'noise']
    assert sizes == pytest.approx([0.02, 0.02], rel=0.5)


def test_given_noise_whose_first_jump_may_be_a_wrong_stamp_when_it_ends_then_no_offset_is_left():
    (cell,) = cells(['swinging'], [False], ['independent'], [BY_NAME['noise 0.02']])
    subject, window, _ = draw(cell, 0, 1)
    first, end = window.faults[0], window.faults[1].onset
    events = subject.answers(window.stream.part(0.0, end)).events
    assert {event.sensor for _, event in events} == {subject.arm.sensor_names[first.sensor]}
    assert [event.kind for _, event in events][-2:] == ['noise', 'noise']
    assert events[-1][1].event.name == 'CLEARED'


@pytest.mark.parametrize('seed', [6, 12])
def test_given_a_reading_frozen_where_its_joint_turns_when_it_jumps_back_then_bounds_hold_it(seed):
    """Friction holds the joint, says a file that states five times as much as there is."""
    stated = made.with_joints(shoulder_arm(), friction={'viscous': 8.0, 'coulomb': 1.0})
    true = made.with_joints(stated, friction={'viscous': 1.6, 'coulomb': 0.2})
    stream = derived(made.simulate(true, (np.zeros(3), np.full(3, 0.8), np.ones(3)), seed))
    samples, time = stream.samples.copy(), (stream.stamps - stream.stamps[0]) * 1e-9
    rate = np.convolve(samples[:, 1, 2], np.ones(11) / 11.0, 'same')
    turn = np.flatnonzero((rate[:-1] * rate[1:] < 0.0) & (time[:-1] > 8.0))[0]
    frozen = (time >= time[turn]) & (time < time[turn] + 2.0)
    samples[frozen, 0, 2], samples[frozen, 1, 2] = samples[turn, 0, 2], 0.0
    answers = answered(stated, replace(stream, samples=samples))
    truth = samples[:, 0] - stream.samples[:, 0]
    assert abs(truth).max() > 0.2
    span = time[turn] + 2.0 + SETTLED, time[-1]
    assert outside_bounds(answers, stream.stamps, truth, span) == 0.0


@pytest.mark.parametrize('run', [1008, 1032])
def test_given_a_frozen_reading_when_it_jumps_back_then_no_drift_begins_there(run):
    """Until then, its rate was only estimated: that of the reading seems to jump."""
    subject, window, _ = draw(made.Cell('ur10e', (twin(),), BY_NAME['stuck'], 'derived'), run, 31)
    assert {event.kind for _, event in subject.answers(window.stream).events} == {'stuck'}


@pytest.mark.parametrize(('arm', 'seed', 'joint', 'hold'), [
    ('chain3', 0, 2, 0.2), ('real_arm', 1, 0, 0.2), ('ur10', 0, 3, 0.2), ('ur10', 0, 3, 0.7),
])  # fmt: skip
def test_given_a_reading_that_freezes_again_and_again_then_bounds_hold(arm, seed, joint, hold):
    """An encoder that is read too rarely: a new reading every so many seconds."""
    subject = _subject(arm).with_rates('derived')
    healthy = derived(subject.streams(seed)).part(0.0, 14.0)
    time, samples = (healthy.stamps - healthy.stamps[0]) * 1e-9, healthy.samples.copy()
    matrix = subject.arm.joints_to_sensors()
    right = samples[:, 0] @ matrix.T
    acts = (time > 5.0) & (time < 12.0)
    read = np.searchsorted(time, 5.0 + np.floor((time[acts] - 5.0) / hold) * hold)
    held = right.copy()
    held[acts, joint] = right[read, joint]
    samples[:, 0] = held @ np.linalg.inv(matrix).T
    stream = derived(replace(healthy, samples=samples))
    answers = subject.answers(stream)
    assert outside_bounds(answers, stream.stamps, held - right, (5.0 + SETTLED, 14.0)) < 0.05
    names = [(event.event.name, event.sensor) for _, event in answers.events]
    assert names.count(('RAISED', subject.arm.sensor_names[joint])) == 1
    assert {name for _, name in names} == {subject.arm.sensor_names[joint]}
    assert names[-1][0] == 'CLEARED'
