import json
import os
import re
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from bag_messages import CHATTER, JOINT_STATE, STRING, TYPESTORE, cdr, text
from bags import write_bag, write_by_rosbags
from campaign_files import GAINS, UR10, command, rows_of, spec, written
from fault_injection import with_joints

from lpv import Alarm, AlarmEvent, ConfigError, load_arm, load_gains, load_scenario
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.run.record import load_run
from lpv.campaign.execution import archive as archives
from lpv.campaign.execution import run_metrics
from lpv.campaign.execution.archive import Archive, archive_text, find_bags, unit_of
from lpv.campaign.execution.run_to_bag import (
    START,
    differences,
    stamps_of,
    write_run_bag,
    write_signals,
)
from lpv.campaign.execution.runs import plan_run
from lpv.campaign.plan.campaign import resolve
from lpv.cli.main import main

pytestmark = pytest.mark.slow

FACTORS = """{path: random, fault.kind: [bias, dropout, spike], fault.sensor: both,
fault.size: {bias: 0.3, spike: 0.4}, fault.rate: {spike: 20.0}, fault.onset: {low: 0.8, high: 1.0},
fault.duration: 0.7, mass_2: {low: 0.97, high: 1.03}, command_delay: 2, sample_loss: 0.05,
diagnosis.clear_dwell: 0.2}"""
SPEC = spec(FACTORS, 3, seed=5, duration=2.5)
FAULT = 'fault.kind: [none, bias, dropout], fault.size: 0.3, fault.onset: 1.2, fault.duration: 0.8'
FLEET = spec(f'{{{FAULT}, path: random}}', seed=4, plan={'method': 'factorial'})
GOOD = ['a/healthy', 'b/bias', 'b/dropout', 'foreign']
BAD = {'b/junk.mcap': 'damaged', 'b/lonely': 'no metadata.yaml with files',
       'deaf': 'has no topic', 'strange': 'measurements can be used ('}  # fmt: skip
"""Bags that cannot be used, and what is said of each."""


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp('campaign')
    assert main(command(written(folder / 'spec.yaml', SPEC), folder / 'out')) == 0
    return folder / 'out'


@pytest.fixture(scope='module')
def done(tmp_path_factory):
    """Plan, run and bag of a run with lost samples and late commands."""
    plan = plan_run(resolve(SPEC, 'bags', '.'), 1)
    run, bag = plan.simulate(), tmp_path_factory.mktemp('run') / 'bag'
    write_run_bag(plan, run, bag)
    return plan, run, bag


def test_given_a_run_when_written_as_a_bag_then_all_but_lost_samples_are_there(done):
    _, run, bag = done
    record, kept, stamps = load_run(bag), ~run.lost, stamps_of(run)
    assert 20 < run.lost.sum() < 150
    effort, answered = np.vstack([[0.0, 0.0], run.torque[:-1]]), kept & ~run.safe_stop
    samples = {'joint_states': kept, 'ground_truth': slice(None), 'reference': answered}
    for stream, used in samples.items():
        np.testing.assert_array_equal(record.stamps[stream], stamps[used])
    truth = {name: getattr(run, name) for name in ('position', 'velocity', 'fault', 'disturbance')}
    for stream, field, expected in (
        ('joint_states', 'position', run.measured[kept]),
        ('joint_states', 'velocity', run.measured_velocity[kept]),
        ('joint_states', 'effort', effort[kept]),
        *(('ground_truth', name, values) for name, values in {**truth, 'torque': effort}.items()),
        ('state_estimate', 'position', run.estimate[kept]),
        ('state_estimate', 'velocity', run.estimated_velocity[kept]),
        ('state_estimate', 'compensated_position', run.compensated[kept]),
        ('fault_estimate', 'estimate', run.fault_estimate[kept]),
        ('fault_estimate', 'threshold', run.threshold[kept]),
        ('fault_estimate', 'alarm', run.alarm[kept]),
        ('torque_command', 'safe_stop', run.safe_stop[kept]),
        ('reference', 'position', run.reference[answered]),
    ):
        np.testing.assert_array_equal(record.get(stream, field), expected, f'{stream} {field}')
    names = 'event', 'sensor', 'kind', 'size', 'bound'
    told, raised = ([[getattr(a, n) for n in names] for a in r.alarms] for r in (record, run))
    assert told == raised != []
    assert [a.onset for a in record.alarms] == [a.onset + START for a in run.alarms]
    assert [a.detected for a in record.alarms] == [a.detected + START for a in run.alarms]
    assert record.counts['/diagnostics'] >= 2
    # A command acts so many samples later, within limits.
    assert record.seconds(record.stamps['torque_command'][-1]) == pytest.approx(2.5, abs=0.05)
    row = int(np.flatnonzero(answered & ~run.braked)[300])
    torque = record.get('torque_command', 'torque')[np.searchsorted(stamps[kept], stamps[row])]
    np.testing.assert_array_equal(torque, run.torque[row + 2])
    position, velocity = (record.get('reference', name) for name in ('position', 'velocity'))
    rate = np.gradient(position, record.seconds(record.stamps['reference']), axis=0)
    np.testing.assert_allclose(rate[50:-50], velocity[50:-50], atol=5e-3)


