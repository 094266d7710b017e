"""What the diagnosis finds: a part of `benchmarks/fault_matrix.py`, cell by cell.

A cell is a fault (kind and size) of an arm whose rates come from somewhere.  Runs are drawn from
seeds, so that a cell says the same each time.  What a cell does not keep is in `LOST`, with the
reason that benchmarks/README.md gives.
"""

import json
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from fault_injection import BY_NAME, CLOSE, DATA, cells, draw, outside_bounds, run
from fault_matrix import BAR, COMPARED, KEY, compared, summary

from lpv import AlarmEvent, DiagnosisParameters

pytestmark = pytest.mark.slow

RUNS = 3
MORE_RUNS = {'chain3 derived stuck': 9}
"""Of cells whose share of second faults beside the first, every other run, is not nearly all."""
FAULTS = {
    'paper independent': (
        'offset 0.2,step 0.02,drift 0.05,drift 0.3,scale 20 %,stuck,noise 0.02,dropout,rates wrap'
    ),
    'paper derived': 'step 0.02,step 0.1,noise 0.02,rates wrap',
    'real_arm independent': 'drift 0.1,stuck,rate bias 0.1',
    'real_arm derived': 'offset 0.5,step 0.02,step 0.1,drift 0.05,drift 0.3,stuck',
    'swinging derived': 'offset 0.2,step 0.02,drift 0.1,noise 0.02',
    'chain3 independent': 'drift 0.05,stuck,dropout',
    'chain3 derived': 'step 0.02,drift 0.3,scale 20 %,stuck,noise 0.02,rates wrap',
    'pausing independent': 'step 0.1,noise 0.02',
    'pausing derived': 'step 0.02,step 0.1,noise 0.02',
    'ur10 derived': 'drift 0.02',
    'recorded real_arm derived': (
        'offset 0.5,step 0.02,drift 0.1,drift 0.3,scale 20 %,stuck,noise 0.02,dropout,rates wrap'
    ),
    'recorded ur10 independent': 'offset 0.2,drift 0.05,drift 0.3',
    'recorded ur10 derived': 'scale 20 %,stuck,rates wrap',
    'recorded panda derived': 'offset 0.5,step 0.02',
}
HEALTHY = {
    'paper independent': 'healthy,push',
    'paper derived': 'stamps off,rest 0.1 mrad,rest 1 mrad',
    'real_arm derived': 'payload',
    'swinging independent': 'healthy,stamps off,gaps',
    'swinging derived': 'stamps off,stamps off differenced,bursts,repeated,gaps',
    'chain3 independent': 'payload,rest 1 mrad',
    'chain3 derived': 'push,rest 0.1 mrad,rest 1 mrad',
    'pausing derived': 'healthy,push,stamps off,stamps off differenced,bursts,repeated,gaps',
    'coarse derived': 'healthy,stamps off,stamps off differenced',
    'recorded real_arm derived': 'healthy,stamps off,repeated,gaps',
    'recorded ur10 independent': 'healthy,gaps',
    'recorded panda derived': 'healthy',
}
CLAIMS = ('named', 'kind', 'size', 'ends', 'bar')
SLOW = 'derived rates: a drift shows in gravity and inertia alone, and is named after 0.8 to 1.5 s'
PUSHED = 'derived rates: a smooth force on the tip explains 2.5 s of a drift of 0.1 rad/s as well'
WAY = 'derived rates: 2 s after a reading froze, momentum and gravity leave 0.1 to 0.4 rad'
HARDLY = 'derived rates: a joint that hardly moves when its reading freezes is missed for a second'
BESIDE = 'derived rates: a drift beside another one is found in half of the runs'
LOST = {
    'real_arm derived drift 0.05': ('ends', BESIDE),
    'real_arm derived drift 0.3': ('ends', SLOW),
    'recorded real_arm derived drift 0.1': ('size', PUSHED),
    'recorded real_arm derived stuck': ('size', WAY),
    'recorded ur10 derived stuck': ('size', WAY),
    'real_arm derived stuck': ('ends', HARDLY),
    'chain3 derived stuck': ('size', WAY),
}
"""Claims that a cell does not keep, and why."""


def chosen(table, claims):
    for place, kinds in table.items():
        for kind in kinds.split(','):
            for claim in claims:
                known, why = LOST.get(f'{place} {kind}', ('', ''))
                marks = []
                if claim in known.split():
                    marks = [pytest.mark.xfail(reason=why, strict=True)]
                if place.startswith('recorded') and not DATA.is_dir():
                    marks = [pytest.mark.skip(reason='no recordings, see $LPV_RECORDINGS')]
                yield pytest.param(place, kind, claim, marks=marks, id=f'{place} {kind}: {claim}')


@cache
def found(place, kind):
    *recorded, arm, rates = place.split()
    (cell,) = cells([arm], [bool(recorded)], [rates], [BY_NAME[kind]])
    return cell, [run(cell, k) for k in range(MORE_RUNS.get(f'{place} {kind}', RUNS))]


@cache
def bar():
    """Rows of the better one of the two engines before, by cell."""
    return {tuple(row[name] for name in KEY): row for row in json.loads(BAR.read_text())}


def most(values):
    """Whether at least two of three are true, of what is known."""
    known = [value for value in values if value is not None]
    return 3 * sum(known) >= 2 * len(known)


def shares_below_the_bar(place, kind):
    """Shares of a cell that are worse than the bar by more than single runs."""
    row = summary(*found(place, kind))
    other = bar().get(tuple(row[name] for name in KEY))
    shares = compared(row, other) if other else {}
    return {name: (a, b) for name, (a, b) in shares.items() if (a - b) * COMPARED[name] < 0.0}


