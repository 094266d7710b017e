import contextlib
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from campaign_files import FACTORS, SMALL, UR10, assert_same, command, resolved, rows_of, written
from fault_injection import with_sensors
from ros2_commands import Running

from lpv import Alarm, AlarmEvent, ConfigError, Fault, load_arm, save_gains
from lpv.campaign.execution import execute
from lpv.campaign.execution.execute import WorkerError, chunks_of, worker_pool
from lpv.campaign.execution.run_metrics import figures
from lpv.campaign.execution.runs import plan_run, repeat, run_one
from lpv.campaign.plan import spec
from lpv.campaign.plan.campaign import Campaign, resolve
from lpv.campaign.plan.random_paths import random_path
from lpv.core.control.path import CartesianPath, PlanarWaypoints, SerialPath
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.transport import Transport
from lpv.core.support import config, resources
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import planar_model

pytestmark = pytest.mark.slow

FEW = {**SMALL, 'plan': {'method': 'random', 'runs': 8}}
RANGE = {'low': 0.0, 'high': 1.0}
WRONG = {
    'plan.method': [{'plan': {'method': 'grid'}}],
    'plan.runs': [{'plan': {'method': 'random', **n}} for n in ({}, {'runs': 0}, {'runs': 10**9})],
    'plan.repeats': [{'plan': {'method': 'random', 'runs': 5, 'repeats': 2}}],
    'duration': [{'duration': float('nan')}, {'duration': -1.0}], 'speed': [{'speed': 1.0}],
    'designs': [{'designs': 'paper'}, {'designs': ['paper', 'paper']}],
    'factors': [{'factors': [1]}],
}  # fmt: skip
WRONG_FACTORS = {
    'fault.size': [{'bais': 1.0}, True, []], 'fault.size.high': [{'low': 1.0}],
    'fault.kind': [['bias', 'bad'], 1.0],
    'mass_1': [{'low': 1.0, 'high': 0.9}, {'low': -1.0, 'high': 0.9}],
    'mass_1.high': [{'low': 0.5, 'high': float('inf')}], 'masss': [1.0],
    'noise.low': [{**RANGE, 'spacing': 'log'}], 'noise.spacing': [{**RANGE, 'spacing': 'x'}],
    'noise.levels': [{**RANGE, 'levels': 1}], 'noise': ['loud', [1.0, 1.0]],
    'sample_time': [{'low': 0.001, 'high': 0.002}], 'command_delay': [1.5, 64.0],
    'compensation': ['sometimes'], 'payload': [1e5],
}  # fmt: skip
OF_BIAS = {'fault.kind': 'bias', 'fault.size': 0.1}
for _field, _values in WRONG_FACTORS.items():
    _name = '.'.join(_field.split('.')[: 2 if _field.startswith('fault') else 1])
    WRONG[f'factors.{_field}'] = [{'factors': {**OF_BIAS, _name: value}} for value in _values]
FACTORIAL = {'plan': {'method': 'factorial'}}
WRONG['factors.fault.size'] += [
    {'factors': {**OF_BIAS, 'fault.size': size}} for size in (1e4, [0.1, 0.0], {'scale': 0.1})
] + [
    {'factors': {'fault.kind': ['none', 'bias']}},
    {**FACTORIAL, 'factors': {**OF_BIAS, 'fault.size': RANGE}},
    {'factors': {'fault.kind': 'noise', 'fault.size': {'low': -0.1, 'high': 0.1}}},
    {'factors': {'fault.kind': 'stuck', 'fault.size': 0.1}},
]
WRONG['factors.fault.rate'] = [
    {'factors': {'fault.kind': ['bias', 'drift'], 'fault.size': 0.1}},
    {'factors': {**OF_BIAS, 'fault.rate': 0.1}},
    {'factors': {'fault.kind': 'none', 'fault.rate': 0.1}},
]
OF_REAL_ARM = {'designs': ['gains.yaml'], 'arm': 'real_arm', 'scenario': 'real_arm'}