def test_given_efforts_in_another_unit_when_written_as_a_bag_then_the_truth_has_torques(
    done, tmp_path
):
    plan, run, _ = done
    write_signals(with_joints(plan.arm, 0, torque_gain=2.0), run, tmp_path / 'bag')
    torque = load_run(tmp_path / 'bag').get('ground_truth', 'torque')
    np.testing.assert_array_equal(torque, run.effort * [2.0, 1.0])


def test_given_a_run_when_replayed_with_its_files_then_every_bit_is_same(done, tmp_path, call):
    plan, _, bag = done
    assert load_arm(bag / 'arm.yaml') == plan.arm
    assert load_scenario(bag / 'scenario.yaml') == plan.scenario
    assert load_gains(bag / 'gains.yaml').certificate == plan.gains.certificate
    names = 'arm', 'gains', 'parameters', 'scenario'
    arm, gains, parameters, scenario = ([f'--{name}', bag / f'{name}.yaml'] for name in names)
    again, page = tmp_path / 'again', tmp_path / 'report' / 'report.html'
    call('replay', bag, *arm, *gains, *parameters, '--out', again)
    call('compare', bag, again, *arm, '--exact')
    call('report', bag, *arm, *scenario, '--out', page.parent)
    assert page.stat().st_size > 10_000


def test_given_results_when_a_run_is_asked_for_then_its_bag_is(results, tmp_path, call, refused):
    line = ['campaign', results, '--run', 2, '--bag', tmp_path / 'a bag']
    said = call(*line).out
    assert 'detection_delay' in said and 'lpv replay' in said
    words = shlex.split(said.partition('\nreport  ')[2].splitlines()[0])
    assert words[:3] == ['lpv', 'report', str(tmp_path / 'a bag')]
    assert load_run(tmp_path / 'a bag').counts['/lpv/ground_truth'] == 1251
    assert refused('exists already', *line) and [p.name for p in tmp_path.iterdir()] == ['a bag']


def test_given_what_makes_no_sense_when_called_then_one_line_says_so(results, tmp_path, refused):
    (tmp_path / 'bad.yaml').write_text('name: [')
    written(tmp_path / 'other.yaml', {**SPEC, 'seed': 6})
    places = {'results': results, 'tmp': tmp_path}
    for arguments, told in (
        ('{results} --run 3 --bag x', 'must lie within 0 and 2'),
        ('{results} --run -1 --bag x', 'must lie within 0 and 2'),
        ('{results} --run 1', 'must be given together'),
        ('{results} --bag x', 'must be given together'),
        ('{results} --out x', 'goes with a campaign file'),
        ('{tmp} --run 1 --bag x', 'holds no results'),
        ('{tmp}', 'holds no results'),
        ('{tmp}/none.yaml --out {tmp}/out', 'none.yaml'),
        ('{tmp}/bad.yaml --out {tmp}/out', 'bad.yaml'),
        ('{tmp}/other.yaml --out {results}', 'another campaign'),
        ('{tmp}/other.yaml --out {tmp}/out --workers -1', '--workers'),
        ('{tmp}/other.yaml --out {tmp}/new --scheduler tcp://127.0.0.1:1', 'does not answer'),
        ('{tmp}/other.yaml --out {tmp}/new --scheduler nonsense://x', 'does not answer'),
    ):
        assert refused(told, 'campaign', *arguments.format(**places).split())
        assert not (tmp_path / 'out').exists()


