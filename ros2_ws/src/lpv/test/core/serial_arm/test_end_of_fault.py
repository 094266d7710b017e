"""Faults that end with a jump, noticed before or not: no trusted estimate is outside its bound."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fault_injection import BY_NAME, Injected, derived, inject, outside_bounds, subjects

pytestmark = pytest.mark.slow
ONSET, AFTER = 4.0, 4.0
"""Of the fault, and time that is watched after its end [s]."""
SETTLED = 0.1
"""After a change, until samples that waited are used [s]."""


class Run:
    """One fault of one sensor of a simulated arm, and what the monitor says."""

    def __init__(self, arm, rates, fault, joint, duration, count_lost=False, lost=0, beside=0.0):
        subject = _subject(arm).with_rates(rates)
        self.name = subject.arm.sensor_names[joint]
        stream = subject.streams(joint)
        stream = derived(stream) if rates == 'derived' else stream
        part = stream.part(2.0, 2.0 + ONSET + duration + AFTER)
        kind, size = fault
        kind = replace(BY_NAME['step 0.1'], kind=kind, size=abs(size))
        one = Injected(joint, ONSET, ONSET + duration, float(np.sign(size)) or 1.0)
        matrix = subject.arm.joints_to_sensors()
        window = inject(part, kind, [one], rates == 'derived', matrix, np.random.default_rng(1))
        stamps, samples, self.truth = window.stream.stamps, window.stream.samples, window.truth
        self.time = (stamps - stamps[0]) * 1e-9
        self.end = ONSET + duration
        if count_lost:  # counting goes on from where it stopped
            later = self.time >= self.end
            way = self.truth[~later, joint][-1]
            samples[later, 0, joint] += way
            self.truth[later, joint] += way
            if rates == 'derived':
                samples[np.argmax(later), 1, joint] = samples[np.argmax(later) + 1, 1, joint]
        later = self.time >= 2.0  # another offset, from then on
        samples[later, 0, joint] += beside
        self.truth[later, joint] += beside
        if lost:  # samples are missing around the onset
            onset = np.searchsorted(self.time, ONSET)
            kept = np.ones(len(stamps), bool)
            kept[onset - lost // 2 : onset + (lost + 1) // 2] = False
            stamps, samples, self.truth = stamps[kept], samples[kept], self.truth[kept]
            self.time = self.time[kept]
        answers = subject.monitor().take_many(stamps, *np.moveaxis(samples, 1, 0))
        self.answers, self.stamps = answers, stamps
        self.estimate, self.bound = answers.fault.estimate, answers.fault.bound
        self.events = [
            (alarm.event.name, alarm.sensor, alarm.kind) for _, alarm in answers.events
        ]  # fmt: skip

    def outside(self, begin, end):
        """Share of answers that are trusted with an estimate outside its bound."""
        return outside_bounds(self.answers, self.stamps, self.truth, (begin, end))

    @property
    def after(self):
        return self.end + SETTLED, self.end + AFTER


@cache
def _subject(arm):
    return subjects(arm, recorded=False)[0]


@pytest.mark.parametrize(
    ('arm', 'joint', 'rate', 'duration'),
    [
        ('paper', 0, 0.1, 3.0),
        ('paper', 1, -0.3, 1.5),
        ('real_arm', 1, -0.3, 0.5),
        ('real_arm', 0, -0.05, 4.0),
        ('chain3', 1, 0.3, 0.5),
        ('chain3', 2, 0.3, 1.5),
    ],
)
def test_given_a_drift_when_it_ends_with_a_jump_then_bounds_hold_it(arm, joint, rate, duration):
    run = Run(arm, 'derived', ('drift', rate), joint, duration)
    assert run.outside(*run.after) == 0.0
    assert all(sensor == run.name for _, sensor, _ in run.events)


def test_given_a_drift_that_nobody_named_when_it_ends_then_the_alarm_of_its_jump_is_cleared():
    run = Run('paper', 'derived', ('drift', 0.3), 0, 1.5)
    assert run.events == [('RAISED', run.name, 'bias'), ('CLEARED', run.name, 'bias')]
    assert abs(run.estimate[-1, 0]) < 0.1


@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('size', [0.15, -0.3])
def test_given_an_offset_that_begins_with_a_jump_then_its_bound_does_not_stay_wide(rates, size):
    run = Run('chain3', rates, ('bias', size), 1, 9.0)
    acting = (run.time > ONSET + SETTLED) & (run.time < run.end)
    assert run.outside(ONSET + SETTLED, run.end) == 0.0
    assert abs(run.estimate[acting, 1] - size).max() < 0.05
    assert np.median(run.bound[acting, 1]) < 0.1
    assert [event for event, *_ in run.events] == ['RAISED', 'CLEARED']


@pytest.mark.slow
@pytest.mark.parametrize(
    ('arm', 'joint', 'duration'),
    [('paper', 1, 1.0), ('chain3', 1, 0.1), ('chain3', 2, 1.0), ('ur10', 1, 0.3)],
)
def test_given_a_frozen_reading_when_it_jumps_to_its_joint_then_it_is_right(arm, joint, duration):
    run = Run(arm, 'derived', ('stuck', 0.0), joint, duration)
    assert run.outside(*run.after) == 0.0
    assert not any(event == 'RAISED' and sensor != run.name for event, sensor, _ in run.events)


def test_given_a_frozen_count_when_it_goes_on_from_there_then_bounds_hold_the_way_lost():
    run = Run('chain3', 'derived', ('stuck', 0.0), 1, 0.5, count_lost=True)
    assert abs(run.truth[-1, 1]) > 0.1
    assert run.outside(*run.after) == 0.0


@pytest.mark.parametrize('arm', ['chain3', 'real_arm'])
def test_given_a_drift_beside_a_known_offset_when_it_ends_then_the_offset_remains(arm):
    run = Run(arm, 'derived', ('drift', 0.3), 1, 1.5, beside=0.1)
    assert run.outside(*run.after) == 0.0
    assert {event for event, *_ in run.events} == {'RAISED', 'UPDATED'}
    assert run.estimate[-1, 1] == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize('size', [-2.0, 1.2])
def test_given_a_jump_too_large_for_linear_rows_then_its_bound_holds_the_healthy_reading(size):
    run = Run('chain3', 'derived', ('bias', size), 1, 3.0)
    assert run.outside(ONSET + SETTLED, run.end) == 0.0
    acting = (run.time > ONSET + SETTLED) & (run.time < run.end)
    assert (run.bound[acting, 1] > abs(size)).all()


@pytest.mark.parametrize(('arm', 'rates'), [('ur10', 'derived'), ('chain3', 'derived')])
def test_given_a_jump_where_samples_are_missing_then_bounds_grow_by_what_may_be_hidden(arm, rates):
    run = Run(arm, rates, ('bias', 0.02), 1, 4.0, lost=8)
    healthy = Run(arm, rates, ('bias', 0.0), 1, 4.0, lost=8)
    acting = slice(np.searchsorted(run.time, ONSET + SETTLED), np.searchsorted(run.time, run.end))
    assert run.outside(ONSET + SETTLED, run.end) < 0.05
    assert np.median(run.bound[acting, 1]) > 1.1 * np.median(healthy.bound[acting, 1])
    assert healthy.events == []
