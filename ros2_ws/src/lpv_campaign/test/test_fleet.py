"""Archives of bags: what is found, what is measured, what is kept, what the fleet's figures say."""

import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from places import BRINGUP, ROOT
from rosbags.rosbag2 import StoragePlugin, Writer

import lpv_campaign.fleet.archive as fleet
from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.csv_import import import_csv, load_column_map
from lpv_bag.run.record import BagError, load_run
from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.execution.run_to_bag import stamps_of, write_run_bag
from lpv_campaign.execution.runs import plan_run
from lpv_campaign.fleet.archive import FleetSettings, settings_from_json, watch_bag, watch_fleet
from lpv_campaign.fleet.find import find_bags, unit_of
from lpv_campaign.fleet.statistics import fleet_statistics, rate, suspicion, trends
from lpv_campaign.fleet.store import SCHEMA, FleetFolder
from lpv_campaign.fleet.tally import STATES, alarm_rows
from lpv_campaign.plan.campaign import resolve
from lpv_cli.main import main
from lpv_core.certificate.gains import load_gains, save_gains
from lpv_core.decision.diagnosis import Alarm, AlarmEvent
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.support.errors import ConfigError

pytestmark = pytest.mark.slow

DATA = Path(os.environ.get('LPV_REAL_ARM_DATA') or ROOT.parent / 'shared' / 'data' / 'real_arm')
TYPESTORE = make_typestore()
JOINT_STATE = 'sensor_msgs/msg/JointState'
SPEC = {
    'name': 'fleet',
    'seed': 4,
    'duration': 3.0,
    'designs': ['gains.yaml'],
    'plan': {'method': 'factorial'},
    'factors': {
        'fault.kind': ['none', 'bias', 'dropout'],
        'fault.size': 0.3,
        'fault.onset': 1.2,
        'fault.duration': 0.8,
        'path': 'random',
    },
}
GOOD = ['a/healthy', 'b/bias', 'b/dropout', 'foreign']
BAD = ['b/junk.mcap', 'b/lonely', 'deaf', 'strange']


@pytest.fixture(scope='module')
def runs(paper_gains, tmp_path_factory):
    """Plans and runs by name."""
    folder = tmp_path_factory.mktemp('spec')
    save_gains(paper_gains, folder / 'gains.yaml')
    campaign = resolve(SPEC, 'fleet', folder)
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


@pytest.fixture(scope='module')
def archive(runs, tmp_path_factory):
    """An archive with good bags and bad ones."""
    root = tmp_path_factory.mktemp('archive')
    write_run_bag(*runs['healthy'], root / 'a' / 'healthy')
    for name in ('bias', 'dropout'):
        write_run_bag(*runs[name], root / 'b' / name)
    write_foreign(root / 'foreign', runs['bias'][1])
    (root / 'b' / 'junk.mcap').write_bytes(b'\x89MCAP0\r\n' + bytes(300))
    (root / 'b' / 'lonely').mkdir()
    (root / 'b' / 'lonely' / 'metadata.yaml').write_text(
        (root / 'a' / 'healthy' / 'metadata.yaml').read_text()
    )
    write_odd(
        root / 'deaf',
        '/chatter',
        'std_msgs/msg/String',
        TYPESTORE.types['std_msgs/msg/String']('hello'),
    )
    write_odd(
        root / 'strange',
        '/js',
        JOINT_STATE,
        BagMessages(TYPESTORE, '').joint_state(
            1, ('elbow', 'wrist'), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)
        ),
    )
    (root / '.hidden').mkdir()
    (root / '.hidden' / 'x.mcap').write_bytes(b'')
    (root / 'notes').mkdir()
    (root / 'notes' / 'metadata.yaml').write_text('colour: blue\n')
    return root


@pytest.fixture(scope='module')
def settings(paper_arm, runs):
    return FleetSettings(paper_arm, runs['bias'][0].gains)