def test_given_changed_or_damaged_results_when_used_then_they_are_named(results, tmp_path, refused):
    file, out = written(tmp_path / 'spec.yaml', SPEC), shutil.copytree(results, tmp_path / 'out')
    table, chunk = pq.read_table(results / 'runs.parquet'), out / 'chunks' / '00000000.parquet'
    index = table.schema.get_field_index('angle_rms')
    pq.write_table(table.set_column(index, 'angle_rms', pa.array([1.0] * len(table))), chunk)
    told, bag = 'another angle_rms now', tmp_path / 'bag'
    assert refused(told, 'campaign', out, '--run', 0, '--bag', bag) and not bag.exists()
    for damaged in (chunk, out / 'campaign.json'):
        damaged.write_bytes(b'{PAR1 nothing')
        assert refused(damaged.name, *command(file, out))


def test_given_results_of_another_version_then_none_are_added(results, tmp_path, call, refused):
    file, out = written(tmp_path / 'spec.yaml', SPEC), shutil.copytree(results, tmp_path / 'out')
    (out / 'chunks' / '00000000.parquet').unlink()
    begun = out / 'campaign.json'
    begun.write_text(json.dumps({**json.loads(begun.read_text()), 'software': 'an older one'}))
    assert refused('or this software changed', *command(file, out))
    shutil.copytree(results / 'chunks', out / 'chunks', dirs_exist_ok=True)
    call('campaign', out)
    assert json.loads((out / 'report.json').read_text())['head']['software'] == 'an older one'


def test_given_figures_when_compared_then_last_bits_and_missing_ones_do_not_count():
    stored = {'a': 1.0, 'b': float('nan'), 'd': 'x', 'e': True}
    assert differences(stored, {**stored, 'a': 1.0 + 1e-14, 'more': 1}) == []
    wrong = {'a': 1.1, 'b': 0.0, 'd': 'y', 'e': False}
    assert differences(stored, wrong) == list(wrong)


@pytest.fixture(scope='module')
def runs():
    plans = [plan_run(resolve(FLEET, 'fleet', '.'), number) for number in range(3)]
    return {n: (p, p.simulate()) for n, p in zip(('healthy', 'bias', 'dropout'), plans)}


def write_files(root, content):
    for name, data in content.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(data)


@pytest.fixture(scope='module')
def archive(runs, tmp_path_factory):
    root = tmp_path_factory.mktemp('archive')
    for bag in GOOD[:3]:
        write_run_bag(*runs[bag[2:]], root / bag)
    # A recording of somebody else in sqlite3: joints in another order, and one more.
    messages, entries, (_, run) = BagMessages(TYPESTORE, 'base'), [], runs['bias']
    for k, stamp in enumerate(stamps_of(run).tolist()):
        values = [[0.5, *a[k, ::-1]] for a in (run.measured, run.measured_velocity, run.effort)]
        message = messages.joint_state(stamp, ('gripper', 'joint2', 'joint1'), *values)
        entries.append(('/js', stamp, cdr(message)))
    write_by_rosbags(root / 'foreign', entries)
    others = {'.hidden/x.mcap': b'', 'notes/metadata.yaml': b'colour: blue\n'}
    others['b/junk.mcap'] = b'\x89MCAP0\r\n' + bytes(300)
    others['b/lonely/metadata.yaml'] = (root / 'a' / 'healthy' / 'metadata.yaml').read_bytes()
    write_files(root, others)
    write_bag(root / 'deaf', [(CHATTER, k, text('hello')) for k in range(1, 5)], {CHATTER: STRING})
    odd = messages.joint_state(1, ('elbow', 'wrist'), *np.zeros((3, 2)))
    write_bag(root / 'strange', [('/js', k, cdr(odd)) for k in range(1, 5)], {'/js': JOINT_STATE})
    return root


def fleet(root, out):
    line = 'fleet', root, '--arm', 'paper', '--gains', GAINS, '--out', out, '--workers', 0
    return [str(word) for word in line]