@pytest.fixture(scope='module')
def small():
    return resolve(SMALL, 'small', '.')


@pytest.fixture(scope='module')
def few():
    return resolve(FEW, 'few', '.')


@pytest.fixture(scope='module')
def serial(small):
    """Rows of all its runs, one after the other in this process."""
    return [run_one(small, number) for number in range(small.spec.runs)]


@pytest.mark.parametrize('base, field, change', [
    *((SMALL, field, change) for field, changes in WRONG.items() for change in changes),
    (SMALL, 'factors.fault.sensor', {'factors': {**OF_BIAS, 'fault.sensor': 'elbow'}}),
    (SMALL, 'factors.fault.onset', {'factors': {'noise': 1.0, 'fault.onset': 3.0}}),
    (SMALL, 'factors.design', {'factors': {'design': 'other'}}),
    (SMALL, 'path.waypoints[0].joints', {'scenario': 'ur10', 'factors': {}}),
    (SMALL, 'requirement', {'designs': ['nowhere']}),
    *((SMALL, field, {field: 'nowhere'}) for field in ('arm', 'scenario')),
    (SMALL, 'scenario', {'factors': {'path': ['random', 'nowhere']}}),
    (SMALL, 'gains.arm_sha256', OF_REAL_ARM),
    (SMALL, 'gains.arm_sha256', {'designs': ['gains.yaml'], 'factors': {'sample_time': 0.004}}),
    *(
        (SMALL, f'factors.diagnosis.{name}', {'factors': {f'diagnosis.{name}': value}})
        for name, value in (('hours_between_false_alarms', 0.0), ('sigmas', [3.0, 11.0]))
    ),
    (UR10, 'designs', {'designs': ['paper']}),
    (UR10, 'path.waypoints', {'scenario': 'two_faults', 'factors': {}}),
    (UR10, 'factors.disturbance', {'factors': {'disturbance': 1.0}}),
    (UR10, 'factors.plant', {'factors': {'plant': 'lpv'}}),
    (UR10, 'factors.fault.sensor', {'factors': {**OF_BIAS, 'fault.sensor': 'link1_angle'}}),
])  # fmt: skip
def test_given_a_wrong_field_when_read_then_it_is_named(base, field, change, tmp_path, paper_gains):
    save_gains(paper_gains, tmp_path / 'gains.yaml')
    with pytest.raises(ConfigError) as error:
        resolve({**base, **change}, 'misfit', tmp_path)
    assert error.value.field == field


@pytest.mark.parametrize('name', sorted(resources.shipped_files('campaigns')))
def test_given_a_shipped_campaign_when_read_then_it_is_valid(name):
    assert spec.parse_spec(config.read_yaml(resources.shipped_files('campaigns')[name])).runs >= 30


def test_given_a_plan_when_sampled_then_each_combination_or_stratum_comes_once_a_repeat(small):
    factors = """{fault.kind: [none, bias], noise: {low: 0.5, high: 2.0, levels: 3},
                  payload: [0.0, 0.5], friction: 1.0, fault.size: 0.1}"""
    factorial = resolved(factors, plan={'method': 'factorial', 'repeats': 2})
    values = [factorial.values(number) for number in range(factorial.spec.runs)]
    assert list(Counter(map(str, values)).values()) == [2] * 12
    assert {v['noise'] for v in values} == {0.5, 1.25, 2.0}
    # Both ends of a range are hit, however many values another kind of fault has.
    by_kind = """{fault.kind: [bias, scale],
                  fault.size: {bias: {low: 0.1, high: 0.3}, scale: [0.1, 0.2, 0.3]}}"""
    factorial = resolved(by_kind, plan={'method': 'factorial'})
    values = [factorial.values(number) for number in range(factorial.spec.runs)]
    assert {v['fault.size'] for v in values if v['fault.kind'] == 'bias'} == {0.1, 0.3}
    # A latin hypercube hits every stratum of every factor once.
    plan = spec.Plan(spec.parse_spec({**SMALL, 'plan': {'method': 'latin_hypercube', 'runs': 50}}))
    points = np.array([plan.point(number) for number in range(50)])
    for column in points.T:
        assert sorted((column * 50).astype(int)) == list(range(50))
    assert abs(np.corrcoef(points.T)[0, 1]) < 0.4
    # The first runs of a random plan stay the same where it is made longer.
    long = resolved(FACTORS, 400, seed=1)
    for number in range(4):
        assert small.values(number) == long.values(number)
        assert plan_run(small, number).scenario == plan_run(long, number).scenario