def command(root, out, runs_folder=None, *more):
    gains = root / 'a' / 'healthy' / 'gains.yaml' if runs_folder is None else runs_folder
    return [
        'campaign',
        '--bags',
        str(root),
        '--arm',
        'paper',
        '--gains',
        str(gains),
        '--out',
        str(out),
        '--workers',
        '0',
        *more,
    ]


@pytest.fixture(scope='module')
def done(archive, tmp_path_factory):
    """Results folder of the archive, and its rows by bag."""
    out = tmp_path_factory.mktemp('done') / 'out'
    assert main(command(archive, out)) == 3
    rows = {row['bag']: row for row in pq.read_table(out / 'bags.parquet').to_pylist()}
    return out, rows


# ------------------------------------------------------------------ what is found


def test_given_an_archive_when_searched_then_bags_are_found_and_nothing_else(archive, tmp_path):
    assert [bag.name for bag in find_bags(archive)] == sorted(GOOD + BAD)
    assert [bag.name for bag in find_bags(archive, [archive / 'b'])] == sorted(
        ['a/healthy', 'foreign', 'deaf', 'strange']
    )
    assert unit_of(archive, 'b/bias') == 'b'
    assert unit_of(archive, 'foreign') == ''
    for name in (
        'cut/cut_0.mcap',
        'cut/cut_1.mcap',
        'loose/one.mcap',
        'loose/two.db3',
        'whole/whole.mcap',
        'old/old_0.db3',
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b'')
    assert [bag.name for bag in find_bags(tmp_path)] == [
        'cut',
        'loose/one.mcap',
        'loose/two.db3',
        'old/old_0.db3',
        'whole',
    ]
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


def test_given_a_bag_when_any_of_its_files_changes_then_its_fingerprint_does(archive, tmp_path):
    shutil.copytree(archive / 'a', tmp_path / 'a')
    (before,) = find_bags(tmp_path)
    assert find_bags(tmp_path) == [before]
    file = next((tmp_path / 'a' / 'healthy').glob('*.mcap'))
    os.utime(file, ns=(1, 1))
    assert find_bags(tmp_path)[0].fingerprint != before.fingerprint
    assert find_bags(tmp_path)[0].name == before.name


# ------------------------------------------------------------------ what is measured


def test_given_bags_of_runs_when_replayed_then_their_figures_are_those_of_the_campaign(done, runs):
    _, rows = done
    for bag, name in (('a/healthy', 'healthy'), ('b/bias', 'bias'), ('b/dropout', 'dropout')):
        expected, row = figures(*runs[name]), rows[bag]
        assert set(expected) <= set(row)
        for figure, value in expected.items():
            if isinstance(value, (float, list)):
                np.testing.assert_allclose(
                    row[figure], value, rtol=1e-9, atol=1e-12, err_msg=f'{bag} {figure}'
                )
            else:
                assert row[figure] == value, (bag, figure)
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
                assert row[f'time_{word}_{i}'] == pytest.approx(
                    interval[state[:, i - 1] == k].sum(), abs=1e-9
                ), (name, word, i)
            here = state[:, i - 1] <= 2
            mine = estimate[here, i - 1]
            assert row[f'fault_mean_{i}'] == pytest.approx(mine.mean())
            assert row[f'fault_rms_{i}'] == pytest.approx(np.sqrt(np.mean(mine**2)))
            assert row[f'fault_largest_{i}'] == np.abs(mine).max()
            assert row[f'threshold_mean_{i}'] == pytest.approx(threshold[here, i - 1].mean())
            used = state[:, i - 1] != 3
            assert row[f'score_{i}'] == (np.abs(estimate) / threshold)[used, i - 1].max()
            error = (
                record.get('joint_states', 'position') - record.aligned('reference', 'position')
            )[:, i - 1]
            assert row[f'reference_error_{i}'] == pytest.approx(np.sqrt(np.nanmean(error**2)))
        assert row['measurements'] == len(record.stamps['joint_states']) == 1501
        assert row['duration'] == 3.0
        assert row['observed'] == pytest.approx(3.002)
        raised = [a for a in record.alarms if a.event == AlarmEvent.RAISED]
        assert row['alarms'] == len(raised) > 0
        assert sum(a['count'] for a in row['alarm_list']) == len(raised)
        first = row['alarm_list'][0]
        assert (first['sensor'], first['size']) == (raised[0].sensor, raised[0].size)
        assert first['onset'] == record.seconds(raised[0].onset)
    kinds = {(a['sensor'], a['kind']) for a in rows['b/bias']['alarm_list']}
    assert kinds == {('link1_angle', 'bias')}
    run = runs['bias'][1]
    assert rows['b/bias']['inconsistent_time'] == pytest.approx(run.inconsistent.sum() * 0.002)