@pytest.fixture(scope='module')
def tried(archive, tmp_path_factory):
    """Results folder of the archive, and its rows by bag."""
    out = tmp_path_factory.mktemp('tried') / 'out'
    assert main(fleet(archive, out)) == 3
    return out, {row['bag']: row for row in rows_of(out, 'bags')}


def test_given_an_archive_when_searched_then_bags_and_whose_they_are_is_found(archive, tmp_path):
    def names(*arguments):
        return [name for (name,) in find_bags(*arguments).values()]

    assert names(archive) == sorted([*GOOD, *BAD])
    assert names(archive, [archive / 'b']) == ['a/healthy', 'deaf', 'foreign', 'strange']
    loose = ['cut/cut_0.mcap', 'cut/cut_1.mcap']
    loose += [f'loose/{name}' for name in ('of_ros1.bag', 'one.mcap', 'two.db3')]
    renamed = [f'renamed/{name}' for name in ('bag_0.mcap', 'bag_1.mcap', 'bag_2.mcap')]
    runs = [f'runs/{name}' for name in ('a_0.mcap', 'b_0.mcap', 'b_1.mcap')]
    days = [f'days/run_{day}.db3' for day in (1, 2)]
    files = *loose, 'whole/whole.mcap', 'old/old_0.db3', *renamed, *runs, *days
    write_files(tmp_path, dict.fromkeys(files, b''))
    own = ['cut', *days, *loose[2:], 'old/old_0.db3', 'renamed', *runs, 'whole']
    assert names(tmp_path) == own
    pytest.raises(ConfigError, find_bags, tmp_path / 'nowhere').match('not a folder')
    # The serial number or the folder tells whose a bag is.
    assert (unit_of(archive, 'b/bias'), unit_of(archive, 'foreign')) == ('b', '')
    data = yaml.safe_load((archive / 'a' / 'healthy' / 'metadata.yaml').read_text())
    data['rosbag2_bagfile_information']['custom_data'] = {'serial': 'SN-7'}
    for content, unit in ((yaml.safe_dump(data), 'SN-7'), ('{', 'week1')):
        write_files(tmp_path, {'week1/bag/metadata.yaml': content.encode()})
        assert unit_of(tmp_path, 'week1/bag') == unit


def test_given_an_archive_when_replayed_then_rows_have_figures_or_say_why(tried, runs):
    _, rows = tried
    for bag in GOOD[:3]:
        plan, run = runs[bag[2:]]
        expected = run_metrics.figures(plan.arm, plan.scenario, run)
        assert set(expected) <= set(rows[bag]) and differences(rows[bag], expected) == []
    mine, other = rows['b/bias'], rows['foreign']
    assert mine['detected'] and not rows['a/healthy']['detected']
    for name in ('alarms_1', 'alarms_2', 'score_1', 'fault_rms_2', 'time_error_1', 'alarm_list'):
        assert other[name] == mine[name], name
    assert (other['has_truth'], other['false_alarms'], other['topic']) == (False, None, '/js')
    assert set(rows) == {*GOOD, *BAD}
    assert {name for name, row in rows.items() if row['error']} == set(BAD)
    for name, told in BAD.items():
        assert told in rows[name]['error'] and rows[name]['alarms'] is None


def test_given_no_truth_while_it_is_measured_when_replayed_then_the_rest_has_figures(
    runs, tmp_path
):
    (plan, run), truth = runs['healthy'], 'lpv_msgs/msg/GroundTruth'
    messages, entries = BagMessages(TYPESTORE, 'base'), []
    for k, stamp in enumerate(stamps_of(run).tolist()):
        values = run.measured[k], run.measured_velocity[k], run.effort[k]
        entries.append(
            ('/js', stamp, cdr(messages.joint_state(stamp, plan.arm.joint_names, *values)))
        )
    names = 'position', 'velocity', 'torque', 'fault'
    early = messages.make(truth, 1, {**dict.fromkeys(names, [0.0, 0.0]), 'disturbance': 0.0})
    others = {'never': [], 'before': [('/lpv/ground_truth', 1, cdr(early, truth))]}
    work = Archive(archive_text(tmp_path, plan.arm, None))
    for name, more in others.items():
        write_bag(tmp_path / name, more + entries, {'/js': JOINT_STATE, '/lpv/ground_truth': truth})
        row = work.row(name)
        assert (row['error'], row['measurements'], row['alarms']) == ('', len(run.time), 0)
        assert 'detected' not in row


