"""``lpv tune``: what is tried, refused, picked, looked at again, written; the committed studies."""

import json
import math

import numpy as np
import pytest
import yaml
from places import ROOT

from lpv_campaign.plan.factors import Range
from lpv_campaign.tune.cost import cost, excesses, pick
from lpv_campaign.tune.fields import base_value, changed, check_range
from lpv_campaign.tune.metric import Figure, Span
from lpv_campaign.tune.study_file import Limits, Study, Validation
from lpv_campaign.tune.trial import Bench, Outcome
from lpv_campaign.tune.validate import validate
from lpv_cli.main import main
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import gains_to_dict, load_gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import load_arm
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement

pytestmark = pytest.mark.slow

STUDIES = ROOT / 'design' / 'studies'
# A poor base: it believes in so much noise that a fault from the first sample on is learnt late.
BASE = {
    'observer': {
        'method': 'exact',
        'decay': 0.5,
        'fastest': 60.0,
        'acceleration_noise': [0.6, 0.6],
        'rate_noise': 0.001,
    },
    'controller': {
        'method': 'exact',
        'alpha': 2.0,
        'fastest': 100.0,
        'state_weight': [10.0, 1.0, 30.0],
        'torque_weight': 0.01,
    },
}
TOY = {
    'name': 'toy',
    'arm': 'paper',
    'requirement': 'base.yaml',
    'seed': 7,
    'trials': 4,
    'search': {
        'observer.decay': {'low': 0.1, 'high': 55.0, 'spacing': 'log'},
        'observer.acceleration_noise': {'low': 0.03, 'high': 0.6, 'spacing': 'log'},
        'diagnosis.dwell': {'low': 0.004, 'high': 0.02},
    },
    'campaign': {
        'seed': 1,
        'plan': {'method': 'latin_hypercube', 'runs': 8},
        'duration': 4.0,
        'factors': {
            'path': 'random',
            'fault.kind': ['none', 'bias'],
            'fault.onset': 0.0,
            'fault.size': {'bias': 0.3},
        },
    },
    'figures': {
        'delay': {'column': 'detection_delay', 'statistic': 'geometric_mean', 'weight': 1.0},
        'missed': {'column': 'missed', 'scale': 0.5, 'weight': 0.2},
    },
    'limits': {'healthy_score': 0.9},
    'validation': {'seed': 2, 'runs': 12, 'resamples': 200},
}


def study_file(folder, **changes):
    """A toy study with its base; ``None`` takes a field away."""
    folder.mkdir(exist_ok=True)
    (folder / 'base.yaml').write_text(yaml.safe_dump(BASE))
    data = {name: value for name, value in {**TOY, **changes}.items() if value is not None}
    (folder / 'study.yaml').write_text(yaml.safe_dump(data, sort_keys=False))
    return folder / 'study.yaml'


def tune(study, out, *arguments):
    """Run the command in this process."""
    return main(['tune', str(study), '--out', str(out), '--workers', '0', *arguments])


def result_of(out):
    """``study.json``, which must hold no NaN."""
    return json.loads((out / 'study.json').read_text(), parse_constant=pytest.fail)


@pytest.fixture(scope='module')
def tuned(tmp_path_factory):
    """A finished toy study: its file and its results."""
    folder = tmp_path_factory.mktemp('tune')
    study = study_file(folder / 'toy')
    assert tune(study, folder / 'out') == 0
    return study, folder / 'out'


# ------------------------------------------------------------------ a whole study


def test_given_a_poor_base_when_tuned_then_better_gains_are_written_and_verify(tuned, paper_arm):
    _, out = tuned
    result = result_of(out)
    assert (result['accepted'], len(result['trials'])) == (True, 4)
    values = result['trials'][result['picked']]['values']
    requirement = load_requirement(out / 'requirement.yaml')
    assert requirement.observer.decay == values['observer.decay']
    assert requirement.observer.acceleration_noise == (values['observer.acceleration_noise'],) * 2
    gains = load_gains(out / 'gains.yaml')
    require(paper_arm, gains)
    again, written = (
        gains_to_dict(found) for found in (design(paper_arm, requirement).gains, gains)
    )
    np.testing.assert_allclose(again['observer']['kappa'], written['observer']['kappa'], rtol=1e-9)
    np.testing.assert_allclose(again['controller']['m1'], written['controller']['m1'], rtol=1e-9)
    data = yaml.safe_load((out / 'diagnosis.yaml').read_text())
    assert DiagnosisParameters(
        **data['/**']['ros__parameters']['diagnosis']
    ) == DiagnosisParameters(dwell=values['diagnosis.dwell'])
    assert (out / 'study.png').stat().st_size > 10_000


