"""Campaigns: files, plans, runs, results on disk, going on after a crash."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from lpv.campaign.execution.execute import ResultsFolder, chunks_of
from lpv.campaign.execution.runs import plan_run, run_one
from lpv.campaign.plan.campaign import Campaign, resolve
from lpv.campaign.plan.random_paths import random_joint_path, random_planar_path
from lpv.campaign.plan.spec import Plan, parse_spec
from lpv.cli.main import main
from lpv.core.control.path import CartesianPath, PlanarWaypoints
from lpv.core.control.serial_path import SerialPath
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.config import read_yaml
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file, shipped_files
from lpv.core.uio.certificate.gains import save_gains
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import planar_model

pytestmark = pytest.mark.slow

KINDS = ['none', 'bias', 'drift', 'stuck', 'scale', 'noise', 'spike', 'dropout']
GAINS = str(shipped_files('gains')['paper'])
SMALL = {
    'name': 'small',
    'designs': [GAINS],
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


RANGE = {'low': 0.0, 'high': 1.0}
WRONG = {
    'plan.method': [{'plan': {'method': 'grid'}}],
    'plan.runs': [{'plan': {'method': 'random', **runs}} for runs in (
        {}, {'runs': 0}, {'runs': 10**9})],
    'plan.repeats': [{'plan': {'method': 'random', 'runs': 5, 'repeats': 2}}],
    'duration': [{'duration': float('nan')}, {'duration': -1.0}],
    'designs': [{'designs': 'paper'}, {'designs': ['paper', 'paper']}],
    'factors': [{'factors': [1]}],
    'speed': [{'speed': 1.0}],
}  # fmt: skip
WRONG_FACTORS = {
    'fault.size': [{'bais': 1.0}, True, []],
    'fault.size.high': [{'low': 1.0}],
    'mass_1': [{'low': 1.0, 'high': 0.9}, {'low': -1.0, 'high': 0.9}],
    'mass_1.high': [{'low': 0.5, 'high': float('inf')}],
    'noise.low': [{**RANGE, 'spacing': 'log'}],
    'noise.spacing': [{**RANGE, 'spacing': 'x'}],
    'noise.levels': [{**RANGE, 'levels': 1}],
    'noise': ['loud', [1.0, 1.0]],
    'masss': [1.0],
    'sample_time': [{'low': 0.001, 'high': 0.002}],
    'command_delay': [1.5, 64.0],
    'compensation': ['sometimes'],
    'fault.kind': [['bias', 'bad'], 1.0],
}
for _field, _values in WRONG_FACTORS.items():
    _name = '.'.join(_field.split('.')[: 2 if _field.startswith('fault') else 1])
    WRONG[f'factors.{_field}'] = [{'factors': {_name: value}} for value in _values]


@pytest.mark.parametrize(
    ('field', 'change'), [(field, change) for field in WRONG for change in WRONG[field]]
)
def test_given_a_wrong_field_when_parsed_then_the_error_names_it(field, change):
    with pytest.raises(ConfigError) as error:
        parse_spec(small(**change))
    assert error.value.field == field


UR10 = {
    'name': 'steps',
    'seed': 2,
    'arm': 'ur10',
    'scenario': 'ur10',
    'duration': 2.5,
    'plan': {'method': 'factorial'},
    'factors': {
        'path': 'random',
        'fault.kind': ['none', 'bias'],
        'fault.sensor': ['elbow_encoder', 'both'],
        'fault.size': {'bias': 0.01},
        'fault.onset': 1.5,
        'parameter_error': 0.05,
        'payload': 1.5,
    },
}


OF_REAL_ARM = {'designs': ['gains.yaml'], 'arm': 'real_arm', 'scenario': 'reach.yaml'}
MISFITS = [
    (SMALL, 'factors.fault.sensor', {'factors': {'fault.sensor': 'elbow'}}),
    (SMALL, 'factors.design', {'factors': {'design': 'other'}}),
    (SMALL, 'path.waypoints[0].joints', {'scenario': 'ur10', 'factors': {}}),
    (SMALL, 'requirement', {'designs': ['nowhere']}),
    (SMALL, 'arm', {'arm': 'nowhere'}),
    (SMALL, 'scenario', {'scenario': 'nowhere'}),
    (SMALL, 'scenario', {'factors': {'path': ['random', 'nowhere']}}),
    (SMALL, 'gains.arm_sha256', OF_REAL_ARM),
    (SMALL, 'gains.arm_sha256', {'designs': ['gains.yaml'], 'factors': {'sample_time': 0.004}}),
    (UR10, 'designs', {'designs': ['paper']}),
    (UR10, 'lpv', {'scenario': 'two_faults', 'factors': {}}),
    (UR10, 'factors.disturbance', {'factors': {'disturbance': 1.0}}),
    (UR10, 'factors.plant', {'factors': {'plant': 'lpv'}}),
    (UR10, 'factors.fault.sensor', {'factors': {'fault.sensor': 'link1_angle'}}),
]
"""A campaign, the field that the error names, and what does not fit its files or its arm."""


@pytest.mark.parametrize(('base', 'field', 'change'), MISFITS)
def test_given_what_does_not_fit_the_files_when_resolved_then_the_error_names_it(
    base, field, change, tmp_path, paper_gains
):
    save_gains(paper_gains, tmp_path / 'gains.yaml')
    (tmp_path / 'reach.yaml').write_text(REACH)
    with pytest.raises(ConfigError) as error:
        resolve({**base, **change}, 'misfit', tmp_path)
    assert error.value.field == field


def test_given_a_file_that_is_no_campaign_when_the_command_is_run_then_one_line_says_so(
    tmp_path, refused
):
    (tmp_path / 'bad.yaml').write_text('name: [')
    for name in ('bad.yaml', 'none.yaml'):
        assert refused(name, 'campaign', tmp_path / name, '--out', tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('name', sorted(shipped_files('campaigns')))
def test_given_a_shipped_campaign_when_read_then_it_is_valid(name):
    assert parse_spec(read_yaml(shipped_files('campaigns')[name])).runs >= 30


# ------------------------------------------------------------------ plans


def points_of(spec):
    plan = Plan(spec)
    return [plan.point(n) for n in range(spec.runs)]


def test_given_a_factorial_plan_when_sampled_then_every_combination_comes_once_a_repeat():
    factors = {
        'fault.kind': ['none', 'bias'],
        'noise': {'low': 0.5, 'high': 2.0, 'levels': 3},
        'payload': [0.0, 0.5],
        'friction': 1.0,
    }
    spec = parse_spec(small(plan={'method': 'factorial', 'repeats': 2}, factors=factors))
    assert spec.runs == 24
    points = [
        tuple(f.value(u) for f, u in zip(spec.factors.values(), point)) for point in points_of(spec)
    ]
    assert set(Counter(points).values()) == {2}
    assert {p[1] for p in points} == {0.5, 1.25, 2.0}


def test_given_a_latin_hypercube_when_sampled_then_every_stratum_of_every_factor_is_hit_once():
    spec = parse_spec(small(plan={'method': 'latin_hypercube', 'runs': 50}))
    points = np.array(points_of(spec))
    for column in points.T:
        assert sorted((column * 50).astype(int)) == list(range(50))
    assert abs(np.corrcoef(points.T)[0, 1]) < 0.4


def test_given_a_random_plan_when_it_is_made_longer_then_the_first_runs_stay_the_same():
    short, long = (
        resolve(small(plan={'method': 'random', 'runs': runs}), 's', '.') for runs in (4, 400)
    )
    for number in range(4):
        assert short.values(number) == long.values(number)
        assert plan_run(short, number).scenario == plan_run(long, number).scenario


def test_given_random_paths_when_made_then_they_keep_inside_the_certified_region(arm):
    planar = planar_model(arm)
    for seed in range(5):
        times, points = random_planar_path(arm, np.random.default_rng(seed), 10.0)
        path = CartesianPath(arm, times, PlanarWaypoints(points))
        path = path.sample(np.linspace(0.0, 10.0, 2000))
        cosine = planar.sign * np.cos(JointMap(planar).absolute_position(path.position))
        assert cosine.min() > max(planar.cos_min)
        assert np.abs(path.velocity).max() < 2.1
    with pytest.raises(ConfigError, match='more than 1 s'):
        random_planar_path(arm, np.random.default_rng(1), 0.5)


@pytest.mark.parametrize('name', ['ur10', 'panda'])
def test_given_random_joint_paths_when_made_then_the_arm_can_follow_them(name):
    arm = load_arm(bringup_file('arms', name))
    for seed in range(3):
        times, points = random_joint_path(arm, np.random.default_rng(seed), 10.0)
        path = SerialPath(arm, times, points).sample(np.linspace(0.0, 10.0, 501))
        share = np.abs(path.velocity).max(axis=0) / np.array(arm.velocity_limit)
        assert share.min() > 0.05 and share.max() < 0.65


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
        'diagnosis.clear_dwell': 0.05,
        'fault.kind': 'drift',
        'fault.sensor': 'both',
        'fault.rate': 0.2,
        'fault.onset': 1.0,
        'fault.duration': 0.5,
        'fault.sign': -1.0,
    }
    campaign = resolve(
        small(factors=factors, designs=['paper'], plan={'method': 'random', 'runs': 1}), 's', '.'
    )
    plan = plan_run(campaign, 0)
    scenario = plan.scenario
    assert scenario.mass_factors == (1.1, 0.9) and scenario.inertia_factors == (1.2, 0.8)
    assert (scenario.payload, scenario.friction_factor) == (0.4, 0.5)
    assert (scenario.noise_factor, scenario.disturbance_factor) == (3.0, 0.0)
    assert scenario.plant == 'nonlinear_without_coriolis'
    assert plan.arm.sample_time == 0.004 and plan.parameters.clear_dwell == 0.05
    assert (plan.delay, plan.loss, plan.compensation) == (2, 0.1, 'always')
    assert [(f.sensor, f.kind, f.rate, f.onset, f.duration) for f in scenario.faults] == [
        (name, 'drift', -0.2, 1.0, 0.5) for name in plan.arm.sensor_names
    ]
    plan.gains.check_arm(planar_model(plan.arm))
    assert len(plan.simulate().time) == 751


def test_given_no_factors_when_run_then_it_is_the_shipped_scenario_with_another_seed(
    paper_arm, two_faults
):
    campaign = resolve(
        {
            'name': 'plain',
            'designs': [GAINS],
            'plan': {'method': 'random', 'runs': 1},
            'duration': 7.0,
        },
        's',
        '.',
    )
    plan = plan_run(campaign, 0)
    assert plan.scenario.faults == two_faults.faults
    scenario = replace(two_faults, seed=plan.scenario.seed, duration=7.0)
    run, other = plan.simulate(), run_closed_loop(paper_arm, scenario, plan.gains)
    np.testing.assert_array_equal(run.position, other.position)
    np.testing.assert_array_equal(run.fault_estimate, other.fault_estimate)


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


def test_given_a_twin_when_run_then_the_errors_are_compared_with_its():
    factors = {'fault.kind': 'bias', 'fault.size': 0.3, 'fault.onset': 1.2}
    data = small(twin=True, plan={'method': 'random', 'runs': 1}, factors=factors)
    row = run_one(resolve(data, 's', '.'), 0)
    assert row['tracking_ratio'] > 1.0
    assert row['early_time'] == pytest.approx(1.2, abs=0.005)
    assert row['healthy_time'] == row['early_time'] and row['fault_size'] == 0.3


def test_given_commands_that_are_late_when_run_then_the_arm_is_held():
    factors = {'path': 'random', 'command_delay': 60.0}
    data = small(plan={'method': 'random', 'runs': 1}, factors=factors)
    assert run_one(resolve(data, 's', '.'), 0)['braked_time'] > 0.5


def test_given_steps_of_a_serial_arms_encoders_when_run_then_all_and_only_these_are_named():
    campaign = resolve(UR10, 'steps', '.')
    rows = [run_one(campaign, number) for number in campaign.tasks]
    for row in rows:
        assert row['stable']
        assert np.isfinite([row[f'error_rms_{i}'] for i in range(1, 7)]).all()
        if row['kind'] == 'none':
            assert row['false_alarms'] == 0
            continue
        assert row['isolated'] and row['said_sensor'] == row['sensor']
        assert 0.0 < row['detection_delay'] < 0.02 and row['size_error'] < 2e-3
        assert row['sensor'].count('+') == (row['fault.sensor'] == 'both')
    assert same(run_one(Campaign(campaign.text), 1), rows[1])
    one, two = (plan_run(campaign, number).scenario for number in (0, 1))
    assert one.seed != two.seed and one.waypoints != two.waypoints
    assert one.parameter_error == 0.05 and one.payload == 1.5


# ------------------------------------------------------------------ results on disk


def command(file, out, *more):
    return ['campaign', str(file), '--out', str(out), '--workers', '0', '--no-report', *more]


def written(path, **changes):
    path.write_text(yaml.safe_dump(small(**changes)))
    return path


def known(rows):
    return [{n: v for n, v in row.items() if v is not None} for row in rows]


def test_given_results_of_another_campaign_or_damaged_ones_when_going_on_then_they_are_refused(
    tmp_path, refused
):
    file, out = written(tmp_path / 's.yaml', plan={'method': 'random', 'runs': 2}), tmp_path / 'out'
    assert main(command(file, out)) == 0
    other = written(tmp_path / 'other.yaml', plan={'method': 'random', 'runs': 3})
    assert refused('another campaign', *command(other, out))
    for name in ('chunks/00000000.parquet', 'campaign.json'):
        (out / name).write_bytes(b'{PAR1 nothing')
        assert refused(Path(name).name, *command(file, out))


def test_given_a_crash_after_a_chunk_when_run_again_then_only_the_rest_is_done(
    campaign, serial, tmp_path, monkeypatch
):
    folder, chunks = ResultsFolder(tmp_path / 'out'), chunks_of(campaign)
    folder.begin(campaign)
    folder.add('00000000', serial[:20])
    assert folder.missing(chunks) == {'00000020': [20, 21, 22, 23]}
    import lpv.campaign.execution.execute as module

    done, true = [], module.run_one
    monkeypatch.setattr(module, 'run_one', lambda c, n: done.append(n) or true(c, n))
    file = written(tmp_path / 'small.yaml')
    for _ in range(2):  # the second time nothing is left to be done
        assert main(command(file, folder.path)) == 0
        assert done == [20, 21, 22, 23]
        table = pq.read_table(folder.file)
        assert table['number'].to_pylist() == list(range(24))
        rows = [{name: row[name] for name in full} for row, full in zip(table.to_pylist(), serial)]
        assert same(known(rows), known(serial))
    found = sorted(f.name for f in (folder.path / 'chunks').iterdir())
    assert found == ['00000000.parquet', '00000020.parquet']


def test_given_kill_9_in_the_middle_when_run_again_then_the_results_are_those_of_one_go(tmp_path):
    factors = {'fault.kind': KINDS[:2], 'fault.size': 0.3}
    changes = {'plan': {'method': 'random', 'runs': 60}, 'factors': factors}
    file, out = written(tmp_path / 'many.yaml', **changes), tmp_path / 'out'
    line = [sys.executable, '-m', 'lpv.cli.main', *command(file, out)]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, start_new_session=True)
    while not list((out / 'chunks').glob('*.parquet')):
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    whole = resolve(small(**changes), 'many', '.')
    assert 0 < len(ResultsFolder(out).missing(chunks_of(whole))) < 3
    assert main(command(file, out)) == 0
    rows = pq.read_table(out / 'runs.parquet').to_pylist()
    assert [row['number'] for row in rows] == list(range(60))
    for number in (0, 37, 59):
        full = run_one(whole, number)
        assert same(known([{name: rows[number][name] for name in full}]), known([full]))
