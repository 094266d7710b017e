"""What the diagnosis has to find: a quick part of `benchmarks/fault_matrix.py`.

Every engine gets the same faults.  A claim that an engine does not keep is an xfail with the
engine's name; not a strict one, as figures that are near their limits depend on the processor.
"""

from functools import cache

import pytest
from fault_injection import BY_NAME, CLOSE, DATA, ENGINES, cells, run

pytestmark = pytest.mark.slow

FAULTS = {
    'paper independent': 'drift 0.05,drift 0.3,scale 20 %,stuck,noise 0.02,dropout,rate bias 0.1',
    'real_arm derived': 'step 0.1,drift 0.3,stuck',
    'chain3 independent': 'drift 0.05,stuck',
    'chain3 derived': 'step 0.02,drift 0.3,noise 0.02,dropout',
    'recorded real_arm derived': (
        'offset 0.5,step 0.02,drift 0.1,drift 0.3,stuck,noise 0.02,dropout'
    ),
    'recorded real_arm independent': 'drift 0.05,rates wrap',
    'recorded panda derived': 'step 0.02,drift 0.3',
    'recorded kr300 independent': 'step 0.02',
}
HEALTHY = {
    'paper independent': 'push',
    'chain3 independent': 'payload,rest 1 mrad',
    'chain3 derived': 'push,rest 0.1 mrad',
    'recorded real_arm derived': 'healthy,stamps off,gaps',
    'recorded panda derived': 'healthy',
}
CLAIMS = ('named', 'kind', 'size', 'ends', 'quiet')
FAILS: dict[str, dict[str, str]] = {
    'two_link': {
        'paper independent drift 0.05': 'quiet',
        'paper independent drift 0.3': 'quiet',
        'paper independent scale 20 %': 'kind',
        'paper independent stuck': 'quiet',
        'paper independent dropout': 'named kind size ends quiet',
        'paper independent rate bias 0.1': 'kind quiet',
        'real_arm derived drift 0.3': 'named kind size ends',
        'real_arm derived stuck': 'named kind size ends',
        'recorded real_arm derived offset 0.5': 'named kind size ends',
        'recorded real_arm derived step 0.02': 'named kind ends',
        'recorded real_arm derived drift 0.1': 'named kind size ends',
        'recorded real_arm derived drift 0.3': 'named kind size ends',
        'recorded real_arm derived stuck': 'named kind size ends',
        'recorded real_arm derived dropout': 'named kind ends',
        'recorded real_arm independent drift 0.05': 'kind',
        'recorded real_arm independent rates wrap': 'kind size',
        'recorded real_arm derived stamps off': 'healthy',
        'recorded real_arm derived gaps': 'healthy',
    },
    'serial': {
        'paper independent drift 0.05': 'kind',
        'paper independent stuck': 'kind size',
        'real_arm derived drift 0.3': 'named ends',
        'real_arm derived stuck': 'named size ends',
        'chain3 independent stuck': 'kind ends',
        'chain3 derived drift 0.3': 'named ends',
        'recorded real_arm derived drift 0.1': 'size ends',
        'recorded real_arm derived stuck': 'size ends',
        'recorded real_arm independent drift 0.05': 'named',
        'recorded real_arm independent rates wrap': 'named kind ends quiet',
        'recorded panda derived drift 0.3': 'ends',
        'chain3 independent rest 1 mrad': 'healthy',
        'recorded real_arm derived stamps off': 'healthy',
    },
}
"""Claims that an engine does not keep, by cell."""


def chosen(table, claims):
    """Parameters: engine, cell, claim."""
    for place, kinds in table.items():
        for kind in kinds.split(','):
            for engine in ENGINES:
                *recorded, arm, _ = place.split()
                if engine == 'two_link' and arm not in ('paper', 'real_arm'):
                    continue
                for claim in claims:
                    known = FAILS[engine].get(f'{place} {kind}', '').split()
                    marks = [pytest.mark.xfail(reason=engine)] if claim in known else []
                    if recorded and not DATA.is_dir():
                        marks = [pytest.mark.skip(reason='no recordings in ../shared/data')]
                    yield pytest.param(engine, place, kind, claim, marks=marks)


@cache
def verdicts(engine, place, kind):
    """Runs of a cell: two of a simulated arm, three of recordings."""
    *recorded, arm, rates = place.split()
    (cell,) = cells([arm], [bool(recorded)], [rates], [engine], [BY_NAME[kind]])
    return [run(cell, k) for k in range(3 if recorded else 2)]


def most(values):
    """Whether at least two of three are true, of what is known."""
    known = [value for value in values if value is not None]
    return 3 * sum(known) >= 2 * len(known)


@pytest.mark.parametrize(('engine', 'place', 'kind', 'claim'), chosen(FAULTS, CLAIMS))
def test_given_a_fault_when_it_acts_and_ends_then_what_is_said_of_it_is_true(
    engine, place, kind, claim
):
    found = verdicts(engine, place, kind)
    assert not any(one.crash for one in found)
    if claim == 'named':
        assert most(one.in_time for one in found)
        assert not any(one.other for one in found)
    elif claim == 'kind':
        assert most(one.kind_right for one in found)
    elif claim == 'size':
        assert most(one.error <= CLOSE for one in found if one.error is not None)
        assert not any(one.error > CLOSE and one.trusted for one in found if one.error is not None)
    elif claim == 'ends':
        assert all(one.cleared is not False for one in found)
        assert most(one.second for one in found) and most(one.both for one in found)
    else:
        assert all(one.events <= 10 for one in found)


@pytest.mark.parametrize(('engine', 'place', 'kind', 'claim'), chosen(HEALTHY, ['healthy']))
def test_given_healthy_encoders_when_something_else_happens_then_none_is_blamed(
    engine, place, kind, claim
):
    found = verdicts(engine, place, kind)
    assert [(one.crash, one.alarms) for one in found] == [('', [])] * len(found)
