"""Archives of bags: what is found, what is measured, what is kept, what the fleet's figures say."""

import json
import os
import re
import shutil

import numpy as np
import pytest
import yaml
from campaign_files import UR10, rows_of, spec
from rosbags.rosbag2 import StoragePlugin, Writer

from lpv.bag.rosbag.interfaces import make_typestore
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.writing import BagWriter
from lpv.bag.run.record import load_run
from lpv.campaign.execution.archive import Archive, archive_text, find_bags, unit_of
from lpv.campaign.execution.bag_figures import STATES, alarm_rows
from lpv.campaign.execution.run_metrics import figures
from lpv.campaign.execution.run_to_bag import differences, stamps_of, write_run_bag
from lpv.campaign.execution.runs import plan_run
from lpv.campaign.plan.campaign import resolve
from lpv.cli.main import main
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent
from lpv.core.support.errors import ConfigError

pytestmark = pytest.mark.slow

TYPESTORE = make_typestore()
JOINT_STATE = 'sensor_msgs/msg/JointState'
FACTORS = """
fault.kind: [none, bias, dropout]
fault.size: 0.3
fault.onset: 1.2
fault.duration: 0.8
path: random
"""
SPEC = spec(FACTORS, seed=4, plan={'method': 'factorial'})
GOOD = ['a/healthy', 'b/bias', 'b/dropout', 'foreign']
BAD = ['b/junk.mcap', 'b/lonely', 'deaf', 'strange']


@pytest.fixture(scope='module')
def runs():
    """Plans and runs by name."""
    campaign = resolve(SPEC, 'fleet', '.')
    plans = {name: plan_run(campaign, k) for k, name in enumerate(('healthy', 'bias', 'dropout'))}
    return {name: (plan, plan.simulate()) for name, plan in plans.items()}


def write_foreign(path, run):
    """A recording of somebody else in sqlite3: joints in another order, and one more."""
    messages = BagMessages(TYPESTORE, 'base')
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/js', JOINT_STATE, typestore=TYPESTORE)
        effort = np.vstack([np.zeros((1, 2)), run.torque[:-1]])
        for stamp, q, v, tau in zip(
            stamps_of(run).tolist(), run.measured, run.measured_velocity, effort
        ):
            values = [[0.5, a[1], a[0]] for a in (q, v, tau)]
            message = messages.joint_state(stamp, ('gripper', 'joint2', 'joint1'), *values)
            writer.write(connection, stamp, TYPESTORE.serialize_cdr(message, JOINT_STATE))


def write_odd(path, topic, msgtype, message):
    with BagWriter(path) as writer:
        writer.add_topic(topic, msgtype)
        for stamp in range(1, 5):
            writer.write(topic, stamp, message)


def write_files(root, content):
    """Files by their path."""
    for name, data in content.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)


@pytest.fixture(scope='module')
def archive(runs, tmp_path_factory):
    """An archive with good bags and bad ones."""
    root = tmp_path_factory.mktemp('archive')
    write_run_bag(*runs['healthy'], root / 'a' / 'healthy')
    for name in ('bias', 'dropout'):
        write_run_bag(*runs[name], root / 'b' / name)
    write_foreign(root / 'foreign', runs['bias'][1])
    others = {
        'b/junk.mcap': b'\x89MCAP0\r\n' + bytes(300),
        'b/lonely/metadata.yaml': (root / 'a' / 'healthy' / 'metadata.yaml').read_bytes(),
        '.hidden/x.mcap': b'',
        'notes/metadata.yaml': b'colour: blue\n',
    }
    write_files(root, others)
    string = 'std_msgs/msg/String'
    write_odd(root / 'deaf', '/chatter', string, TYPESTORE.types[string]('hello'))
    zeros = [(0.0, 0.0)] * 3
    message = BagMessages(TYPESTORE, '').joint_state(1, ('elbow', 'wrist'), *zeros)
    write_odd(root / 'strange', '/js', JOINT_STATE, message)
    return root