def test_given_random_paths_when_made_then_they_keep_inside_the_certified_region(arm):
    planar = planar_model(arm)
    for seed in range(5):
        found = random_path(arm, np.random.default_rng(seed), 10.0)['waypoints']
        times, points = [p['t'] for p in found], tuple((p['x'], p['y']) for p in found)
        path = CartesianPath(arm, times, PlanarWaypoints(points)).sample(np.linspace(0, 10, 2000))
        cosine = planar.sign * np.cos(JointMap(planar).absolute_position(path.position))
        assert cosine.min() > max(planar.cos_min) and np.abs(path.velocity).max() < 2.1
    with pytest.raises(ConfigError, match='more than 1 s'):
        random_path(arm, np.random.default_rng(1), 0.5)


@pytest.mark.parametrize('name', ['ur10', 'panda'])
def test_given_random_joint_paths_when_made_then_the_arm_can_follow_them(name):
    arm = load_arm(name)
    for seed in range(3):
        found = random_path(arm, np.random.default_rng(seed), 10.0)['waypoints']
        path = SerialPath(arm, *zip(*((p['t'], p['joints']) for p in found))).sample(
            np.linspace(0.0, 10.0, 501)
        )
        share = np.abs(path.velocity).max(axis=0) / np.array(arm.velocity_limit)
        assert share.min() > 0.05 and share.max() < 0.65


def test_given_factors_when_a_run_is_planned_then_each_arrives_where_it_acts():
    factors = """
        {mass_1: 1.1, mass_2: 0.9, inertia_1: 1.2, inertia_2: 0.8, payload: 0.4, friction: 0.5,
        noise: 3.0, disturbance: 0.0, sample_time: 0.004, command_delay: 2.0, sample_loss: 0.1,
        compensation: always, plant: nonlinear_without_coriolis, diagnosis.clear_dwell: 0.05,
        fault.kind: drift, fault.sensor: both, fault.rate: 0.2, fault.onset: 1.0,
        fault.duration: 0.5, fault.sign: -1.0}
    """
    plan = plan_run(resolved(factors, designs=['paper']), 0)
    scenario = plan.scenario
    arrived = {
        'mass_factors': (1.1, 0.9), 'inertia_factors': (1.2, 0.8), 'payload': 0.4,
        'friction_factor': 0.5, 'noise_factor': 3.0, 'disturbance_factor': 0.0,
        'plant': 'nonlinear_without_coriolis',
    }  # fmt: skip
    assert vars(scenario).items() >= arrived.items()
    assert plan.arm.sample_time == 0.004 and plan.parameters.clear_dwell == 0.05
    assert plan.transport == Transport(2, 0.1) and plan.values['compensation'] == 'always'
    faults = [Fault(name, 'drift', 1.0, 0.5, rate=-0.2) for name in plan.arm.sensor_names]
    assert list(scenario.faults) == faults
    plan.gains.check_arm(plan.arm)
    assert len(plan.simulate().time) == 751


def test_given_a_range_of_delays_when_run_then_the_row_has_the_simulated_one():
    late = resolved('{command_delay: {low: 2.4, high: 2.45}}', duration=0.5)
    plan, _, row = repeat(late, 0)
    assert row['command_delay'] == plan.transport.delay == 2