def test_given_a_foreign_bag_when_replayed_then_it_is_the_same_arm(done):
    _, rows = done
    mine, other = rows['b/bias'], rows['foreign']
    for name in (
        'alarms_1',
        'alarms_2',
        'score_1',
        'score_2',
        'fault_rms_2',
        'time_error_1',
        'inconsistent_time',
        'alarm_list',
        'observed',
    ):
        assert other[name] == mine[name], name
    assert (other['has_truth'], other['has_reference'], other['false_alarms']) == (
        False,
        False,
        None,
    )
    assert other['reference_error_1'] is None
    assert other['topic'] == '/js'


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
    shutil.copytree(archive / 'b', tmp_path / 'b')
    for name in ('bias', 'dropout'):
        (tmp_path / 'b' / name / 'scenario.yaml').unlink()
    for bag in find_bags(tmp_path):
        row = watch_bag(settings, str(tmp_path), bag)
        if bag.name in GOOD:
            expected = figures(*runs[bag.name[2:]])
            for name in ('sensor', 'detected', 'isolated', 'false_alarms', 'wrong_alarms'):
                assert row[name] == expected[name], (bag, name)
            assert row['detection_delay'] == pytest.approx(expected['detection_delay'])
            assert row['kind'] == 'unknown'


def test_given_lost_doubled_and_unusable_samples_when_replayed_then_they_are_counted(
    runs, settings, tmp_path
):
    run, messages = runs['healthy'][1], BagMessages(TYPESTORE, 'base')
    effort = np.vstack([np.zeros((1, 2)), run.torque[:-1]])
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        for k, stamp in enumerate(stamps_of(run).tolist()):
            if 200 <= k < 205:
                continue
            position = [np.nan, 0.0] if k == 300 else run.measured[k]
            names = ('elbow', 'joint2') if k == 400 else ('joint1', 'joint2')
            message = messages.joint_state(
                stamp, names, position, run.measured_velocity[k], effort[k]
            )
            for _ in range(2 if k == 500 else 1):
                writer.write('/joint_states', stamp, message)
    row = watch_bag(settings, str(tmp_path), find_bags(tmp_path)[0])
    assert row['error'] == ''
    assert (row['measurements'], row['rejected'], row['duplicates']) == (1497, 1, 1)
    assert row['late_steps'] >= 2
    assert row['observed'] == pytest.approx(3.002)


def test_given_a_bag_when_watched_then_nothing_is_written_and_answers_are_those_of_a_replay(
    archive, settings, tmp_path
):
    answers = []
    result = Replay(settings.monitor()).watch(
        archive / 'b' / 'dropout', lambda m, a, s: answers.append((a, s)), ['reference']
    )
    record = load_run(archive / 'b' / 'dropout')
    estimate = np.concatenate([np.array(a.fault.estimate[a.has_fault]) for a, _ in answers])
    np.testing.assert_array_equal(estimate, record.get('fault_estimate', 'estimate'))
    stamps = np.concatenate([s['reference'][0] for _, s in answers])
    np.testing.assert_array_equal(stamps, record.stamps['reference'])
    assert result.measurements == 1501
    assert sorted(p.name for p in tmp_path.iterdir()) == []
    with pytest.raises(BagError, match='holds no message'):
        Replay(settings.monitor(), start=100.0).watch(archive / 'b' / 'bias', lambda *_: None)


