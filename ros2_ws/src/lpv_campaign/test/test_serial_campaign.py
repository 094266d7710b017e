"""Campaigns of serial arms: plans, runs, results, report."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from lpv_campaign.execution.execute import run_one
from lpv_campaign.execution.runs import plan_run
from lpv_campaign.plan.campaign import Campaign, resolve
from lpv_campaign.plan.paths import random_joint_path
from lpv_cli.main import main
from lpv_core.control.serial_path import SerialPath
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file

pytestmark = pytest.mark.slow

SMALL = {
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
TWO_LINKS = {'arm': 'paper', 'scenario': 'two_faults'}
JOINTS = ('shoulder_pan', 'shoulder_lift', 'elbow', 'wrist_1', 'wrist_2', 'wrist_3')


@pytest.fixture(scope='module')
def campaign():
    return resolve(SMALL, 'steps', '.')


@pytest.fixture(scope='module')
def rows(campaign):
    return [run_one(campaign, number) for number in range(campaign.spec.runs)]


def faulty(rows, sensor):
    return next(r for r in rows if r['fault.kind'] == 'bias' and r['fault.sensor'] == sensor)


@pytest.mark.parametrize(
    'field, change',
    [
        ('designs', {'designs': ['paper']}),
        ('limit', {'limit': 1}),
        ('kind', {'scenario': 'two_faults'}),
        ('factors.mass_1', {'factors': {'mass_1': 1.0}}),
        ('factors.sample_loss', {'factors': {'sample_loss': 0.1}}),
        ('factors.plant', {'factors': {'plant': 'lpv'}}),
        ('factors.fault.sensor', {'factors': {'fault.sensor': 'link1_angle'}}),
        ('factors.parameter_error', {'factors': {'parameter_error': 0.6}}),
        ('factors.parameter_error', {'factors': {'parameter_error': 0.05}, **TWO_LINKS}),
    ],
)
def test_given_what_its_arm_does_not_have_when_resolved_then_the_error_names_it(field, change):
    with pytest.raises(ConfigError) as error:
        resolve({**SMALL, **change}, 'steps', '.', designed=False)
    assert error.value.field == field


def test_given_a_small_step_of_any_encoder_when_run_then_it_is_found_and_named_in_20_ms(rows):
    one = faulty(rows, 'elbow_encoder')
    assert one['isolated'] and one['said_sensor'] == one['sensor'] == 'elbow_encoder'
    assert 0.0 < one['detection_delay'] < 0.02 and one['size_error'] < 2e-3


def test_given_two_faulty_encoders_when_run_then_both_are_named_and_no_other(rows):
    two = faulty(rows, 'both')
    assert two['isolated'] and two['sensor'] == two['said_sensor']
    assert two['sensor'].count('+') == 1 and two['detection_delay'] < 0.02


def test_given_no_fault_when_run_then_there_is_no_alarm_and_each_joint_has_its_error(rows):
    healthy = next(r for r in rows if r['fault.kind'] == 'none')
    assert healthy['false_alarms'] == 0 and healthy['stable']
    errors = [healthy[f'error_rms_{i}'] for i in range(1, 7)]
    assert np.isfinite(errors).all() and max(errors) > 1e-4


def test_given_the_text_of_a_campaign_when_run_elsewhere_then_every_number_is_the_same(
    campaign, rows
):
    again = Campaign(campaign.text)
    assert again.arm == campaign.arm and again.key == campaign.key
    assert repr(run_one(again, 1)) == repr(rows[1])


def test_given_two_runs_when_planned_then_arms_paths_and_noise_differ(campaign):
    one, two = (plan_run(campaign, number).scenario for number in (0, 1))
    assert one.seed != two.seed and one.waypoints != two.waypoints
    assert one.parameter_error == 0.05 and one.payload == 1.5


@pytest.mark.parametrize('name', ['ur10', 'panda'])
def test_given_random_paths_when_made_then_the_arm_can_follow_them(name):
    arm = load_any_arm(bringup_file('arms', name))
    for seed in range(3):
        times, points = random_joint_path(arm, np.random.default_rng(seed), 10.0)
        path = SerialPath(arm, times, points).sample(np.linspace(0.0, 10.0, 501))
        share = np.abs(path.velocity).max(axis=0) / np.array(arm.velocity_limit)
        assert share.min() > 0.05 and share.max() < 0.65


def test_given_a_serial_arm_when_the_command_is_run_then_results_and_report_name_all_joints(
    tmp_path, capsys
):
    spec = {**SMALL, 'plan': {'method': 'random', 'runs': 3}}
    (tmp_path / 'steps.yaml').write_text(yaml.safe_dump(spec))
    out = tmp_path / 'out'
    command = ['campaign', str(tmp_path / 'steps.yaml'), '--out', str(out), '--workers', '0']
    assert main(command) == 0
    table = pq.read_table(out / 'runs.parquet')
    assert table.num_rows == 3 and 'score_before_6' in table.column_names
    numbers = json.loads((out / 'report.json').read_text())
    assert [e['sensor'] for e in numbers['errors']] == [f'{name}_encoder' for name in JOINTS]
    capsys.readouterr()
    assert main(command) == 0
    assert '3 of 3 runs are here already' in capsys.readouterr().out


def test_given_a_serial_arm_when_a_run_is_asked_for_as_a_bag_then_one_line_refuses(
    tmp_path, capsys
):
    (tmp_path / 'steps.yaml').write_text(yaml.safe_dump(SMALL))
    arguments = ['campaign', str(tmp_path / 'steps.yaml'), '--run', '0', '--bag', 'bag']
    assert main(arguments) == 2
    assert 'not of serial ones' in capsys.readouterr().err