def test_given_no_factors_when_run_then_it_is_the_shipped_scenario_reseeded(paper_arm, two_faults):
    plan = plan_run(resolved(duration=7.0), 0)
    assert plan.scenario.faults == two_faults.faults
    scenario = replace(two_faults, seed=plan.scenario.seed, duration=7.0)
    run, other = plan.simulate(), run_closed_loop(paper_arm, scenario, plan.gains)
    np.testing.assert_array_equal(run.position, other.position)
    np.testing.assert_array_equal(run.fault_estimate, other.fault_estimate)


def test_given_runs_when_measured_then_figures_say_what_happened(serial):
    assert len({row['seed'] for row in serial}) == len(serial)
    assert {'none', 'bias'} < {row['kind'] for row in serial}
    for row in serial:
        assert row['stable'] and row['false_alarms'] == 0
        assert row['score_before_1'] < 1.0 and row['score_before_2'] < 1.0
        assert (row['kind'] == 'none') == (row['sensor'] == 'none')
        if row['kind'] == 'bias':
            assert row['detected'] and row['isolated'] and row['said_kind'] == 'bias'
            assert 0.0 < row['detection_delay'] < 0.03
            assert row['onset_error'] < 0.01 and row['size_error'] < 0.1
            assert row['size_at_detection'] == pytest.approx(row['fault.size'], abs=0.1)
        elif row['kind'] == 'none':
            assert not row['detected'] and row['said_sensor'] == 'none'
            assert np.isnan(row['detection_delay'])


def test_given_a_twin_or_late_commands_when_run_then_errors_are_compared_or_the_arm_is_held():
    factors = '{fault.kind: bias, fault.size: 0.3, fault.onset: 1.2}'
    row = run_one(resolved(factors, twin=True), 0)
    assert row['tracking_ratio'] > 1.0 and row['early_time'] == pytest.approx(1.2, abs=0.005)
    assert row['healthy_time'] == row['early_time'] and row['fault_size'] == 0.3
    late = resolved('{path: random, command_delay: 60.0}')
    assert run_one(late, 0)['braked_time'] > 0.5


def test_given_a_wrong_rate_when_it_is_named_then_it_is_found_and_no_alarm_is_false(tmp_path):
    arm = load_arm('ur10')
    arm = replace(with_sensors(arm, rates='independent'), covariance=None)
    save_arm(arm, tmp_path / 'arm.yaml')
    factors = {'fault.kind': 'rate_bias', 'fault.sensor': 'elbow_encoder', 'fault.size': 0.3}
    spec = {**UR10, 'arm': 'arm.yaml', 'duration': 4.0, 'factors': {**factors, 'fault.onset': 3.0}}
    row = run_one(resolve(spec, 'rates', tmp_path), 0)
    assert row['isolated'] and row['said_kind'] == row['kind'] == 'rate_bias'
    assert row['false_alarms'] == row['wrong_alarms'] == 0 and row['detection_delay'] < 0.3


def figures_of(faults, *alarms, estimate=0.0):
    """Figures of 8 s of two sensors from faults, alarms (index, onset, confirmation [s]) and an
    estimate; thresholds are 0.1."""
    alarms = [
        Alarm(AlarmEvent.RAISED, i, 'ab'[i], round(1e9 * onset), round(1e9 * t), 0.1, 0.1, 'bias',
              1.0)
        for i, onset, t in alarms
    ]  # fmt: skip
    time, zeros = np.arange(0.0, 8.0, 0.1), np.zeros((80, 2))
    signals = 'position', 'reference', 'torque', 'fault', 'estimate'
    run = SimpleNamespace(
        time=time, alarms=alarms, threshold=zeros + 0.1, braked=time < 0.0,
        inconsistent=time < 0.0, fault_estimate=zeros + estimate, **dict.fromkeys(signals, zeros),
    )  # fmt: skip
    arm = SimpleNamespace(sensor_names=('a', 'b'), sample_time=0.1)
    return figures(arm, SimpleNamespace(faults=faults, seed=1), run)


