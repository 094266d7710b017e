"""Runs of a campaign as bags: the signals of the run, its answers, and files to repeat it."""

import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaign_files import command, spec, written

from lpv.bag.run.record import load_run
from lpv.campaign.execution.run_to_bag import (
    START,
    check_answers,
    differences,
    stamps_of,
    write_run_bag,
)
from lpv.campaign.execution.runs import plan_run
from lpv.campaign.plan.campaign import resolve
from lpv.cli.main import main
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import LpvError
from lpv.core.uio.certificate.gains import load_gains

pytestmark = pytest.mark.slow

FACTORS = """
path: random
fault.kind: [bias, dropout, spike]
fault.sensor: both
fault.size: {bias: 0.3, spike: 0.4}
fault.rate: {spike: 20.0}
fault.onset: {low: 0.8, high: 1.0}
fault.duration: 0.7
mass_2: {low: 0.97, high: 1.03}
command_delay: 2
sample_loss: 0.05
diagnosis.clear_dwell: 0.2
"""
SPEC = spec(FACTORS, 3, seed=5, duration=2.5)


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    """Results folder of the campaign."""
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


def test_given_a_run_when_written_as_a_bag_then_its_signals_are_there_without_the_lost_samples(
    done,
):
    _, run, bag = done
    record, kept = load_run(bag), ~run.lost
    assert 20 < run.lost.sum() < 150
    stamps = stamps_of(run)
    np.testing.assert_array_equal(record.stamps['joint_states'], stamps[kept])
    np.testing.assert_array_equal(record.stamps['ground_truth'], stamps)
    effort = np.vstack([[0.0, 0.0], run.torque[:-1]])
    answered = kept & ~run.safe_stop
    for stream, field, expected in (
        ('joint_states', 'position', run.measured[kept]),
        ('joint_states', 'velocity', run.measured_velocity[kept]),
        ('joint_states', 'effort', effort[kept]),
        ('ground_truth', 'position', run.position),
        ('ground_truth', 'velocity', run.velocity),
        ('ground_truth', 'fault', run.fault),
        ('ground_truth', 'torque', effort),
        ('ground_truth', 'disturbance', run.disturbance),
        ('state_estimate', 'compensated_position', run.compensated[kept]),
        ('torque_command', 'safe_stop', run.safe_stop[kept]),
        ('reference', 'position', run.reference[answered]),
    ):
        np.testing.assert_array_equal(record.get(stream, field), expected, f'{stream} {field}')
    np.testing.assert_array_equal(record.stamps['reference'], stamps[answered])
    assert [a.kind for a in record.alarms] == [a.kind for a in run.alarms] != []
    assert record.counts['/diagnostics'] >= 2
    # A command acts so many samples later, within limits.
    torque = record.get('torque_command', 'torque')
    assert record.seconds(record.stamps['torque_command'][-1]) == pytest.approx(2.5, abs=0.05)
    row = int(np.flatnonzero(answered & ~run.braked)[300])
    np.testing.assert_array_equal(
        torque[np.searchsorted(stamps[kept], stamps[row])], run.torque[row + 2]
    )
    reference = record.get('reference', 'position'), record.get('reference', 'velocity')
    rate = np.gradient(reference[0], (record.stamps['reference'] - START) / 1e9, axis=0)
    np.testing.assert_allclose(rate[50:-50], reference[1][50:-50], atol=5e-3)


def test_given_the_bag_of_a_run_when_replayed_with_its_files_then_every_bit_is_the_same(
    done, tmp_path, capsys
):
    plan, _, bag = done
    assert load_arm(bag / 'arm.yaml') == plan.arm
    assert load_scenario(bag / 'scenario.yaml') == plan.scenario
    assert load_gains(bag / 'gains.yaml').certificate == plan.gains.certificate
    files = ['--arm', str(bag / 'arm.yaml')]
    again = tmp_path / 'again'
    others = ['--gains', str(bag / 'gains.yaml'), '--parameters', str(bag / 'parameters.yaml')]
    assert main(['replay', str(bag), *files, *others, '--out', str(again)]) == 0
    assert main(['compare', str(bag), str(again), *files, '--exact']) == 0
    report = ['--scenario', str(bag / 'scenario.yaml'), '--out', str(tmp_path / 'report')]
    assert main(['report', str(bag), *files, *report]) == 0
    assert (tmp_path / 'report' / 'report.html').stat().st_size > 10_000
    capsys.readouterr()