def test_given_a_long_bag_when_replayed_then_memory_does_not_grow_without_truth_and_has_an_end_with(
    archive, settings, monkeypatch
):
    kept = []
    true = fleet.TruthKeeper.row
    monkeypatch.setattr(
        fleet.TruthKeeper, 'row', lambda self, *a: kept.append(dict(self._parts)) or true(self, *a)
    )
    monkeypatch.setattr('lpv_campaign.fleet.truth.MOST_SAMPLES', 1000)
    bags = {bag.name: bag for bag in find_bags(archive)}
    for name in ('foreign', 'b/bias'):
        row = watch_bag(settings, str(archive), bags[name])
        assert (row['alarms'], row['error']) == (1, '')
        assert 'false_alarms' not in row
        assert kept.pop() == {}
    assert 'too long' in row['warnings']


def test_given_samples_one_by_one_or_many_when_taken_then_contradictions_are_said_alike(
    runs, paper_arm, settings
):
    run = runs['bias'][1]
    effort = np.vstack([np.zeros((1, 2)), run.torque[:-1]])
    push = np.where((run.time > 1.0) & (run.time < 1.5), 60.0, 0.0)
    effort[:, 0] += push  # a torque sensor that is wrong
    many = SensorMonitor('', paper_arm, settings.gains).take_many(
        stamps_of(run), run.measured, run.measured_velocity, effort
    )
    one, messages, found = (
        SensorMonitor('', paper_arm, settings.gains),
        BagMessages(TYPESTORE, ''),
        [],
    )
    for k, stamp in enumerate(stamps_of(run).tolist()):
        found.append(
            one.take(
                stamp,
                messages.joint_state(
                    stamp,
                    paper_arm.joint_names,
                    run.measured[k],
                    run.measured_velocity[k],
                    effort[k],
                ),
            ).inconsistent
        )
    assert many.inconsistent.tolist() == found
    assert 100 < sum(found) < 1200


# ------------------------------------------------------------------ what is kept


def test_given_results_when_called_again_then_only_new_changed_and_failed_bags_are_replayed(
    archive, tmp_path, monkeypatch, capsys
):
    root, out = tmp_path / 'root', tmp_path / 'root' / 'out'
    shutil.copytree(archive / 'b', root / 'b')
    shutil.copytree(archive / 'foreign', root / 'foreign')
    gains = archive / 'a' / 'healthy' / 'gains.yaml'
    assert main(command(root, out, gains)) == 3
    before = pq.read_table(out / 'bags.parquet').to_pylist()
    seen, true = [], fleet.watch_bag
    monkeypatch.setattr(
        fleet, 'watch_bag', lambda s, r, bag: seen.append(bag.name) or true(s, r, bag)
    )
    os.utime(next((root / 'b' / 'bias').glob('*.mcap')), ns=(1, 1))
    shutil.rmtree(root / 'b' / 'dropout')
    shutil.copytree(archive / 'a' / 'healthy', root / 'new')
    assert main(command(root, out, gains)) == 3
    assert '1 of 5 bags are replayed already' in capsys.readouterr().out
    assert seen == ['b/bias', 'b/junk.mcap', 'b/lonely', 'new']
    after = pq.read_table(out / 'bags.parquet')
    assert after['bag'].to_pylist() == ['b/bias', 'b/junk.mcap', 'b/lonely', 'foreign', 'new']
    assert after.schema.equals(SCHEMA)
    assert [r for r in before if r['bag'] == 'foreign'] == [
        r for r in after.to_pylist() if r['bag'] == 'foreign'
    ]
    for name in ('b/junk.mcap', 'b/lonely'):
        path = root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert main(command(root, out, gains)) == 0