@pytest.mark.parametrize(('place', 'kind', 'claim'), list(chosen(FAULTS, CLAIMS)))
def test_given_a_fault_when_it_acts_and_ends_then_what_is_said_of_it_is_true(place, kind, claim):
    runs = found(place, kind)[1]
    assert not any(one.crash for one in runs)
    if claim == 'named':
        assert most(one.in_time for one in runs) and not any(one.other for one in runs)
    elif claim == 'kind':
        assert most(one.kind_right for one in runs)
    elif claim == 'size':
        known = [one for one in runs if one.error is not None]
        assert most(one.error <= CLOSE for one in known)
        # Before its fault is named, an estimate may be far off; then its bound says so.
        assert not any(one.error > max(CLOSE, one.bound) and one.trusted for one in known)
    elif claim == 'ends':
        assert all(one.cleared is not False for one in runs)
        assert most(one.second for one in runs) and most(one.both for one in runs)
        assert all(one.events <= 10 for one in runs)
    else:
        assert shares_below_the_bar(place, kind) == {}


@pytest.mark.parametrize(('place', 'kind', 'claim'), list(chosen(HEALTHY, ['quiet'])))
def test_given_healthy_encoders_when_something_else_happens_then_none_is_blamed(place, kind, claim):
    runs = found(place, kind)[1]
    assert [(one.crash, one.alarms) for one in runs] == [('', [])] * len(runs)


@pytest.mark.parametrize('size', [0.03, 0.08])
@pytest.mark.parametrize('place', ['paper independent', 'swinging independent', 'chain3 derived'])
def test_given_a_jump_below_the_smallest_step_when_it_lasts_then_nothing_is_raised(place, size):
    arm, rates = place.split()
    kind = replace(BY_NAME['step 0.1'], size=size, duration=8.0, limit=8.0)
    (cell,) = cells([arm], [False], [rates], [kind])
    for k in range(2):
        subject, window, _ = draw(cell, k, 1)
        monitor, stream = subject.monitor(), window.stream.part(0.0, window.faults[0].end)
        monitor.retune(DiagnosisParameters(smallest_step=0.1, minimum_threshold=0.1))
        answers = monitor.take_many(stream.stamps, *stream.samples.swapaxes(0, 1))
        assert [(alarm.sensor, alarm.kind) for _, alarm in answers.events] == []
        found = answers.fault.estimate[-1] - window.truth[len(stream.stamps) - 1]
        assert (np.abs(found) < answers.fault.bound[-1]).all()


def last_kind(cell, k):
    subject, window, _ = draw(cell, k, 1)
    fault = window.faults[0]
    events = subject.answers(window.stream.part(0.0, fault.end)).events
    own = [one for _, one in events if one.sensor == subject.arm.sensor_names[fault.sensor]]
    return [one.kind for one in own if one.event != AlarmEvent.CLEARED][-1:]


@pytest.mark.parametrize(('arm', 'least', 'first'), [
    ('real_arm', 4, (0, 2, 4, 7)), ('chain3', 4, (4, 5, 1, 2)), ('ur10', 6, (1, 7, 0, 6, 3, 4)),
])  # fmt: skip
def test_given_a_reading_that_never_changed_then_it_is_named(arm, least, first):
    """A sensor frozen from the first sample; a joint that rests reads the same.

    Of eight runs no more are made than it takes: those that are not named take longest.
    """
    kind = replace(BY_NAME['stuck'], from_start=True, limit=15.0, duration=15.5)
    (cell,) = cells([arm], [False], ['derived'], [kind])
    found = (k for k in dict.fromkeys((*first, *range(8))) if last_kind(cell, k) == ['stuck'])
    assert len(list(islice(found, least))) == least


@pytest.mark.parametrize(('arm', 'runs'), [('chain3', (2, 10)), ('pausing', (0, 5))])
def test_given_a_rate_bias_that_began_beside_the_starts_then_it_is_named(arm, runs):
    """Where its window begins elsewhere, the balances hold no jump of the momentum there."""
    (cell,) = cells([arm], [False], ['independent'], [BY_NAME['rate bias 0.1']])
    assert [run(cell, k, 7).kind for k in runs] == ['rate_bias'] * len(runs)


def test_given_a_rate_bias_that_its_noise_hides_for_long_then_its_alarm_stays():
    (cell,) = cells(['swinging'], [False], ['independent'], [BY_NAME['rate bias 0.1']])
    for k in range(4):
        subject, window, _ = draw(cell, k, 3)
        stream, (fault, *_) = window.stream, window.faults
        answers = subject.answers(stream)
        name, end = subject.arm.sensor_names[fault.sensor], stream.stamps[0] + fault.end * 1e9
        own = [one for _, one in answers.events if one.sensor == name and one.detected < end]
        assert [(one.kind, one.event.name) for one in own] == [('rate_bias', 'RAISED')]


@pytest.mark.parametrize('arm', ['real_arm', 'chain3'])
def test_given_a_frozen_reading_when_its_link_turns_back_then_the_other_side_is_not_trusted(arm):
    """Near the horizontal, gravity is the same for a link that goes on and one that turns back."""
    kind = replace(BY_NAME['stuck'], limit=14.0, duration=14.5)
    (cell,) = cells([arm], [False], ['derived'], [kind])
    outside = []
    for k in range(8):
        subject, window, _ = draw(cell, k, 1)
        fault, span = window.faults[0], (window.faults[0].onset + 1.0, window.faults[0].end)
        stream, truth = window.stream.part(0.0, fault.end), window.truth
        answers = subject.answers(stream)
        outside.append(outside_bounds(answers, stream.stamps, truth[: len(stream.stamps)], span))
    assert np.mean(outside) < 0.05, outside