def test_given_answers_when_summed_up_then_they_are_those_recorded(tried, archive, runs, paper_arm):
    _, rows = tried
    for name in ('b/bias', 'b/dropout'):
        record, row = load_run(archive / name), rows[name]
        columns = (record.get('fault_estimate', f).T for f in ('state', 'estimate', 'threshold'))
        stamps = record.stamps['fault_estimate']
        interval = np.append(np.diff(stamps) / 1e9, paper_arm.sample_time)
        for i, (state, estimate, threshold) in enumerate(zip(*columns), 1):
            here, used = state <= 2, state != 3
            for k, word in enumerate(archives.STATES):
                expected = interval[state == k].sum()
                assert row[f'time_{word}_{i}'] == pytest.approx(expected, abs=1e-9), (name, word)
            assert row[f'fault_mean_{i}'] == pytest.approx(estimate[here].mean())
            assert row[f'fault_rms_{i}'] == pytest.approx(np.sqrt(np.mean(estimate[here] ** 2)))
            assert row[f'fault_largest_{i}'] == np.abs(estimate[here]).max()
            assert row[f'threshold_mean_{i}'] == pytest.approx(threshold[here].mean())
            assert row[f'score_{i}'] == (np.abs(estimate) / threshold)[used].max()
        assert row['measurements'] == len(record.stamps['joint_states']) == 1501
        assert (row['duration'], row['observed']) == (3.0, pytest.approx(3.002))
        raised = [a for a in record.alarms if a.event == AlarmEvent.RAISED]
        assert row['alarms'] == sum(a['count'] for a in row['alarm_list']) == len(raised) > 0
        first, known = row['alarm_list'][0], raised[0]
        expected = known.sensor, known.size, record.seconds(known.onset)
        assert (first['sensor'], first['size'], first['onset']) == expected
    run = runs['bias'][1]
    assert rows['b/bias']['inconsistent_time'] == pytest.approx(run.inconsistent.sum() * 0.002)


def test_given_no_scenario_or_a_long_bag_when_replayed_then_the_truth_is_shown_or_left_out(
    archive, runs, paper_arm, paper_gains, tmp_path, monkeypatch
):
    settings = Archive(archives.archive_text(archive, paper_arm, paper_gains))
    for name in ('bias', 'dropout'):
        shutil.copytree(archive / 'b' / name, tmp_path / name)
        (tmp_path / name / 'scenario.yaml').unlink()
        row, (plan, run) = settings.row(str(tmp_path / name)), runs[name]
        expected = run_metrics.figures(plan.arm, plan.scenario, run)
        for figure in ('sensor', 'detected', 'isolated', 'false_alarms', 'wrong_alarms'):
            assert row[figure] == expected[figure], (name, figure)
        assert row['detection_delay'] == pytest.approx(expected['detection_delay'])
        assert row['kind'] == 'unknown'
        # Whatever the arm file says of the rate.
        other = replace(paper_arm, sample_time=0.25 * paper_arm.sample_time)
        row = Archive(archives.archive_text(tmp_path, other, None)).row(name)
        assert (row['kind'], row['false_alarms']) == ('unknown', 0)
        for figure in ('early_time', 'healthy_time'):
            assert row[figure] == pytest.approx(expected[figure])
    monkeypatch.setattr('lpv.campaign.execution.archive.MOST_SAMPLES', 1000)
    row = settings.row('b/bias')
    assert (row['alarms'], row['error']) == (1, '') and 'false_alarms' not in row
    assert 'too long' in row['warnings']


def test_given_an_archive_of_a_serial_arm_when_replayed_then_rows_name_all_joints(tmp_path, call):
    plan, bags, out = plan_run(resolve(UR10, 's', '.'), 2), tmp_path / 'bags', tmp_path / 'out'
    write_run_bag(plan, plan.simulate(), bags / 'one')
    call('fleet', bags, '--arm', 'ur10', '--out', out, '--workers', 0)
    (row,) = rows_of(out, 'bags')
    assert row['isolated'] and row['kind'] == 'bias' and row['score_6'] is not None
    assert re.search('UR|ur10', (out / 'report.html').read_text())