@pytest.mark.parametrize(('at', 'delay'), [(2.0, None), (5.5, 0.5)])
def test_given_two_faults_when_an_alarm_comes_before_its_own_then_that_was_not_found(at, delay):
    faults = Fault('a', 'bias', 1.0, size=0.1), Fault('b', 'bias', 5.0, size=0.1)
    row = figures_of(faults, (0, 1.09, 1.1), (1, at - 0.01, at))
    assert row['detected'] == row['isolated'] == (delay is not None)
    assert row['wrong_alarms'] == (delay is None) and row['false_alarms'] == 0
    assert row['detection_delay'] == pytest.approx(delay or np.nan, nan_ok=True)


def test_given_an_estimate_of_a_healthy_run_when_measured_then_it_is_scored_by_its_threshold():
    row = figures_of([], estimate=-0.05)
    assert (row['score_before_1'], row['fault_rms_before']) == pytest.approx((0.5, 0.05))


def test_given_a_fault_after_the_end_of_a_run_when_measured_then_there_was_none_to_find():
    late = Fault('a', 'bias', 8.0, size=0.1)
    row = figures_of([late])
    assert (row['kind'], row['sensor'], row['healthy_time']) == ('none', 'none', row['observed'])
    assert figures_of([Fault('b', 'bias', 1.0, size=0.1), late], (1, 1.0, 1.1))['isolated']


@pytest.mark.parametrize(('onset', 'at', 'found', 'false'), [
    (1.1, 1.3, True, 0), (1.3, 1.3, False, 0), (1.3, 2.5, False, 1), (2.0, 2.0, False, 1),
])  # fmt: skip
def test_given_a_fault_that_is_over_at_its_alarm_then_it_counts_as_found(onset, at, found, false):
    faults = [Fault('a', 'bias', 1.0, 0.2, size=0.1)]
    row = figures_of(faults, (0, onset, at))
    assert (row['detected'], row['isolated'], row['false_alarms']) == (found, found, false)
    assert figures_of(faults, (1, onset, at))['false_alarms'] == 1 - (at < 1.2)


def test_given_another_requirement_below_the_same_name_then_the_campaign_is_another_one(tmp_path):
    requirement = config.read_yaml(resources.bringup_file('requirements', 'paper'))
    keys = set()
    for fastest in (60.0, 60.0, 30.0):
        requirement['observer']['fastest'] = fastest
        written(tmp_path / 'mine.yaml', requirement)
        keys.add(resolve({**SMALL, 'designs': ['mine.yaml']}, 'spec', tmp_path).key)
    assert len(keys) == 2


def test_given_steps_of_a_serial_arms_encoders_when_run_then_all_and_only_these_are_named():
    campaign = resolve(UR10, 'steps', '.')
    rows = [run_one(campaign, number) for number in range(campaign.spec.runs)]
    for row in rows:
        assert row['stable'] and np.isfinite([row[f'error_rms_{i}'] for i in range(1, 7)]).all()
        if row['kind'] == 'none':
            assert row['false_alarms'] == 0
        else:
            assert row['isolated'] and row['said_sensor'] == row['sensor']
            assert 0.0 < row['detection_delay'] < 0.02 and row['size_error'] < 2e-3
            assert row['sensor'].count('+') == (row['fault.sensor'] == 'both')
    assert_same([run_one(Campaign(campaign.text), 1)], rows[1:2])
    one, two = (plan_run(campaign, number).scenario for number in (0, 1))
    assert one.seed != two.seed and one.waypoints != two.waypoints
    assert one.parameter_error == 0.05 and one.payload == 1.5


