"""What the report says of the arm's motion: a run that ran away is never called good."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from lpv.bag.run.node_reports import NodeReport
from lpv.bag.run.streams import RecordedAlarm, RunRecord
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv.report import history
from lpv.report.certificate import Certificate
from lpv.report.figures import STATES, timeline
from lpv.report.history import INCONSISTENT, TOO_FAST, episodes, phases
from lpv.report.load import analyse
from lpv.report.run import content
from lpv.report.table import PAPER, Row, is_paper_arm, make_table, print_table

STEP = 2_000_000
COUNT = 500


def run(rates=None, **streams):
    """A second of an arm at rest; rates [rad/s] may be given by row."""
    stamps = STEP * np.arange(COUNT)
    velocity = np.zeros((COUNT, 2))
    for row, rate in (rates or {}).items():
        velocity[row] = rate
    zeros = np.zeros((COUNT, 2))
    record = RunRecord(sensor_names=('one', 'two'))
    record.streams['joint_states'] = {'position': zeros, 'velocity': velocity, 'effort': zeros}
    record.streams.update(streams)
    record.stamps = {name: stamps for name in record.streams}
    return record


def page(record, arm, reports=()):
    return content(analyse(record, arm, dict(reports), Certificate(problem='no gains')))


def tile(values, name):
    return next(t for t in values['tiles'] if t.name == name)


def test_given_a_slow_arm_when_reported_then_its_fastest_joint_is_told(paper_arm):
    values = page(run({100: (1.5, -3.0)}), paper_arm)
    assert not values['ran_away'] and 'exceeded' not in values['verdict']
    assert tile(values, 'fastest joint')[1:] == ('3 rad/s', 'limit 20, joint2, measured', '')


def test_given_an_arm_above_its_limit_when_reported_then_the_verdict_begins_with_it(paper_arm):
    fast = {k: (25.0, 0.0) for k in range(100, 200)}
    values = page(run(fast), paper_arm)
    assert values['verdict'].startswith('The arm exceeded its speed limit for 0.200 s (joint1: 25')
    assert tile(values, 'fastest joint').look == 'bad'
    assert [(p.what, p.start, p.end) for p in values['phases']] == [(TOO_FAST, 0.2, 0.4)]


def test_given_the_truth_when_it_is_faster_than_measured_then_the_truth_counts(paper_arm):
    truth = {'position': np.zeros((COUNT, 2)), 'velocity': np.full((COUNT, 2), 30.0)}
    values = page(run(ground_truth={**truth, 'fault': np.zeros((COUNT, 2))}), paper_arm)
    assert values['ran_away'] and '30 rad/s true' in values['verdict']


@pytest.mark.parametrize(('rate', 'away'), [(np.inf, True), (np.nan, False)])
def test_given_rates_that_are_no_numbers_when_reported_then_infinite_ones_are_too_fast(
    rate, away, paper_arm
):
    assert page(run({100: (rate, 0.0)}), paper_arm)['ran_away'] is away


def test_given_commands_that_stay_away_when_reported_then_the_silence_is_told(paper_arm):
    record = run(torque_command={'torque': np.zeros((COUNT, 2)), 'safe_stop': np.zeros(COUNT)})
    kept = np.r_[0:100, 200:400]
    record.stamps['torque_command'] = record.stamps['torque_command'][kept]
    record.streams['torque_command'] = {
        name: values[kept] for name, values in record.streams['torque_command'].items()
    }
    found = [(p.what, p.start, p.end) for p in phases(record, paper_arm, {})]
    assert found == [(history.NO_COMMAND, 0.198, 0.4), (history.NO_COMMAND, 0.798, 0.998)]


def alarm(time, event=AlarmEvent.UPDATED, kind=INCONSISTENT, size=0.1, sensor=0):
    stamp = round(time * 1e9)
    return RecordedAlarm(event, sensor, 'one', stamp, stamp, size, 0.05, kind, 1.0, stamp)


def test_given_an_inconsistent_alarm_when_reported_then_the_phases_have_it(paper_arm):
    record = run()
    record.alarms = [alarm(0.2, AlarmEvent.RAISED), alarm(0.3), alarm(0.4, kind='drift')]
    values = page(record, paper_arm)
    assert '1 inconsistent phase.' in values['verdict']
    assert [(p.start, p.end) for p in values['phases']] == [(0.2, 0.4)]


def test_given_inconsistent_alarms_of_both_sensors_when_they_overlap_then_they_are_one_phase(
    paper_arm,
):
    record = run()
    record.alarms = [
        alarm(0.2, AlarmEvent.RAISED),
        alarm(0.3, AlarmEvent.RAISED, sensor=1),
        alarm(0.4, AlarmEvent.CLEARED),
    ]
    (phase,) = phases(record, paper_arm, {})
    assert (phase.start, phase.end) == (0.2, record.time[-1])


def test_given_updates_when_listed_then_kind_and_size_are_of_the_same_event():
    record = run()
    record.alarms = [
        alarm(0.2, AlarmEvent.RAISED, 'unclassified', 0.1),
        alarm(0.3, kind='bias', size=0.3),
        alarm(0.5, AlarmEvent.CLEARED, 'bias', 0.0),
    ]
    (episode,) = episodes(record)
    assert (episode.kind, episode.size, episode.cleared) == ('bias', 0.3, 0.5)


def test_given_an_alarm_that_lasts_when_reported_then_its_size_is_the_error_now_not_at_the_event(
    paper_arm,
):
    estimate = np.zeros((COUNT, 2))
    estimate[200:, 0] = np.linspace(0.3, 0.02, COUNT - 200)
    bound = np.full((COUNT, 2), 0.01)
    state = np.zeros((COUNT, 2))
    stream = {'estimate': estimate, 'bound': bound, 'threshold': 2.0 * bound, 'state': state}
    record = run(fault_estimate=stream)
    record.alarms = [alarm(0.4, AlarmEvent.RAISED, 'drift', 0.3)]
    (episode,) = episodes(record)
    assert (episode.size, episode.bound, episode.largest) == pytest.approx((0.02, 0.01, 0.3))
    assert (
        'error at the end of the run: one +0.020 rad (bound 0.010)'
        in page(record, paper_arm)['verdict']
    )


def test_given_the_states_of_a_sensor_when_drawn_then_bars_and_legend_have_the_same_colours(
    paper_arm,
):
    state = np.repeat([[int(s)] for s, _, _ in STATES], COUNT // len(STATES), axis=0)
    zeros = np.zeros((COUNT, 2))
    known = dict.fromkeys(('estimate', 'bound', 'threshold'), zeros)
    record = run(fault_estimate={**known, 'state': np.hstack([state, state[::-1]])})
    figure = timeline(analyse(record, paper_arm, {}, Certificate()))
    bars = {}
    for bar in figure.axes[0].collections:
        bars.setdefault(bar.get_label(), set()).add(bar.get_facecolor().tobytes())
    legend = figure.legends[0]
    shown = {
        text.get_text(): handle.get_facecolor()
        for text, handle in zip(legend.get_texts(), legend.legend_handles)
    }
    assert len(shown) == len(STATES) == len({tuple(color) for color in shown.values()})
    for label, color in shown.items():
        assert {np.asarray([color]).tobytes()} == bars[label], label


def test_given_another_arm_when_tabulated_then_the_paper_has_no_column(paper_arm, real_arm):
    assert is_paper_arm(paper_arm) and is_paper_arm(replace(paper_arm, name='mine'))
    first, second = paper_arm.joints
    heavier = replace(first, link=replace(first.link, mass=10.5))
    other = replace(paper_arm, joints=(heavier, second))
    assert not is_paper_arm(other) and not is_paper_arm(real_arm)
    zeros = np.zeros((COUNT, 2))
    streams = {name: {'position': zeros, 'velocity': zeros} for name in ('state_estimate',)}
    record = run(ground_truth={'position': zeros, 'velocity': zeros, 'fault': zeros}, **streams)
    table = make_table(record, other)
    assert [row.paper for row in table] == [None] * 4
    assert [row.signal for row in table] == ['joint1', 'joint2'] * 2
    assert all(row.paper for row in make_table(record, paper_arm))


def test_given_a_terminal_of_80_columns_when_printed_then_nothing_is_cut_off(capsys):
    rows = [Row(name, 'estimate of the position', 'rad²', 2.6e-4, PAPER[name]) for name in PAPER]
    print_table(rows, Console(width=80))
    text = capsys.readouterr().out
    assert '…' not in text and text.count('0.006') == 2 and 'better by' in text


def test_given_what_drives_and_tracker_report_when_reported_then_stops_have_their_reasons(
    paper_arm,
):
    second = 1_000_000_000
    reports = {
        'drives': [
            NodeReport(0, 1, 'braked: no command yet'),
            NodeReport(second // 10, 0, 'driven'),
            NodeReport(second // 5, 2, 'braked: safe stop'),
            NodeReport(second // 2, 2, 'braked: a joint is faster than its velocity limit'),
            NodeReport(6 * second // 10, 2, 'braked: a joint is faster than its velocity limit'),
        ],
        'tracking': [NodeReport(second // 4, 2, 'safe stop: the observer is silent')],
    }
    stops = np.zeros(COUNT)
    stops[100:250] = 1.0
    record = run(torque_command={'torque': np.zeros((COUNT, 2)), 'safe_stop': stops})
    values = page(record, paper_arm, reports)
    assert [(p.what, p.start, p.end, p.note) for p in values['phases']] == [
        (history.BRAKED, 0.2, 0.5, 'safe stop'),
        (history.SAFE_STOP, 0.2, 0.5, 'the observer is silent'),
        (history.BRAKED, 0.5, 0.998, 'a joint is faster than its velocity limit'),
    ]
    assert 'the drives braked 2 times (safe stop, a joint is faster' in values['verdict']
