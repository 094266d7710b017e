import json
from functools import cache

import numpy as np
import optuna
import pytest
from campaign_files import spec, written

from lpv import ConfigError, load_gains
from lpv.cli.commands import tune
from lpv.core.support.config import read_yaml
from lpv_design.requirement import load_requirement

pytestmark = pytest.mark.slow

FACTORS = '{path: random, fault.kind: [none, bias], fault.size: {bias: 0.1}, fault.onset: 2.0}'
PLAN = {'method': 'latin_hypercube', 'runs': 4}
CAMPAIGN = spec(FACTORS, seed=11, designs=['poor.yaml'], plan=PLAN, duration=3.5)
SEARCH = ['--search', 'observer.acceleration_noise=0.02:20.0']


@pytest.fixture
def file(tmp_path):
    """A link to a campaign whose requirement, beside it, believes in far too much noise."""
    data = read_yaml(load_requirement('paper').source)
    data['observer']['acceleration_noise'] = 10.0
    (tmp_path / 'files').mkdir()
    written(tmp_path / 'files' / 'poor.yaml', data)
    (tmp_path / 'tune.yaml').symlink_to(written(tmp_path / 'files' / 'campaign.yaml', CAMPAIGN))
    return tmp_path / 'tune.yaml'


def command(file, trials, *more):
    options = ['--cost', 'fault_rms_before=1', '--out', file.parent / 'out', '--workers', 0]
    return ['tune', file, *SEARCH, '--trials', trials, *options, *more]


def study_in(out):
    return optuna.load_study(study_name=None, storage=f'sqlite:///{out / "study.db"}')


def test_given_a_design_when_tuned_then_better_hold(file, paper_arm, call, refused, monkeypatch):
    out = file.parent / 'out'
    monkeypatch.setattr(tune, 'design', cache(tune.design))  # each is asked for by every command
    assert refused("'beauty' is no number", *command(file, 2, '--cost', 'beauty=1'))
    text = call(*command(file, 1)).out + call(*command(file, 2)).out
    assert text.count('trial 0: ') == text.count('trial 1: ') == 1  # what was done is kept
    trials, result = study_in(out).trials, json.loads((out / 'study.json').read_text())
    assert len(trials) == 2 and trials[0].values[0] == pytest.approx(1.0)
    assert trials[0].params == {'observer.acceleration_noise': 10.0}
    costs = [t.values[0] for t in trials if t.values and max(t.constraints.values()) <= 0.0]
    assert trials[result['trial']].values[0] <= 1.02 * min(costs)
    # Gains are written if and only if they are better on other runs, and then they are certified.
    better = result['interval'][1] < -0.02 * result['first'] and result['healthy_score'] <= 1.0
    assert (result['reason'] == '') == better == (out / 'gains.yaml').exists()
    if better:
        load_gains(out / 'gains.yaml').require(paper_arm)
    for name in ('front', 'history', 'slices'):
        assert (out / f'{name}.png').stat().st_size > 1000
    # The same search in one go ends with the same trials.
    other = file.parent / 'other'
    call(*command(file, 2), '--out', other)
    assert [t.params for t in study_in(other).trials] == [t.params for t in trials]
    assert refused('another study', *command(file, 2, '--seed', '2'))


def test_given_scores_and_alarms_when_a_trial_is_judged_then_only_parts_without_fault_count():
    nothing = {'score_before_2': np.nan}
    good = {**nothing, 'score_before_1': 0.4, 'score_during_1': 5.0, 'alarms_before_1': 0}
    assert tune.healthy([good]) == (0.4, 0)
    bad = {'score_before_1': 0.7, 'score_before_2': np.inf, 'alarms_before_1': 2}
    assert tune.healthy([good, bad]) == (1e6, 2)
    pytest.raises(ConfigError, tune.healthy, [nothing]).match('without fault')


def test_given_what_makes_no_sense_when_tuned_then_one_line_says_so(file, refused):
    for option, told in (
        ('--search observer.decay', 'FIELD=LOW:HIGH'),
        ('--search observer.decay=1:0.1', 'low < high'),
        ('--search diagnosis.sigmas=3:11', 'from 3 to 10'),
        ('--search observer.speed=0.1:1', 'is no number of'),
        ('--search observer.decay=0.5:1', 'must hold 0.25'),
        *((f'--cost missed{weight}', 'COLUMN=WEIGHT') for weight in ('', '=-1')),
        *((few, 'must lie within') for few in ('--trials 0', '--workers -1')),
    ):
        assert refused(told, *command(file, 2), *option.split())
    assert refused('diagnosis.sigmas', *command(file, 2, '--search', 'diagnosis.size=1:2'))
    told, out = 'has no lpv region: no design to tune', file.parent / 'out'
    assert refused(told, 'tune', 'ur10', *SEARCH, '--out', out, '--workers', 0)
    out.mkdir(exist_ok=True)
    (out / 'study.db').write_text('no data base')
    assert refused('study.db', *command(file, 2))


@pytest.mark.parametrize('stopped', [0, 1])
def test_given_a_trial_that_is_interrupted_when_resumed_then_it_is_repeated(
    file, call, monkeypatch, stopped
):
    def rows(bench, values, seed=None):
        asked.append(values)
        if len(asked) == stopped + 2:  # the first one is before any trial
            raise KeyboardInterrupt
        level = values['observer.acceleration_noise']
        return [{'kind': 'none', 'score_before_1': 0.1, 'fault_rms_before': level}]

    monkeypatch.setattr(tune._Bench, 'rows', rows)
    for name in ('_draw', '_write'):
        monkeypatch.setattr(tune, name, lambda *_: None)
    tried = []
    for out, count in (('whole', 99), ('resumed', 0)):
        asked = [{}] * count
        options = '--out', file.parent / out
        if not count:
            call(*command(file, 3), *options, code=130)
        call(*command(file, 3), *options)
        tried.append([trial.params for trial in study_in(file.parent / out).trials if trial.values])
    assert tried[0] == tried[1] and len(tried[0]) == 3