def test_given_a_stop_in_the_middle_when_called_again_then_what_was_done_is_kept(
    archive, tmp_path, monkeypatch, capsys
):
    true, calls = fleet.watch_bag, []

    def stop(settings, root, bag):
        calls.append(bag.name)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return true(settings, root, bag)

    monkeypatch.setattr(fleet, 'watch_bag', stop)
    assert main(command(archive, tmp_path / 'out')) == 130
    assert main(command(archive, tmp_path / 'out')) == 3
    # Bags that failed are tried again.
    assert calls[4:] == [
        name for name in sorted(GOOD + BAD) if name not in calls[:3] or name in BAD
    ]
    assert set(calls[:3]) & set(GOOD)
    capsys.readouterr()


def test_given_two_processes_when_run_then_rows_are_those_of_one(archive, settings, done):
    rows = {
        row['bag']: row
        for part in watch_fleet(settings, archive, find_bags(archive), 2)
        for row in part
    }
    table = pa.Table.from_pylist([rows[name] for name in sorted(rows)], schema=SCHEMA)
    assert repr(table.to_pylist()) == repr([done[1][name] for name in sorted(done[1])])


def test_given_other_settings_when_the_folder_is_taken_then_it_is_refused(
    done, archive, paper_arm, settings, tmp_path, capsys
):
    out, _ = done
    assert main(command(archive, out, None, '--from', '0.5')) == 2
    assert 'another arm, gains or options' in capsys.readouterr().err
    (tmp_path / 'file').write_text('mine')
    assert main(command(archive, tmp_path)) == 2
    assert 'holds no results' in capsys.readouterr().err
    again = settings_from_json(settings.to_json())
    assert again.key == settings.key == settings_from_json(again.to_json()).key
    assert replace(settings, max_gap=0.2).key != settings.key
    broken = FleetFolder(tmp_path / 'broken')
    broken.begin(settings)
    broken.write_part(pa.table({'bag': ['x']}), 'x')
    (tmp_path / 'broken' / 'parts' / 'x.parquet').write_bytes(b'PAR1')
    with pytest.raises(ConfigError, match=r'x\.parquet'):
        broken.rows(find_bags(archive))


@pytest.mark.parametrize(
    ('arguments', 'told'),
    [
        (['--bags', '{tmp}/nowhere', '--arm', 'paper'], 'is not a folder'),
        (['--bags', '{tmp}', '--arm', 'paper'], 'holds no rosbag2 bag'),
        (['--bags', '{bags}'], '--arm'),
        (['--bags', '{bags}', '--arm', 'nobody'], 'nobody'),
        (['spec.yaml', '--bags', '{bags}'], 'goes without a campaign file'),
        (['--bags', '{bags}', '--run', '1'], 'goes without'),
        (
            ['--bags', '{bags}', '--arm', 'real_arm', '--gains', '{bags}/a/healthy/gains.yaml'],
            'another arm',
        ),
        (
            ['--bags', '{bags}', '--arm', 'paper', '--gains', '{bags}/a/healthy/scenario.yaml'],
            'gains',
        ),
    ],
)
def test_given_what_makes_no_sense_when_called_then_one_line_says_so(
    archive, tmp_path, capsys, arguments, told
):
    line = [a.format(tmp=tmp_path, bags=archive) for a in arguments]
    assert main(['campaign', *line, '--out', str(tmp_path / 'out'), '--workers', '0']) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count('\n') == 1


# ------------------------------------------------------------------ what the fleet's figures say


def test_given_counts_when_rates_are_asked_for_then_intervals_are_the_exact_ones():
    none, three = rate(0, 2.0), rate(3, 1.0)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(-np.log(0.025) / 2.0)
    # Garwood's table.
    assert (three.low, three.high) == (
        pytest.approx(0.6187, abs=1e-4),
        pytest.approx(8.7673, abs=1e-4),
    )
    assert rate(0, 0.0).high == np.inf
    counts = np.random.default_rng(0).poisson(4.0, 4000)
    inside = {n: rate(int(n), 1.0).low <= 4.0 <= rate(int(n), 1.0).high for n in set(counts)}
    assert 0.95 <= np.mean([inside[n] for n in counts]) < 0.99


