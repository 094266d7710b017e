"""Campaigns: plans, runs, results, going on after a crash."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from lpv_campaign.execution.execute import execute, has_limit, run_one
from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.execution.runs import plan_run
from lpv_campaign.execution.store import CampaignFolder
from lpv_campaign.plan.campaign import Campaign, resolve
from lpv_campaign.plan.paths import random_path
from lpv_campaign.plan.sampling import Plan
from lpv_campaign.plan.spec import load_spec, parse_spec
from lpv_cli.main import main
from lpv_core.certificate.gains import save_gains
from lpv_core.control.path import CartesianPath
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.support.errors import ConfigError

pytestmark = pytest.mark.slow

KINDS = ['none', 'bias', 'drift', 'stuck', 'scale', 'noise', 'spike', 'dropout']
SMALL = {
    'name': 'small',
    'seed': 3,
    'duration': 3.0,
    'plan': {'method': 'latin_hypercube', 'runs': 24},
    'factors': {
        'path': 'random',
        'fault.kind': KINDS,
        'fault.sensor': ['link1_angle', 'link2_angle', 'both'],
        'fault.size': {
            'bias': {'low': 0.1, 'high': 0.5, 'spacing': 'log'},
            'scale': 0.3,
            'noise': 0.03,
            'spike': 0.3,
        },
        'fault.rate': {'drift': 0.3, 'spike': 20.0},
        'fault.onset': {'low': 1.2, 'high': 1.5},
        'mass_1': {'low': 0.95, 'high': 1.05},
    },
}
REACH = """
name: reach
duration: 5.0
path:
  waypoints:
    - {t: 0.5, x: 0.1, y: -0.4}
    - {t: 4.5, x: 0.2, y: -0.35}