def test_given_results_when_called_again_then_only_news_count(archive, tmp_path, monkeypatch, call):
    root, out = tmp_path / 'root', tmp_path / 'root' / 'out'
    shutil.copytree(archive / 'b', root / 'b')
    shutil.copytree(archive / 'foreign', root / 'foreign')
    call(*fleet(root, out), code=3)
    seen, true = [], Archive.row
    monkeypatch.setattr(Archive, 'row', lambda self, bag: seen.append(bag) or true(self, bag))
    os.utime(next((root / 'b' / 'bias').glob('*.mcap')), ns=(1, 1))
    shutil.rmtree(root / 'b' / 'dropout')
    shutil.copytree(archive / 'a' / 'healthy', root / 'new')
    assert '1 of 5 are here already' in call(*fleet(root, out), code=3).out
    assert seen == ['b/bias', 'b/junk.mcap', 'b/lonely', 'new']
    assert [row['bag'] for row in rows_of(out, 'bags')] == [*seen[:3], 'foreign', 'new']
    (root / 'b' / 'junk.mcap').unlink()
    shutil.rmtree(root / 'b' / 'lonely')
    call(*fleet(root, out))


def test_given_a_wrong_fleet_when_called_then_one_line_says_so(archive, tried, tmp_path, refused):
    places = {'tmp': tmp_path, 'bags': archive, 'gains': GAINS, 'done': tried[0]}
    for arguments, told in (
        ('{tmp}/nowhere --arm paper', 'is not a folder'),
        ('{tmp} --arm paper', 'holds no rosbag2 bag'),
        ('{bags}', '--arm'),
        ('{bags} --arm nobody', 'nobody'),
        ('{bags} --arm real_arm --gains {gains}', 'another arm'),
        ('{bags} --arm ur10 --gains {gains}', 'gains'),
        ('{bags} --arm paper --gains {gains} --from 0.5 --out {done}', 'another campaign'),
    ):
        words = f'--out {{tmp}}/out {arguments} --workers 0'.format(**places).split()
        assert refused(told, 'fleet', *words)


def test_given_an_archive_when_reported_then_figures_count_what_the_rows_say(tried):
    out, rows = tried
    numbers, page = json.loads((out / 'report.json').read_text()), (out / 'report.html').read_text()
    head, detected = numbers['head'], numbers['overall']['detected']
    assert (head['count'], head['failed'], detected['hits'], detected['cases']) == (4, 4, 2, 2)
    alarms = {rate['name']: rate['events'] for rate in numbers['alarms']}
    assert alarms['alarms of all sensors'] == sum(rows[name]['alarms'] for name in GOOD)
    *others, last = (row['bag'] for row in numbers['bags'])
    assert {*others, last} == set(GOOD) and last == 'a/healthy'
    assert all(name in page for name in (*GOOD, *BAD)) and 'src="http' not in page


def test_given_alarms_when_listed_then_those_of_one_sensor_and_kind_are_one_line():
    raised = AlarmEvent.RAISED
    first = [(raised, 'unclassified'), (AlarmEvent.UPDATED, 'drift'), (AlarmEvent.CLEARED, 'drift')]
    told = [(event, 'one', kind, 10**9) for event, kind in first]
    told += [(raised, 'one', 'drift', 5 * 10**9), (raised, 'two', 'drift', 6 * 10**9)]
    told.insert(1, (raised, 'one', 'rate_bias', 2 * 10**9))  # an alarm of its own
    alarms = [Alarm(e, 0, s, onset, onset + 9, 0.1, 0.01, k, 1.0) for e, s, k, onset in told]
    rows = archives.alarm_rows(alarms, 0)
    found = [(row['sensor'], row['kind'], row['count'], row['onset']) for row in rows]
    drifts = [('one', 'drift', 2, 1.0), ('two', 'drift', 1, 6.0)]
    assert sorted(found) == [drifts[0], ('one', 'rate_bias', 1, 2.0), drifts[1]]