def test_given_a_better_design_when_validated_then_every_pair_of_runs_was_the_same(tuned):
    found = result_of(tuned[1])['validation']
    assert found['cost']['picked'] < found['cost']['first']
    assert (
        found['cost']['interval'][0]
        <= found['cost']['difference']
        <= found['cost']['interval'][1]
        < 0.0
    )
    assert found['false_alarms']['picked'] == 0
    assert found['healthy_score']['picked'] <= 0.9
    delay = found['figures']['delay']
    assert delay['picked'] < 0.8 * delay['first']


def test_given_values_without_a_design_when_tuned_then_the_trial_is_pruned_with_its_reason(tuned):
    trials = result_of(tuned[1])['trials']
    lost = [t for t in trials if t['state'] == 'infeasible']
    assert 0 < len(lost) < len(trials)
    assert all('observer' in t['reason'] and 'cost' not in t for t in lost)
    assert trials[0]['values'] == {
        'observer.decay': 0.5,
        'observer.acceleration_noise': 0.6,
        'diagnosis.dwell': 0.01,
    }
    assert trials[0]['cost'] > 0.0


def test_given_a_study_that_was_killed_when_it_goes_on_then_it_ends_as_if_it_had_not_been(
    tuned, tmp_path, monkeypatch, capsys
):
    study, out = tuned
    outcome, calls = Bench.outcome, []

    def killed(bench, values):
        calls.append(values)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return outcome(bench, values)

    with monkeypatch.context() as patch:
        patch.setattr(Bench, 'outcome', killed)
        assert tune(study, tmp_path / 'out') == 130
    assert not (tmp_path / 'out' / 'study.json').exists()
    assert tune(study, tmp_path / 'out') == 0
    assert '2 trials are here already' in capsys.readouterr().out
    assert (tmp_path / 'out' / 'study.json').read_bytes() == (out / 'study.json').read_bytes()
    assert (tmp_path / 'out' / 'requirement.yaml').read_bytes() == (
        out / 'requirement.yaml'
    ).read_bytes()


def test_given_nothing_certified_when_tuned_then_no_gains_are_written(tmp_path, capsys):
    study = study_file(tmp_path / 'toy', limits={'pole_step': 0.01})
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'gains.yaml').write_text('of an earlier study')
    assert tune(study, out, '--trials', '3') == 1
    assert sorted(path.name for path in out.iterdir()) == ['study.db', 'study.json', 'study.png']
    result = result_of(out)
    assert (result['picked'], result['accepted']) == (None, False)
    assert all('sample time' in trial['reason'] for trial in result['trials'])
    assert 'no trial is certified' in capsys.readouterr().out
    # The folder belongs to that study now.
    assert tune(study_file(tmp_path / 'toy'), out) == 2
    assert 'holds another study' in capsys.readouterr().err


def test_given_designs_that_do_not_differ_when_tuned_then_nothing_is_changed(tmp_path, capsys):
    """Noise must not change a default."""
    study = study_file(
        tmp_path / 'toy',
        search={'observer.decay': {'low': 0.4999, 'high': 0.5001}},
        figures={'rms': {'column': 'fault_rms_before', 'weight': 1.0}},
    )
    assert tune(study, tmp_path / 'out', '--trials', '2') == 0
    assert not (tmp_path / 'out' / 'gains.yaml').exists()
    assert 'nothing is changed: ' in capsys.readouterr().out
    assert not result_of(tmp_path / 'out')['accepted']


