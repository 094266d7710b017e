import itertools
import json
import re
from copy import copy
from dataclasses import asdict, replace

import numpy as np
import pytest
import reference
from runs import copied

from lpv import DiagnosisParameters
from lpv.bag.replay.replay import Replay
from lpv.cli.main import build_parser
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.report.comparison import Tolerances, compare_runs, load_pair


def replay(out, estimates_only=False, **changes):
    monitor = reference.monitor(parameters=DiagnosisParameters(**changes))
    Replay(monitor, estimates_only=estimates_only).run(reference.BAG, out)
    return out


@pytest.fixture(scope='module')
def replayed(tmp_path_factory):
    return replay(tmp_path_factory.mktemp('reference') / 'bag')


@pytest.fixture(scope='module')
def slower(tmp_path_factory):
    """With alarms that end later."""
    return replay(tmp_path_factory.mktemp('slower') / 'bag', estimates_only=True, clear_dwell=1.0)


def test_given_the_reference_when_replayed_then_the_diagnosis_answers_as_it_did(replayed):
    found, meant = reference.compare(replayed), 'run `make reference`, commit the bag'
    wrong = [f for f in (*found.figures, *found.differences, *found.alarms) if not f.same]
    assert found.same, f'the diagnosis answers differently: {wrong}; if that is meant, {meant}'
    assert found.common > 140 and len(found.figures) == 6
    assert [p.first.kind for p in found.alarms] == ['bias', 'drift', 'dropout']


def test_given_no_options_when_compared_then_tolerances_are_those_of_the_library():
    given = vars(build_parser('compare').parse_args(['compare', 'one', 'other']))
    assert asdict(Tolerances()) == {name: given[name] for name in asdict(Tolerances())}


@pytest.mark.slow
def test_given_another_behaviour_when_compared_then_it_is_noticed(tmp_path):
    changes = {'smallest_step': 0.5, 'sigmas': 4.01, 'clear_dwell': 0.6, 'compensation_rate': 0.4}
    for name, value in changes.items():
        assert not reference.compare(replay(tmp_path / name, **{name: value})).same, name


def test_given_one_answer_less_when_compared_then_it_is_noticed(replayed, paper_arm, tmp_path):
    answers = itertools.count()

    def first_ones(topic, data):
        return data if topic != '/lpv/fault_estimate' or next(answers) < 20 else None

    less = copied(replayed, tmp_path / 'bag', change=first_ones)
    first, second = load_pair(replayed, less, paper_arm)
    result = compare_runs(first, second, paper_arm)
    assert (result.only_second, result.complete, result.same) == (0, False, False)
    assert result.only_first > 100
    assert compare_runs(first, second, paper_arm, Tolerances(missing=1.0)).complete


def test_given_an_estimate_repeated_in_silence_then_it_is_no_answer(replayed, paper_arm):
    first, second = load_pair(replayed, replayed, paper_arm)
    after = second.stamps['fault_estimate'][-1] + 10**9
    for state, same in ((SensorState.STALE, True), (SensorState.OK, False)):
        more = copy(second)
        rows = {n: np.append(v, v[-1:], 0) for n, v in second.streams['fault_estimate'].items()}
        rows['state'][-1] = state
        more.streams = second.streams | {'fault_estimate': rows}
        stamps = np.append(second.stamps['fault_estimate'], after)
        more.stamps = second.stamps | {'fault_estimate': stamps}
        result = compare_runs(first, more, paper_arm, Tolerances(0, 0, 0, 0, 0))
        assert (result.only_second == 0, result.same) == (same, same)


def test_given_no_measures_when_compared_then_others_count(replayed, slower, tmp_path, paper_arm):
    estimates = replay(tmp_path / 'bag', estimates_only=True)
    for pair in ((replayed, estimates), (estimates, replayed)):
        result = compare_runs(*load_pair(*pair, paper_arm), paper_arm, Tolerances(0, 0, 0, 0, 0))
        assert result.same and len(result.figures) == 6
    alone = compare_runs(*load_pair(estimates, slower, paper_arm), paper_arm)
    assert not alone.same and {f.unit for f in alone.figures} == {'rad'}