@pytest.fixture(scope='module')
def settings(archive, paper_arm, runs):
    return Archive(archive_text(archive, paper_arm, runs['bias'][0].gains))


def fleet(root, out, gains, *more):
    files = ['--arm', 'paper', '--gains', str(gains), '--out', str(out), '--workers', '0']
    return ['fleet', str(root), *files, *more]


@pytest.fixture(scope='module')
def gains(archive):
    return archive / 'a' / 'healthy' / 'gains.yaml'


@pytest.fixture(scope='module')
def done(archive, gains, tmp_path_factory):
    """Results folder of the archive, and its rows by bag."""
    out = tmp_path_factory.mktemp('done') / 'out'
    assert main(fleet(archive, out, gains)) == 3
    return out, {row['bag']: row for row in rows_of(out, 'bags')}


def names(*arguments):
    return [name for (name,) in find_bags(*arguments).values()]


def test_given_an_archive_when_searched_then_bags_are_found_and_nothing_else(archive, tmp_path):
    assert names(archive) == sorted(GOOD + BAD)
    assert names(archive, [archive / 'b']) == sorted(['a/healthy', 'foreign', 'deaf', 'strange'])
    assert unit_of(archive, 'b/bias') == 'b'
    assert unit_of(archive, 'foreign') == ''
    loose = (
        'cut/cut_0.mcap cut/cut_1.mcap loose/one.mcap loose/two.db3 whole/whole.mcap old/old_0.db3'
    )
    write_files(tmp_path, dict.fromkeys(loose.split(), b''))
    assert names(tmp_path) == ['cut', 'loose/one.mcap', 'loose/two.db3', 'old/old_0.db3', 'whole']
    with pytest.raises(ConfigError, match='not a folder'):
        find_bags(tmp_path / 'nowhere')


def test_given_custom_data_when_a_bag_is_asked_whose_it_is_then_the_serial_counts(
    archive, tmp_path
):
    bag = tmp_path / 'week1' / 'bag'
    bag.mkdir(parents=True)
    data = yaml.safe_load((archive / 'a' / 'healthy' / 'metadata.yaml').read_text())
    data['rosbag2_bagfile_information']['custom_data'] = {'serial': 'SN-7'}
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(data))
    assert unit_of(tmp_path, 'week1/bag') == 'SN-7'
    (bag / 'metadata.yaml').write_text('{')
    assert unit_of(tmp_path, 'week1/bag') == 'week1'


def test_given_bags_of_runs_when_replayed_then_their_figures_are_those_of_the_campaign(done, runs):
    _, rows = done
    for bag in ('a/healthy', 'b/bias', 'b/dropout'):
        expected = figures(*runs[bag[2:]])
        assert set(expected) <= set(rows[bag])
        assert differences(rows[bag], expected) == []
    assert rows['b/bias']['detected'] and not rows['a/healthy']['detected']


def test_given_answers_of_a_bag_when_summed_up_then_they_are_those_of_its_record(
    done, archive, runs, paper_arm
):
    _, rows = done
    for name in ('b/bias', 'b/dropout'):
        record, row = load_run(archive / name), rows[name]
        state, estimate, threshold = (
            record.get('fault_estimate', field) for field in ('state', 'estimate', 'threshold')
        )
        stamps = record.stamps['fault_estimate']
        interval = np.append(np.diff(stamps) / 1e9, paper_arm.sample_time)
        for i in (1, 2):
            for k, word in enumerate(STATES):
                expected = interval[state[:, i - 1] == k].sum()
                assert row[f'time_{word}_{i}'] == pytest.approx(expected, abs=1e-9), (name, word)
            here = state[:, i - 1] <= 2
            mine = estimate[here, i - 1]
            assert row[f'fault_mean_{i}'] == pytest.approx(mine.mean())
            assert row[f'fault_rms_{i}'] == pytest.approx(np.sqrt(np.mean(mine**2)))
            assert row[f'fault_largest_{i}'] == np.abs(mine).max()
            assert row[f'threshold_mean_{i}'] == pytest.approx(threshold[here, i - 1].mean())
            used = state[:, i - 1] != 3
            assert row[f'score_{i}'] == (np.abs(estimate) / threshold)[used, i - 1].max()
        assert row['measurements'] == len(record.stamps['joint_states']) == 1501
        assert row['duration'] == 3.0
        assert row['observed'] == pytest.approx(3.002)
        raised = [a for a in record.alarms if a.event == AlarmEvent.RAISED]
        assert row['alarms'] == sum(a['count'] for a in row['alarm_list']) == len(raised) > 0
        first = row['alarm_list'][0]
        assert (first['sensor'], first['size']) == (raised[0].sensor, raised[0].size)
        assert first['onset'] == record.seconds(raised[0].onset)
    run = runs['bias'][1]
    assert rows['b/bias']['inconsistent_time'] == pytest.approx(run.inconsistent.sum() * 0.002)