def test_given_a_file_that_is_no_study_when_it_should_go_on_then_it_is_refused(tmp_path, capsys):
    (tmp_path / 'study.db').write_bytes(b'no database' * 1000)
    assert tune(study_file(tmp_path / 'toy'), tmp_path) == 2
    error = capsys.readouterr().err
    assert 'cannot be read' in error
    assert error.count('\n') == 1


# ------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'arm': None}, 'arm: is missing'),
        ({'trials': 0}, 'trials: must be at least 1'),
        ({'nonsense': 1}, 'nonsense: is not a known field'),
        ({'search': {}}, 'search: names no field'),
        ({'search': {'observer.decay': [0.1, 0.2]}}, 'must be a range'),
        ({'search': {'observer.decay': {'low': 1.0, 'high': 2.0}}}, 'must hold 0.5'),
        ({'search': {'observer.speed': {'low': 1.0, 'high': 2.0}}}, 'cannot be searched'),
        (
            {'search': {'observer.acceleration_noise[2]': {'low': 0.1, 'high': 1.0}}},
            'cannot be searched',
        ),
        (
            {'search': {'diagnosis.latch': {'low': 0.0, 'high': 1.0}}},
            'is not a number of the diagnosis',
        ),
        (
            {'search': {'diagnosis.threshold_factor': {'low': 0.5, 'high': 2.0}}},
            'must lie within 1 and inf',
        ),
        ({'figures': {'delay': {'column': 'detection_delay'}}}, 'needs one with a weight'),
        ({'figures': {'delay': {'column': 'weather', 'weight': 1.0}}}, 'must be one of'),
        (
            {'figures': {'delay': {'column': 'detection_delay', 'weight': math.nan}}},
            'must be a number, got NaN',
        ),
        (
            {
                'figures': {
                    'delay': {
                        'column': 'detection_delay',
                        'weight': 1.0,
                        'where': {'weather': 'fine'},
                    }
                }
            },
            "there is no column 'weather'",
        ),
        (
            {
                'figures': {
                    'delay': {
                        'column': 'detection_delay',
                        'weight': 1.0,
                        'where': {'kind': 'stuck'},
                    }
                }
            },
            'no run of the campaign',
        ),
        ({'figures': {'missed': {'column': 'false_alarms', 'weight': 1.0}}}, 'give it a scale'),
        ({'healthy': {'all': {'kind': {'low': 2.0, 'high': 1.0}}}}, 'must be a value, a list, or'),
        (
            {
                'healthy': {'all': {'kind': 'spike'}},
                'campaign': {
                    **TOY['campaign'],
                    'factors': {'fault.kind': 'stuck', 'fault.onset': 0.0},
                },
            },
            'has a part without fault',
        ),
        ({'validation': {'seed': 1, 'runs': 5}}, "another one than the campaign's"),
        ({'campaign': {**TOY['campaign'], 'designs': ['paper']}}, 'designs: is set by the study'),
        ({'campaign': {**TOY['campaign'], 'plan': {'method': 'factorial'}}}, 'must draw its runs'),
        ({'campaign': 'nowhere.yaml'}, 'cannot be read'),
        ({'requirement': 'nowhere'}, 'is not shipped'),
    ],
    ids=lambda value: '' if isinstance(value, str) else next(iter(value)),
)
def test_given_a_wrong_study_when_tuned_then_it_is_refused_in_one_line(
    tmp_path, capsys, changes, message
):
    assert tune(study_file(tmp_path / 'toy', **changes), tmp_path / 'out', '--trials', '1') == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count('\n') == 1


@pytest.mark.parametrize('arguments', [('--trials', '0'), ('--workers', '-1')])
def test_given_senseless_arguments_when_tuned_then_they_are_refused(tmp_path, capsys, arguments):
    assert tune(study_file(tmp_path / 'toy'), tmp_path / 'out', *arguments) == 2
    assert 'must lie within' in capsys.readouterr().err


# ------------------------------------------------------------------ its parts


def row(kind='bias', **values):
    """A row of results."""
    return {
        'kind': kind,
        'detected': True,
        'stable': True,
        'fault.onset': 2.0,
        'fault.duration': 0.0,
        'detection_delay': 0.5,
        **values,
    }