def test_given_alarms_or_numbers_of_one_run_when_compared_then_they_differ(replayed, paper_arm):
    first, second = load_pair(replayed, replayed, paper_arm)
    second.alarms = [a for a in second.alarms if a.sensor_index == 0]
    pairs = compare_runs(first, second, paper_arm).alarms
    assert [p.second is None for p in pairs] == [not p.same for p in pairs] == [False, True, False]
    pairs = compare_runs(second, first, paper_arm).alarms
    assert [p.first is None for p in pairs] == [False, True, False]
    for change in ({'confidence': 0.5}, {'onset': 0}):
        second.alarms = [replace(alarm, **change) for alarm in first.alarms]
        assert not any(pair.same for pair in compare_runs(first, second, paper_arm).alarms), change
    values = second.streams['fault_estimate']['estimate'].copy()
    values[7, 1] = np.nan
    second.streams['fault_estimate'] = {**second.streams['fault_estimate'], 'estimate': values}
    second.alarms = first.alarms
    result = compare_runs(first, second, paper_arm)
    assert [f.name for f in result.differences if not f.same] == ['fault estimate 2']
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))['same'] is False


def test_given_two_equal_bags_when_compared_then_the_code_is_0(replayed, tmp_path, call):
    said = call('compare', replayed, replayed, '--exact', '--out', tmp_path).out
    assert said.rstrip().endswith('same') and 'differs' not in said and 'delay' in said
    assert json.loads((tmp_path / 'comparison.json').read_text())['same'] is True
    for name in ('faults', 'differences'):
        assert (tmp_path / f'{name}.png').read_bytes().startswith(b'\x89PNG')


def test_given_late_ends_when_compared_then_it_is_told(replayed, slower, monkeypatch, call):
    found = json.loads(call('compare', replayed, slower, '--json', code=3).out)
    assert found['same'] is False
    pairs = [(p['first'], p['second']) for p in found['alarms'] if p['second'] and not p['same']]
    late = [b['cleared'] - a['cleared'] for a, b in pairs if a['cleared'] is not None]
    assert 0.5 < max(late) < 0.8
    assert 'f1: estimate of the fault' in {f['name'] for f in found['figures']}
    monkeypatch.setenv('COLUMNS', '80')
    said = call('compare', replayed, slower, code=3).out
    assert 'DIFFERENT' in said and '<- differs' in said and '…' not in said
    lines = said.splitlines()
    assert max(map(len, lines)) <= 80
    f1 = next(line for line in lines if 'f1:' in line)
    assert len(re.findall(r'\d\.\d+(?:e-\d+)?', f1)) == 2
    first = next(i for i, line in enumerate(lines) if 'bias' in line)
    figures = [len(re.findall(r'-?\d+\.\d{3}', line)) for line in lines[first : first + 2]]
    assert 'link1_angle' in lines[first] and figures == [4, 4]


def test_given_what_is_of_no_use_when_compared_then_it_is_said(replayed, tmp_path, refused):
    for name, bad in (('mise', -1.0), ('delay', 'nan'), ('signal', 'inf')):
        assert refused(f'--{name}: must lie', 'compare', replayed, replayed, f'--{name}', bad)

    def another_second(_, data):
        return data[:5] + bytes([data[5] ^ 0x40]) + data[6:]

    copied(replayed, tmp_path / 'measured', '/lpv/joint_states'.__eq__)
    copied(replayed, tmp_path / 'later', '/lpv/fault_estimate'.__eq__, another_second)
    (tmp_path / 'broken').mkdir()
    (tmp_path / 'broken' / 'bag.mcap').write_bytes(b'no bag')
    told = {'measured': 'no answers', 'later': 'not of one recording'}
    for other in (*told, 'broken', 'nothing'):
        assert refused(told.get(other, other), 'compare', replayed, tmp_path / other)