def test_given_a_replay_that_answers_otherwise_when_checked_then_the_signal_is_named(done):
    _, run, bag = done
    check_answers(run, bag)
    for name in ('estimate', 'threshold', 'fault_estimate'):
        values = getattr(run, name).copy()
        values[np.flatnonzero(~run.lost)[-1], 1] += 1e-15
        with pytest.raises(LpvError, match=f'another {name} '):
            check_answers(replace(run, **{name: values}), bag)
    with pytest.raises(LpvError, match='alarms'):
        check_answers(replace(run, alarms=run.alarms[:-1]), bag)
    with pytest.raises(LpvError, match='other samples'):
        check_answers(replace(run, lost=np.roll(run.lost, 1)), bag)


def test_given_results_when_a_run_is_asked_for_then_its_figures_are_those_and_the_bag_is_there(
    results, tmp_path, capsys, refused
):
    assert main(['campaign', str(results), '--run', '2', '--bag', str(tmp_path / 'bag')]) == 0
    text = capsys.readouterr().out
    assert 'detection_delay' in text
    assert 'lpv replay' in text
    assert load_run(tmp_path / 'bag').counts['/lpv/ground_truth'] == 1251
    assert refused('exists already', 'campaign', results, '--run', 2, '--bag', tmp_path / 'bag')
    assert sorted(p.name for p in tmp_path.iterdir()) == ['bag']


@pytest.mark.parametrize(
    ('arguments', 'told'),
    [
        (['{results}', '--run', '3', '--bag', 'x'], 'must lie within 0 and 2'),
        (['{results}', '--run', '-1', '--bag', 'x'], 'must lie within 0 and 2'),
        (['{results}', '--run', '1'], 'must be given together'),
        (['{results}', '--bag', 'x'], 'must be given together'),
        (['{results}', '--out', 'x'], 'goes with a campaign file'),
        (['{tmp}', '--run', '1', '--bag', 'x'], 'holds no results'),
        (['{tmp}'], 'holds no results'),
        (['{tmp}/none.yaml', '--out', '{tmp}/out'], 'none.yaml'),
        (['{tmp}/bad.yaml', '--out', '{tmp}/out'], 'bad.yaml'),
        (['{tmp}/other.yaml', '--out', '{results}'], 'another campaign'),
    ],
)
def test_given_what_makes_no_sense_when_called_then_one_line_says_so(
    results, tmp_path, refused, arguments, told
):
    (tmp_path / 'bad.yaml').write_text('name: [')
    written(tmp_path / 'other.yaml', {**SPEC, 'seed': 6})
    places = {'results': results, 'tmp': tmp_path}
    assert refused(told, 'campaign', *(word.format(**places) for word in arguments))
    assert not (tmp_path / 'out').exists()


def test_given_results_that_are_damaged_when_going_on_then_the_file_is_named(
    results, tmp_path, refused
):
    file, out = written(tmp_path / 'spec.yaml', SPEC), tmp_path / 'out'
    shutil.copytree(results, out)
    for name in ('chunks/00000000.parquet', 'campaign.json'):
        (out / name).write_bytes(b'{PAR1 nothing')
        assert refused(name.split('/')[-1], *command(file, out))


def test_given_results_that_are_not_what_comes_out_now_when_asked_then_the_figure_is_named(
    results, tmp_path, refused
):
    other = shutil.copytree(results, tmp_path / 'out')
    table = pq.read_table(results / 'runs.parquet')
    index = table.schema.get_field_index('angle_rms')
    wrong = table.set_column(index, 'angle_rms', pa.array([1.0] * len(table)))
    pq.write_table(wrong, other / 'chunks' / '00000000.parquet')
    told = 'another angle_rms now'
    assert refused(told, 'campaign', other, '--run', 0, '--bag', tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_given_figures_when_compared_then_last_bits_and_missing_ones_do_not_count():
    nan = float('nan')
    stored = {'a': 1.0, 'b': nan, 'd': 'x', 'e': True}
    assert differences(stored, {**stored, 'a': 1.0 + 1e-14, 'more': 1}) == []
    wrong = {'a': 1.1, 'b': 0.0, 'd': 'y', 'e': False}
    assert differences(stored, wrong) == list(wrong)