def test_given_a_fault_that_is_not_found_when_measured_then_its_delay_lasts_to_its_end():
    figure = Figure('delay', 'detection_delay', 'mean')
    lost = {'detected': False, 'detection_delay': math.nan}
    rows = [row(), row(**lost), row(**lost, **{'fault.duration': 3.0}), row('none', **lost)]
    np.testing.assert_array_equal(figure.values(rows, 10.0), [0.5, 8.0, 3.0, math.nan])
    assert figure.summary(figure.values(rows, 10.0)) == pytest.approx(11.5 / 3.0)
    np.testing.assert_array_equal(
        Figure('missed', 'missed').values(rows, 10.0), [0.0, 1.0, 1.0, math.nan]
    )


def test_given_a_loop_that_ran_away_when_measured_then_it_counts_and_can_be_written():
    figure = Figure('lost', 'tracking_max', 'largest')
    rows = [row(tracking_max=value) for value in (0.1, math.inf, math.nan)]
    assert figure.summary(figure.values(rows, 10.0)) == 1e6
    np.testing.assert_array_equal(figure.values(rows, 10.0), [0.1, 1e6, math.nan])


def test_given_a_condition_when_measured_then_only_runs_that_meet_it_count():
    rows = [row(detection_delay=d, **{'fault.onset': d}) for d in (0.0, 1.0, 2.0, 4.0)]
    where = {'kind': ('bias',), 'fault.onset': Span(1.0, 3.0)}
    assert (
        Figure('d', 'detection_delay', 'largest', where).summary(
            Figure('d', 'detection_delay', 'largest', where).values(rows, 9.0)
        )
        == 2.0
    )


@pytest.mark.parametrize(
    ('statistic', 'expected'),
    [
        ('mean', 7.0 / 3.0),
        ('median', 2.0),
        ('geometric_mean', 2.0),
        ('rms', math.sqrt(7.0)),
        ('percentile_95', 3.8),
        ('largest', 4.0),
    ],
)
def test_given_values_when_summarised_then_it_is_the_textbooks_statistic(statistic, expected):
    values = np.array([1.0, math.nan, 2.0, 4.0])
    assert Figure('x', 'missed', statistic).summary(values) == pytest.approx(expected)


def test_given_weights_when_a_cost_is_made_then_figures_count_over_the_first_trials():
    figures = (
        Figure('a', 'missed', weight=3.0),
        Figure('b', 'missed', weight=1.0, scale=0.5),
        Figure('watched', 'missed'),
    )
    first = {'a': 2.0, 'b': 0.0, 'watched': 0.0}
    assert cost(figures, {'a': 1.0, 'b': 1.0, 'watched': 9.0}, first) == pytest.approx(
        (3.0 * 0.5 + 1.0 * 2.0) / 4.0
    )
    with pytest.raises(ConfigError, match='give it a scale'):
        cost(figures, first, {'a': 0.0, 'b': 0.0, 'watched': 0.0})


def test_given_equal_costs_when_picked_then_the_furthest_from_a_false_alarm_is():
    trials = [
        {'number': k, 'state': state, 'cost': price, 'healthy_score': score}
        for k, (state, price, score) in enumerate(
            [
                ('good', 1.0, 0.5),
                ('beyond limits', 0.1, 0.1),
                ('good', 0.5, 0.6),
                ('good', 0.505, 0.4),
                ('good', 0.6, 0.1),
            ]
        )
    ]
    trials.append({'number': 5, 'state': 'infeasible'})
    assert [pick(trials, t)['number'] for t in (0.0, 0.02, 0.5)] == [2, 3, 4]
    assert pick(trials[1:2] + trials[5:], 0.0) is None


def toy_study(**changes):
    figures = (Figure('delay', 'detection_delay', weight=1.0, at_most=0.6, at_most_ratio=1.1),)
    limits = Limits(({'kind': ('none',)},), 0.7, 0.5)
    return Study(
        'toy',
        1,
        1,
        'paper',
        {},
        {},
        figures,
        limits,
        0.0,
        Validation(2, 200, 0.8, 0.5, 300, 0.95, 0.001),
        {},
        '.',
        **changes,
    )