def test_given_a_foreign_bag_when_replayed_then_it_is_the_same_arm(done):
    mine, other = done[1]['b/bias'], done[1]['foreign']
    for name in ('alarms_1', 'alarms_2', 'score_1', 'fault_rms_2', 'time_error_1', 'alarm_list'):
        assert other[name] == mine[name], name
    assert (other['has_truth'], other['false_alarms'], other['topic']) == (False, None, '/js')


def test_given_bags_that_cannot_be_used_when_replayed_then_each_row_says_why(done):
    _, rows = done
    assert set(rows) == {*GOOD, *BAD}
    assert [name for name in sorted(rows) if rows[name]['error']] == sorted(BAD)
    for name, told in (
        ('b/junk.mcap', 'damaged'),
        ('b/lonely', 'no metadata.yaml with files'),
        ('deaf', 'has no topic'),
        ('strange', "'joint1'"),
    ):
        assert told in rows[name]['error'], rows[name]['error']
        assert rows[name]['alarms'] is None


def test_given_a_truth_without_scenario_when_replayed_then_faults_are_what_it_shows(
    archive, settings, tmp_path, runs
):
    for name in ('bias', 'dropout'):
        shutil.copytree(archive / 'b' / name, tmp_path / name)
        (tmp_path / name / 'scenario.yaml').unlink()
        row, expected = settings.row(str(tmp_path / name)), figures(*runs[name])
        for figure in ('sensor', 'detected', 'isolated', 'false_alarms', 'wrong_alarms'):
            assert row[figure] == expected[figure], (name, figure)
        assert row['detection_delay'] == pytest.approx(expected['detection_delay'])
        assert row['kind'] == 'unknown'


def test_given_a_long_bag_when_replayed_then_its_truth_is_left_out(archive, settings, monkeypatch):
    monkeypatch.setattr('lpv.campaign.execution.bag_figures.MOST_SAMPLES', 1000)
    row = settings.row('b/bias')
    assert (row['alarms'], row['error']) == (1, '') and 'false_alarms' not in row
    assert 'too long' in row['warnings']


def test_given_an_archive_of_a_serial_arm_when_replayed_then_its_rows_name_all_joints(tmp_path):
    plan = plan_run(resolve(UR10, 's', '.'), 2)
    write_run_bag(plan, plan.simulate(), tmp_path / 'bags' / 'one')
    out = tmp_path / 'out'
    line = ['fleet', str(tmp_path / 'bags'), '--arm', 'ur10', '--out', str(out), '--workers', '0']
    assert main(line) == 0
    (row,) = rows_of(out, 'bags')
    assert row['isolated'] and row['kind'] == 'bias' and row['score_6'] is not None
    assert re.search('UR|ur10', (out / 'report.html').read_text())