def made(bag, unit, day, mean=0.0, **other):
    row = dict.fromkeys(SCHEMA.names)
    row.update(
        bag=bag,
        unit=unit,
        error='',
        warnings='',
        start=int((1e4 + day) * 86400e9),
        duration=3600.0,
        observed=3600.0,
        measurements=10,
        rejected=0,
        duplicates=0,
        out_of_order=0,
        not_finite=0,
        implausible=0,
        alarms=0,
        alarms_1=0,
        alarms_2=0,
        alarm_list=[],
        inconsistent_time=0.0,
        score_1=0.5,
        score_2=0.4,
        fault_mean_1=mean,
        fault_mean_2=0.0,
        fault_rms_1=abs(mean),
        fault_rms_2=0.0,
        threshold_mean_1=0.05,
        threshold_mean_2=0.05,
        **other,
    )
    return row


def test_given_an_encoder_that_ages_when_trends_are_asked_for_then_its_arm_is_the_first():
    rng, rows = np.random.default_rng(3), []
    for unit in range(8):
        for k in range(12):
            slope = 2e-4 if unit == 5 else 0.0
            rows.append(
                made(
                    f'{unit}/{k}',
                    f'arm{unit}',
                    7.0 * k,
                    slope * 7.0 * k + 0.002 * rng.standard_normal(),
                )
            )
    found = trends(rows)
    assert len(found) == 16
    assert [(t.unit, t.sensor) for t in found if t.significant] == [('arm5', 0)]
    ageing = found[0]
    assert ageing.low < 2e-4 < ageing.high
    assert ageing.low > 1e-4
    assert ageing.days_left == pytest.approx((0.05 - 77 * 2e-4) / 2e-4, rel=0.25)
    assert len(ageing.days) == 12
    # Without dates there is no order, and few bags say nothing.
    assert trends([made(str(k), 'a', 0.0, k) for k in range(9)]) == []
    assert trends([made(str(k), 'a', k, k) for k in range(4)]) == []


def test_given_rows_when_ranked_then_alarms_come_first_then_contradictions_then_sizes():
    rows = [
        made('calm', '', 0),
        made('near', '', 0) | {'score_2': 0.9},
        made('odd', '', 0) | {'inconsistent_time': 100.0},
        made('alarmed', '', 0) | {'alarms': 1, 'alarms_1': 1, 'score_1': 0.2},
    ]
    assert [row['bag'] for row in sorted(rows, key=suspicion, reverse=True)] == [
        'alarmed',
        'odd',
        'near',
        'calm',
    ]
    table = pa.Table.from_pylist([*rows, made('broken', '', 0) | {'error': 'it is'}], schema=SCHEMA)
    found = fleet_statistics(table, ('one', 'two'))
    assert (found.bags, found.failed, found.hours) == (5, 1, 4.0)
    assert (found.alarms['one'].count, found.alarms['two'].count) == (1, 0)
    assert (found.false_alarms.hours, found.false_alarms.count) == (0.0, 0)
    assert fleet_statistics(table, ('one', 'two'), healthy=True).false_alarms == rate(1, 4.0)
    assert [row['bag'] for row in found.failures] == ['broken']


def test_given_an_archive_when_done_then_figures_count_what_the_rows_say(done, paper_arm):
    out, rows = done
    found = fleet_statistics(pq.read_table(out / 'bags.parquet'), paper_arm.sensor_names)
    assert (found.bags, found.failed) == (8, 4)
    assert (found.detected, found.faulty) == (2, 2)
    assert found.false_alarms.count == sum(rows[n]['false_alarms'] for n in GOOD[:3])
    assert found.false_alarms.hours == pytest.approx(3 * 3.002 / 3600)
    assert found.kinds['link1_angle', 'bias'] == 2
    assert found.ranking[-1]['bag'] == 'a/healthy'