KILLED = """
import os, signal, sys
from lpv.campaign.execution import execute
from lpv.cli.main import main
true = execute.run_one
def run_one(campaign, number):
    return os.kill(os.getpid(), signal.SIGKILL) if number == 21 else true(campaign, number)
execute.run_one = run_one
main(sys.argv[1:])"""
"""The command, killed in its second chunk."""


def test_given_kill_9_when_run_again_then_all_is_there(small, serial, tmp_path, monkeypatch, call):
    file, out = written(tmp_path / 'small.yaml', SMALL), tmp_path / 'out'
    killed = subprocess.run([sys.executable, '-c', KILLED, *command(file, out)])
    assert killed.returncode == -signal.SIGKILL
    left = execute.ResultsFolder(out).missing(execute.chunks_of(small))
    assert len(left) == 1
    done, true = [], execute.run_one
    monkeypatch.setattr(execute, 'run_one', lambda c, n: done.append(n) or true(c, n))
    for _ in range(2):  # the second time nothing is left to be done
        call(*command(file, out))
        assert done == sum(left.values(), [])
    assert_same(rows_of(out), serial)
    names = {file.name for file in (out / 'chunks').iterdir()}
    assert names == {f'000000{first}0.parquet' for first in (0, 2)}


def kill(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def dask(name, folder, *words):
    """A program of Dask on the loopback address as a process."""
    program = (sys.executable, '-m', f'distributed.cli.dask_{name}')
    return Running(*words, '--host', '127.0.0.1', '--no-dashboard', program=program, cwd=folder)


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, and what starts workers that it knows, each a process of its own."""
    options = ['--nworkers', '1', '--nthreads', '1', '--no-nanny', '--local-directory', tmp_path]
    with contextlib.ExitStack() as stack:
        running = stack.enter_context(dask('scheduler', tmp_path, '--port', '0'))
        address = re.search(r'tcp://127\.0\.0\.1:\d+', running.until('tcp://127'))[0]

        def start(count):
            started = [dask('worker', tmp_path, address, *options) for _ in range(count)]
            for one in map(stack.enter_context, started):
                one.until('Registered to:')
            return [one.process for one in started]

        yield address, start


def chunks(campaign, workers=None, scheduler=None, size=8):
    with worker_pool(workers, scheduler) as do:
        for _, rows in do(campaign, chunks_of(campaign, size)):
            yield rows


def test_given_two_workers_when_one_dies_then_nothing_is_lost_and_without_any_it_ends(
    cluster, small, few, serial, tmp_path, call, monkeypatch
):
    scheduler, workers = cluster
    pytest.raises(WorkerError, next, chunks(small, scheduler=scheduler)).match('has no workers')
    (first, second), rows = workers(2), []
    for part in chunks(few, scheduler=scheduler, size=2):
        rows += part
        if len(rows) == 2:
            kill(first)
    assert_same(sorted(rows, key=lambda row: row['number']), serial[: len(rows)])
    assert len(rows) == few.spec.runs
    # The other one did what the dead one had in hand, and is there for the next command.
    file, out = written(tmp_path / 'few.yaml', FEW), tmp_path / 'out'
    call('campaign', file, '--out', out, '--scheduler', scheduler, '--no-report')
    assert_same(rows_of(out), serial[: len(rows)])
    other = Campaign(small.text.replace(small.software, 'another'))
    pytest.raises(WorkerError, list, chunks(other, scheduler=scheduler)).match('another version')
    monkeypatch.setattr(execute, '_NO_WORKER_TIMEOUT', 2.0)
    found = chunks(small, scheduler=scheduler, size=2)
    next(found)
    kill(second)
    pytest.raises(WorkerError, list, found).match('no worker has been left')


def test_given_no_cluster_when_run_then_a_process_of_its_own_does_the_same(few, serial):
    rows = sum(chunks(few, workers=1, size=2), [])
    assert_same(sorted(rows, key=lambda row: row['number']), serial[: few.spec.runs])