"""


def small(**changes):
    return {**SMALL, **changes}


@pytest.fixture(scope='module')
def campaign():
    return resolve(SMALL, 'small', '.')


@pytest.fixture(scope='module')
def serial(campaign):
    """Rows of all runs, one after the other in this process."""
    return [run_one(campaign, number) for number in range(campaign.spec.runs)]


def same(rows, others):
    return repr(rows) == repr(others)  # NaN is the same as NaN


# ------------------------------------------------------------------ the file


@pytest.mark.parametrize(
    'field, change',
    [
        ('plan.method', {'plan': {'method': 'grid'}}),
        ('plan.runs', {'plan': {'method': 'random'}}),
        ('plan.runs', {'plan': {'method': 'random', 'runs': 0}}),
        ('plan.runs', {'plan': {'method': 'random', 'runs': 10**9}}),
        ('plan.repeats', {'plan': {'method': 'random', 'runs': 5, 'repeats': 2}}),
        ('duration', {'duration': float('nan')}),
        ('duration', {'duration': -1.0}),
        ('designs', {'designs': 'paper'}),
        ('designs', {'designs': ['paper', 'paper']}),
        ('factors.fault.size', {'factors': {'fault.size': {'low': 1.0}}}),
        ('factors.fault.size', {'factors': {'fault.size': {'bais': 1.0}}}),
        ('factors.fault.size', {'factors': {'fault.size': True}}),
        ('factors.fault.size', {'factors': {'fault.size': []}}),
        ('factors.mass_1', {'factors': {'mass_1': {'low': 1.0, 'high': 0.9}}}),
        ('factors.mass_1', {'factors': {'mass_1': {'low': -1.0, 'high': 0.9}}}),
        ('factors.mass_1', {'factors': {'mass_1': {'low': 0.5, 'high': float('inf')}}}),
        ('factors.noise.low', {'factors': {'noise': {'low': 0.0, 'high': 1.0, 'spacing': 'log'}}}),
        (
            'factors.noise.spacing',
            {'factors': {'noise': {'low': 0.0, 'high': 1.0, 'spacing': 'x'}}},
        ),
        ('factors.noise.levels', {'factors': {'noise': {'low': 0.0, 'high': 1.0, 'levels': 1}}}),
        ('factors.noise', {'factors': {'noise': 'loud'}}),
        ('factors.noise', {'factors': {'noise': [1.0, 1.0]}}),
        ('factors.masss', {'factors': {'masss': 1.0}}),
        ('factors.sample_time', {'factors': {'sample_time': {'low': 0.001, 'high': 0.002}}}),
        ('factors.command_delay', {'factors': {'command_delay': 1.5}}),
        ('factors.command_delay', {'factors': {'command_delay': 64.0}}),
        ('factors.compensation', {'factors': {'compensation': 'sometimes'}}),
        ('factors.fault.kind', {'factors': {'fault.kind': ['bias', 'bad']}}),
        ('factors.fault.kind', {'factors': {'fault.kind': 1.0}}),
        ('factors', {'factors': [1]}),
        ('speed', {'speed': 1.0}),
    ],
)
def test_given_a_wrong_field_when_parsed_then_the_error_names_it(field, change):
    with pytest.raises(ConfigError) as error:
        parse_spec(small(**change))
    assert error.value.field == field


@pytest.mark.parametrize(
    'field, change',
    [
        ('factors.fault.sensor', {'factors': {'fault.sensor': 'elbow'}}),
        ('factors.design', {'factors': {'design': 'other'}}),
        ('limit', {'limit': 1, 'factors': {'plant': ['nonlinear', 'lpv']}}),
        ('requirement', {'designs': ['nowhere']}),
        ('arm', {'arm': 'nowhere'}),
        ('scenario', {'scenario': 'nowhere'}),
        ('scenario', {'factors': {'path': ['random', 'nowhere']}}),
        (
            'gains.arm_sha256',
            {'designs': ['gains.yaml'], 'arm': 'real_arm', 'scenario': 'reach.yaml'},
        ),
        ('gains.arm_sha256', {'designs': ['gains.yaml'], 'factors': {'sample_time': 0.004}}),
    ],
)
def test_given_what_does_not_fit_the_files_when_resolved_then_the_error_names_it(
    field, change, tmp_path, paper_gains
):
    save_gains(paper_gains, tmp_path / 'gains.yaml')
    (tmp_path / 'reach.yaml').write_text(REACH)
    with pytest.raises(ConfigError) as error:
        resolve(small(**change), 'small', tmp_path)
    assert error.value.field == field


def test_given_a_file_that_is_no_campaign_when_the_command_is_run_then_one_line_says_so(
    tmp_path, capsys
):
    (tmp_path / 'bad.yaml').write_text('name: [')
    assert main(['campaign', str(tmp_path / 'bad.yaml'), '--out', str(tmp_path / 'out')]) == 2
    assert main(['campaign', str(tmp_path / 'none.yaml'), '--out', str(tmp_path / 'out')]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2
    assert not (tmp_path / 'out').exists()


# ------------------------------------------------------------------ plans


def test_given_a_factorial_plan_when_sampled_then_every_combination_comes_once_a_repeat():
    spec = parse_spec(
        small(
            plan={'method': 'factorial', 'repeats': 2},
            factors={
                'fault.kind': ['none', 'bias'],
                'noise': {'low': 0.5, 'high': 2.0, 'levels': 3},
                'payload': [0.0, 0.5],
                'friction': 1.0,
            },
        )
    )
    assert spec.runs == 24
    plan = Plan(spec.method, spec.factors, spec.runs, spec.seed)
    points = [
        tuple(f.value(u) for f, u in zip(spec.factors.values(), plan.point(n)))
        for n in range(spec.runs)
    ]
    assert set(Counter(points).values()) == {2}
    assert {p[1] for p in points} == {0.5, 1.25, 2.0}


def test_given_a_latin_hypercube_when_sampled_then_every_stratum_of_every_factor_is_hit_once():
    spec = parse_spec(small())
    plan = Plan(spec.method, dict.fromkeys('abc', spec.factors['mass_1']), 50, 1)
    points = np.array([plan.point(n) for n in range(50)])
    for column in points.T:
        assert sorted((column * 50).astype(int)) == list(range(50))
    assert abs(np.corrcoef(points.T)[0, 1]) < 0.4


def test_given_a_random_plan_when_it_is_made_longer_then_the_first_runs_stay_the_same():
    short = resolve(small(plan={'method': 'random', 'runs': 4}), 's', '.')
    long = resolve(small(plan={'method': 'random', 'runs': 400}), 's', '.')
    for number in range(4):
        assert short.values(number) == long.values(number)
        assert plan_run(short, number).scenario == plan_run(long, number).scenario


def test_given_a_factor_that_goes_by_kind_when_valued_then_each_kind_has_its_own(campaign):
    for number in range(campaign.spec.runs):
        values = campaign.values(number)
        size = values['fault.size']
        low, high = {
            'bias': (0.1, 0.5),
            'scale': (0.3, 0.3),
            'noise': (0.03, 0.03),
            'spike': (0.3, 0.3),
        }.get(values['fault.kind'], (0.0, 0.0))
        assert low <= size <= high


def test_given_random_paths_when_made_then_they_keep_inside_the_certified_region(arm):
    for seed in range(5):
        times, points = random_path(arm, np.random.default_rng(seed), 10.0)
        path = CartesianPath(arm, times, points).sample(np.linspace(0.0, 10.0, 2000))
        cosine = arm.sign * np.cos(JointMap(arm).absolute_position(path.position))
        assert cosine.min() > max(arm.cos_min)
        assert np.abs(path.velocity).max() < 2.1


def test_given_a_region_without_room_when_a_path_is_asked_for_then_it_is_refused(paper_arm):
    with pytest.raises(ConfigError, match='no random path'):
        random_path(replace(paper_arm, cos_min=(0.99, 0.99)), np.random.default_rng(1), 10.0)
    with pytest.raises(ConfigError, match='more than 1 s'):
        random_path(paper_arm, np.random.default_rng(1), 0.5)


# ------------------------------------------------------------------ runs


def test_given_factors_when_a_run_is_planned_then_each_arrives_where_it_acts():
    factors = {
        'mass_1': 1.1,
        'mass_2': 0.9,
        'inertia_1': 1.2,
        'inertia_2': 0.8,
        'payload': 0.4,
        'friction': 0.5,
        'noise': 3.0,
        'disturbance': 0.0,
        'sample_time': 0.004,
        'command_delay': 2.0,
        'sample_loss': 0.1,
        'compensation': 'always',
        'plant': 'nonlinear_without_coriolis',
        'diagnosis.dwell': 0.05,
        'fault.kind': 'drift',
        'fault.sensor': 'both',
        'fault.rate': 0.2,
        'fault.onset': 1.0,
        'fault.duration': 0.5,
        'fault.sign': -1.0,
    }
    campaign = resolve(small(factors=factors, plan={'method': 'random', 'runs': 1}), 's', '.')
    plan = plan_run(campaign, 0)
    scenario = plan.scenario
    assert scenario.mass_factors == (1.1, 0.9) and scenario.inertia_factors == (1.2, 0.8)
    assert (scenario.payload, scenario.friction_factor) == (0.4, 0.5)
    assert (scenario.noise_factor, scenario.disturbance_factor) == (3.0, 0.0)
    assert scenario.plant == 'nonlinear_without_coriolis'
    assert plan.arm.sample_time == 0.004 and plan.parameters.dwell == 0.05
    assert (plan.delay, plan.loss, plan.compensation) == (2, 0.1, 'always')
    assert [(f.sensor, f.kind, f.rate, f.onset, f.duration) for f in scenario.faults] == [
        (name, 'drift', -0.2, 1.0, 0.5) for name in plan.arm.sensor_names
    ]
    plan.gains.check_arm(plan.arm)
    assert len(plan.simulate().time) == 751


def test_given_noise_that_is_larger_than_stated_when_simulated_then_readings_are_noisier():
    def spread(noise):
        campaign = resolve(
            small(factors={'noise': noise}, plan={'method': 'random', 'runs': 1}), 's', '.'
        )
        run = plan_run(campaign, 0).simulate()
        return (run.measured - run.position)[100:].std(axis=0)

    np.testing.assert_allclose(spread(3.0) / spread(1.0), 3.0, rtol=0.1)
    assert np.all(spread(0.0) == 0.0)


def test_given_no_factors_when_run_then_it_is_the_shipped_scenario_with_another_seed(
    paper_arm, two_faults
):
    campaign = resolve(
        {'name': 'plain', 'plan': {'method': 'random', 'runs': 1}, 'duration': 7.0}, 's', '.'
    )
    plan = plan_run(campaign, 0)
    assert plan.scenario.faults == two_faults.faults
    scenario = replace(two_faults, seed=plan.scenario.seed, duration=7.0)
    run, other = plan.simulate(), run_closed_loop(paper_arm, plan.gains, scenario)
    np.testing.assert_array_equal(run.position, other.position)
    np.testing.assert_array_equal(run.fault_estimate, other.fault_estimate)


def test_given_the_text_of_a_campaign_when_read_again_then_any_run_is_the_same(campaign, serial):
    again = Campaign(campaign.text)
    assert again.key == campaign.key
    for number in (17, 3):
        assert same(run_one(again, number), serial[number])


def test_given_runs_when_measured_then_figures_say_what_happened(serial):
    assert len({row['seed'] for row in serial}) == len(serial)
    for row in serial:
        assert row['stable'] and row['false_alarms'] == 0
        assert row['score_before_1'] < 1.0 and row['score_before_2'] < 1.0
        assert (row['kind'] == 'none') == (row['sensor'] == 'none')
    biased = [row for row in serial if row['kind'] == 'bias']
    assert biased
    for row in biased:
        assert row['detected'] and row['isolated'] and row['said_kind'] == 'bias'
        assert 0.0 < row['detection_delay'] < 0.03 and row['onset_error'] < 0.01
        assert row['size_error'] < 0.1
        wanted = row['fault.size']
        assert abs(row['size_at_detection'] - wanted) < 0.1
    for row in serial:
        if row['kind'] == 'none':
            assert not row['detected'] and row['said_sensor'] == 'none'
            assert np.isnan(row['detection_delay'])


def test_given_a_run_when_measured_then_sums_by_configuration_give_the_rms(campaign):
    plan = plan_run(
        campaign, next(n for n in range(24) if campaign.values(n)['fault.kind'] == 'none')
    )
    run = plan.simulate()
    found = figures(plan, run)
    squares = sum(found['error_squares_1']) + sum(found['error_squares_2'])
    counts = sum(found['error_counts_1']) + sum(found['error_counts_2'])
    assert counts == 2 * np.count_nonzero(run.time >= 1.0)
    assert np.sqrt(squares / counts) == pytest.approx(found['fault_rms_before'], rel=1e-9)


def test_given_a_twin_when_run_then_the_ratio_of_tracking_errors_is_there():
    campaign = resolve(
        small(
            twin=True,
            plan={'method': 'random', 'runs': 1},
            factors={
                'fault.kind': 'bias',
                'fault.size': 0.3,
                'fault.onset': 1.5,
                'compensation': 'off',
            },
        ),
        's',
        '.',
    )
    assert run_one(campaign, 0)['tracking_ratio'] > 5.0


def test_given_a_limit_when_run_then_so_many_runs_are_compared_with_the_best_possible():
    campaign = resolve(
        small(
            limit=2,
            plan={'method': 'random', 'runs': 5},
            factors={'fault.kind': 'bias', 'fault.size': 0.3, 'fault.onset': 1.2},
        ),
        's',
        '.',
    )
    assert [has_limit(campaign.spec, n) for n in range(5)] == [False, False, True, False, True]
    row = run_one(campaign, 2)
    assert 0.0 < row['limit_fault_limit_arm_known'] < row['limit_fault_limit_within_priors']
    assert row['limit_fault_ours'] > row['limit_fault_limit_arm_known']
    assert not any(name.startswith('limit') for name in run_one(campaign, 0))


def test_given_a_loop_that_cannot_work_when_run_then_it_is_not_stable():
    campaign = resolve(
        small(
            plan={'method': 'random', 'runs': 1}, factors={'path': 'random', 'command_delay': 60.0}
        ),
        's',
        '.',
    )
    row = run_one(campaign, 0)
    # Commands that are 60 samples late would make it diverge; the watchdogs hold the arm instead.
    assert row['braked_time'] > 0.5


# ------------------------------------------------------------------ results on disk


def test_given_all_runs_when_the_command_is_run_then_parquet_holds_them_one_a_row(tmp_path, serial):
    file, out = tmp_path / 'small.yaml', tmp_path / 'out'
    file.write_text(yaml.safe_dump(SMALL))
    assert load_spec(file).runs == 24
    assert main(['campaign', str(file), '--out', str(out), '--workers', '0']) == 0
    table = pq.read_table(out / 'runs.parquet')
    assert table['number'].to_pylist() == list(range(24))
    rows = table.to_pylist()
    assert same([{name: row[name] for name in full} for row, full in zip(rows, serial)], serial)
    assert not list((out / 'parts').glob('*'))
    # Again: nothing is left to be done, and nothing is changed.
    assert main(['campaign', str(file), '--out', str(out), '--workers', '0']) == 0
    assert same(pq.read_table(out / 'runs.parquet').to_pylist(), rows)


def test_given_another_campaign_when_its_folder_is_taken_then_it_is_refused(tmp_path, capsys):
    file, out = tmp_path / 'small.yaml', str(tmp_path / 'out')
    file.write_text(yaml.safe_dump(small(plan={'method': 'random', 'runs': 2})))
    assert main(['campaign', str(file), '--out', out, '--workers', '0']) == 0
    file.write_text(yaml.safe_dump(small(plan={'method': 'random', 'runs': 3})))
    capsys.readouterr()
    assert main(['campaign', str(file), '--out', out, '--workers', '0']) == 2
    assert 'another campaign' in capsys.readouterr().err


def test_given_a_damaged_part_when_going_on_then_the_message_names_it(tmp_path, capsys):
    file, out = tmp_path / 'small.yaml', tmp_path / 'out'
    file.write_text(yaml.safe_dump(small(plan={'method': 'random', 'runs': 2})))
    assert main(['campaign', str(file), '--out', str(out), '--workers', '0']) == 0
    (out / 'parts' / '00000000-00000001.parquet').write_bytes(b'PAR1 nothing')
    capsys.readouterr()
    assert main(['campaign', str(file), '--out', str(out), '--workers', '0']) == 2
    assert '00000000-00000001.parquet' in capsys.readouterr().err
    (out / 'campaign.json').write_text('{')
    assert main(['campaign', str(file), '--out', str(out), '--workers', '0']) == 2
    assert 'campaign.json' in capsys.readouterr().err


def test_given_a_crash_after_some_chunks_when_run_again_then_only_the_rest_is_done(
    campaign, serial, tmp_path, monkeypatch
):
    folder = CampaignFolder(tmp_path / 'out')
    folder.begin(campaign)
    chunks = execute(campaign, range(24), workers=0, chunk=5)
    for _ in range(2):
        folder.add(campaign, next(chunks))
    chunks.close()
    assert folder.finished() == set(range(10))
    file = tmp_path / 'small.yaml'
    file.write_text(yaml.safe_dump(SMALL))
    done = []
    import lpv_campaign.execution.execute as module

    true = module.run_one
    monkeypatch.setattr(module, 'run_one', lambda c, n: done.append(n) or true(c, n))
    assert main(['campaign', str(file), '--out', str(folder.path), '--workers', '0']) == 0
    assert done == list(range(10, 24))
    rows = CampaignFolder(tmp_path / 'out').table().to_pylist()
    assert same([{name: row[name] for name in full} for row, full in zip(rows, serial)], serial)


def test_given_kill_9_in_the_middle_when_run_again_then_the_results_are_those_of_one_go(tmp_path):
    file, out = tmp_path / 'many.yaml', tmp_path / 'out'
    data = small(
        plan={'method': 'random', 'runs': 200}, factors={'fault.kind': KINDS[:2], 'fault.size': 0.3}
    )
    file.write_text(yaml.safe_dump(data))
    line = [
        sys.executable,
        '-m',
        'lpv_cli.main',
        'campaign',
        str(file),
        '--out',
        str(out),
        '--workers',
        '0',
    ]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, start_new_session=True)
    parts = out / 'parts'
    deadline = time.monotonic() + 120.0
    while not (parts.is_dir() and list(parts.glob('*.parquet'))):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert 0 < len(CampaignFolder(out).finished()) < 200
    assert subprocess.run(line, stdout=subprocess.DEVNULL).returncode == 0
    whole = resolve(data, 'many', '.')
    rows = pq.read_table(out / 'runs.parquet').to_pylist()
    assert [row['number'] for row in rows] == list(range(200))
    for number in (0, 77, 199):
        full = run_one(whole, number)
        assert same({name: rows[number][name] for name in full}, full)
    assert json.loads((out / 'campaign.json').read_text())['spec'] == data