def test_given_alarms_when_listed_then_those_of_one_sensor_and_kind_are_one_line():
    def alarm(event, sensor, kind, onset, size=0.1):
        return Alarm(
            event, 0, sensor, int(onset * 1e9), int(onset * 1e9) + 5, size, 0.05, kind, 1.0
        )

    raised, updated, cleared = AlarmEvent.RAISED, AlarmEvent.UPDATED, AlarmEvent.CLEARED
    found = alarm_rows(
        [
            alarm(raised, 'a', 'unclassified', 2.0, 0.3),
            alarm(raised, 'b', 'spike', 2.5),
            alarm(updated, 'a', 'bias', 2.0),
            alarm(cleared, 'a', 'bias', 2.0),
            alarm(raised, 'a', 'bias', 4.0, 0.7),
        ],
        int(1e9),
    )
    assert [(a['sensor'], a['kind'], a['count'], a['onset'], a['size']) for a in found] == [
        ('a', 'bias', 2, 1.0, 0.3),
        ('b', 'spike', 1, 1.5, 0.1),
    ]


def test_given_results_when_reported_then_the_page_needs_nothing_else_and_names_every_bag(
    archive, tmp_path, capsys
):
    root = tmp_path / 'root'
    for k in range(6):
        shutil.copytree(archive / 'a' / 'healthy', root / 'u' / f'<b>{k}')
    (root / 'bad.mcap').write_bytes(b'nothing')
    out = tmp_path / 'out'
    assert main(command(root, out, archive / 'a' / 'healthy' / 'gains.yaml', '--healthy')) == 3
    text, html = capsys.readouterr().out, (out / 'report.html').read_text()
    assert 'failed  bad.mcap: ' in text
    assert 'could not be read' in html
    for k in range(6):
        assert f'&lt;b&gt;{k}' in html
    assert '<b>0' not in html
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert 'nan' not in html.lower().replace('finance', '')
    assert 'No arm has bags enough' in html  # all start at the same time


def test_given_trends_when_reported_then_they_are_drawn(paper_arm, tmp_path):
    from lpv_campaign.fleet.report import write_fleet_report

    rows = [made(f'{u}/{k}', f'arm{u}', k, 0.001 * k * u) for u in range(3) for k in range(8)]
    table = pa.Table.from_pylist(rows, schema=SCHEMA)
    statistics = fleet_statistics(table, paper_arm.sensor_names)
    write_fleet_report(tmp_path / 'x.html', statistics, paper_arm, 'A fleet', 'bags.parquet')
    html = (tmp_path / 'x.html').read_text()
    assert 'data:image/png;base64,' in html
    assert html.count('class="bad"><td>arm') == 2
    assert '1997-05-19' in html


@pytest.mark.skipif(
    not (DATA / 'run_143601.csv').is_file(),
    reason='the recordings are not part of the repository; LPV_REAL_ARM_DATA may point to them',
)
def test_given_recordings_of_a_healthy_arm_when_replayed_then_there_is_no_alarm(tmp_path, capsys):
    columns = load_column_map(BRINGUP / 'columns' / 'real_arm.yaml')
    for name in ('run_143601', 'run_144115'):
        import_csv(DATA / f'{name}.csv', columns, tmp_path / 'bags' / name)
    assert (
        main(
            [
                'campaign',
                '--bags',
                str(tmp_path / 'bags'),
                '--gains',
                str(BRINGUP / 'gains' / 'real_arm.yaml'),
                '--arm',
                'real_arm',
                '--healthy',
                '--workers',
                '0',
                '--out',
                str(tmp_path / 'out'),
            ]
        )
        == 0
    )
    rows = pq.read_table(tmp_path / 'out' / 'bags.parquet').to_pylist()
    assert [(r['bag'], r['alarms'], r['measurements']) for r in rows] == [
        ('run_143601', 0, 5000),
        ('run_144115', 0, 4998),
    ]
    for row in rows:
        assert max(row['score_1'], row['score_2']) < 0.5
        assert row['time_ok_1'] + row['time_not_diagnosable_1'] == pytest.approx(row['observed'])
    assert re.search(r'false alarms.* 0 .* 0 to 664', capsys.readouterr().out)
    assert load_gains(BRINGUP / 'gains' / 'real_arm.yaml').arm_name == 'real_arm'