def test_given_limits_when_a_trial_is_beyond_them_then_each_excess_is_named():
    study = toy_study()
    found = excesses(study, Outcome('', {'delay': 0.7}, 0.5, 2), {'delay': 0.5})
    assert found == pytest.approx(
        {
            'false_alarms': 2.0,
            'healthy_score': -0.2,
            'delay at_most': 0.1,
            'delay at_most_ratio': 0.15,
        }
    )
    relaxed = excesses(study, Outcome('', {'delay': 0.7}, 0.5, 2), {'delay': 0.5}, study.validation)
    assert relaxed == pytest.approx(
        {
            'false_alarms': 2.0,
            'healthy_score': -0.3,
            'delay at_most': -0.2,
            'delay at_most_ratio': -0.125,
        }
    )


class PairedBench:
    """Results by formula: the second design is better by ``gain`` in every run, whatever else
    makes runs differ."""

    def __init__(self, gain):
        self.study, self.length, self.base, self.gain = toy_study(), 10.0, {}, gain

    def rows(self, gains, values, plan):
        rng = np.random.default_rng(plan['seed'])
        common = rng.uniform(0.1, 0.9, plan['runs'])
        own = rng.normal(0.0, 0.001, plan['runs'])
        return [
            row(detection_delay=c - (self.gain + o if gains else 0.0)) for c, o in zip(common, own)
        ]

    def measure(self, rows):
        figure = self.study.figures[0]
        return Outcome('', {'delay': figure.summary(figure.values(rows, 10.0))}, 0.5, 0)


@pytest.mark.parametrize(('gain', 'accepted'), [(0.002, True), (0.0, False), (-0.002, False)])
def test_given_pairs_when_validated_then_a_gain_far_below_the_spread_of_runs_is_seen(
    gain, accepted
):
    found = validate(PairedBench(gain), True, {}, False)
    assert found['accepted'] is accepted
    low, high = found['figures']['delay']['interval']
    assert low < -gain < high or abs(found['figures']['delay']['difference'] + gain) < 5e-4
    assert high - low < 0.001  # unpaired it would be a tenth


def test_given_elements_of_a_field_when_changed_then_the_others_stay(tmp_path):
    requirement = load_requirement('paper')
    data = {'observer': {'method': 'exact', 'acceleration_noise': [0.05, 0.05]}}
    assert base_value('observer.acceleration_noise[1]', requirement) == 0.05
    assert changed(
        data,
        requirement,
        {
            'observer.acceleration_noise[1]': 0.2,
            'observer.velocity_weight': 0.1,
            'diagnosis.dwell': 1.0,
        },
    ) == {
        'observer': {'method': 'exact', 'acceleration_noise': [0.05, 0.2], 'velocity_weight': 0.1}
    }
    assert data['observer']['acceleration_noise'] == [0.05, 0.05]
    with pytest.raises(ConfigError, match='must hold'):
        check_range('observer.decay', Range(0.3, 1.0), 0.25)


# ------------------------------------------------------------------ the committed studies


@pytest.fixture(params=sorted(path.name for path in STUDIES.iterdir() if path.is_dir()))
def committed(request):
    """A study of a shipped arm."""
    return request.param, json.loads((STUDIES / request.param / 'study.json').read_text())


def test_given_a_committed_study_when_read_then_the_shipped_requirement_is_what_it_found(committed):
    name, result = committed
    values = result['first']
    if result['accepted']:
        values = result['trials'][result['picked']]['values']
    requirement = load_requirement(name)
    for field, value in values.items():
        assert base_value(field, requirement) == value, field
    arm = load_arm(bringup_file('arms', name))
    require(arm, load_gains(bringup_file('gains', name)), name)


def test_given_a_committed_study_when_its_rule_is_applied_then_its_trial_is_picked(committed):
    name, result = committed
    assert result['study'] == yaml.safe_load((STUDIES / name / 'study.yaml').read_text())
    assert len(result['trials']) == result['study']['trials']
    found = pick(result['trials'], result['study'].get('tolerance', 0.0))
    assert found['number'] == result['picked']
    validation = result['validation']
    if result['accepted']:
        cost = validation['cost']
        assert cost['interval'][1] < -validation['least_gain'] * cost['first'] < 0.0
        assert validation['false_alarms']['picked'] == 0