def test_given_results_when_called_again_then_only_new_changed_and_failed_bags_are_replayed(
    archive, gains, tmp_path, monkeypatch, capsys
):
    root, out = tmp_path / 'root', tmp_path / 'root' / 'out'
    shutil.copytree(archive / 'b', root / 'b')
    shutil.copytree(archive / 'foreign', root / 'foreign')
    assert main(fleet(root, out, gains)) == 3
    seen, true = [], Archive.row
    monkeypatch.setattr(Archive, 'row', lambda self, bag: seen.append(bag) or true(self, bag))
    os.utime(next((root / 'b' / 'bias').glob('*.mcap')), ns=(1, 1))
    shutil.rmtree(root / 'b' / 'dropout')
    shutil.copytree(archive / 'a' / 'healthy', root / 'new')
    assert main(fleet(root, out, gains)) == 3
    assert '1 of 5 are here already' in capsys.readouterr().out
    assert seen == ['b/bias', 'b/junk.mcap', 'b/lonely', 'new']
    after = [row['bag'] for row in rows_of(out, 'bags')]
    assert after == ['b/bias', 'b/junk.mcap', 'b/lonely', 'foreign', 'new']
    for name in ('b/junk.mcap', 'b/lonely'):
        path = root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert main(fleet(root, out, gains)) == 0


@pytest.mark.parametrize(
    ('arguments', 'told'),
    [
        (['{tmp}/nowhere', '--arm', 'paper'], 'is not a folder'),
        (['{tmp}', '--arm', 'paper'], 'holds no rosbag2 bag'),
        (['{bags}'], '--arm'),
        (['{bags}', '--arm', 'nobody'], 'nobody'),
        (['{bags}', '--arm', 'real_arm', '--gains', '{gains}'], 'another arm'),
        (['{bags}', '--arm', 'ur10', '--gains', '{gains}'], 'gains'),
        (['{bags}', '--arm', 'paper', '--gains', '{gains}', '--from', '0.5', '--out', '{done}'],
         'another campaign'),
    ],
)  # fmt: skip
def test_given_what_makes_no_sense_when_called_then_one_line_says_so(
    archive, gains, done, tmp_path, refused, arguments, told
):
    places = {'tmp': tmp_path, 'bags': archive, 'gains': gains, 'done': done[0]}
    line = ['--out', str(tmp_path / 'out'), *(a.format(**places) for a in arguments)]
    assert refused(told, 'fleet', *line, '--workers', 0)


def test_given_an_archive_when_reported_then_figures_count_what_the_rows_say(done):
    out, rows = done
    numbers = json.loads((out / 'report.json').read_text())
    assert (numbers['head']['count'], numbers['head']['failed']) == (4, 4)
    detected = numbers['overall']['detected']
    assert (detected['hits'], detected['cases']) == (2, 2)
    alarms = {rate['name']: rate['events'] for rate in numbers['alarms']}
    assert alarms['alarms of all sensors'] == sum(rows[name]['alarms'] for name in GOOD)
    assert {row['bag'] for row in numbers['bags']} == set(GOOD)
    assert numbers['bags'][-1]['bag'] == 'a/healthy'
    page = (out / 'report.html').read_text()
    assert all(name in page for name in (*GOOD, *BAD)) and 'src="http' not in page


def test_given_alarms_when_listed_then_those_of_one_sensor_and_kind_are_one_line():
    raised, updated, cleared = AlarmEvent.RAISED, AlarmEvent.UPDATED, AlarmEvent.CLEARED
    events = [
        Alarm(event, 0, sensor, onset * 10**9, (onset + 1) * 10**9, 0.1, 0.01, kind, 1.0)
        for event, sensor, kind, onset in (
            (raised, 'one', 'unclassified', 1),
            (updated, 'one', 'drift', 1),
            (cleared, 'one', 'drift', 1),
            (raised, 'one', 'drift', 5),
            (raised, 'two', 'drift', 6),
        )
    ]
    rows = alarm_rows(events, 0)
    assert [(row['sensor'], row['kind'], row['count'], row['onset']) for row in rows] == [
        ('one', 'drift', 2, 1.0),
        ('two', 'drift', 1, 6.0),
    ]
