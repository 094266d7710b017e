import math
import re
from dataclasses import replace

import numpy as np
import pytest
from fault_injection import with_joints
from hypothesis import given
from hypothesis import strategies as st
from places import BRINGUP
from rich.console import Console
from runs import rows, text

from lpv import load_arm, load_scenario
from lpv.bag.run.record import NodeReport, RecordedAlarm, RunRecord
from lpv.cli.commands import compare
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, SensorState
from lpv.core.support.inequalities import Check
from lpv.report import certificate, figures, history
from lpv.report.comparison import compare_runs
from lpv.report.figures import STATES, timeline
from lpv.report.history import Phase, Run, episodes, listed, missed_faults, phases
from lpv.report.run import content, write
from lpv.report.style import thin
from lpv.report.table import PAPER, Row, is_paper_arm, make_table, print_table

MS, COUNT = 1_000_000, 500
TIME = 2.0 * np.arange(COUNT)
"""Stamps of the samples [ms]."""
CONFUSED = 'inconsistent, cause unknown: rates, torques and model contradict each other'
JOINTS = ('position', 'velocity', 'effort')
ESTIMATES = ('estimate', 'bound', 'threshold', 'state', 'alarm')
CLEARED, RIGHT = {'event': AlarmEvent.CLEARED}, {'sensor': 'right', 'sensor_index': 1}


def within(*spans):
    """Samples within some spans of time [ms]."""
    return np.any([(start <= TIME) & (end > TIME) for start, end in spans or [(0, 0)]], axis=0)


def stream(*fields, **others):
    """Rows of zeros, but for the others."""
    return {**{name: np.zeros((COUNT, 2)) for name in fields}, **others}


def run(rates=None, **streams):
    """A second of an arm at rest; rates [rad/s] may be given by row."""
    measured = stream(*JOINTS)
    for row, rate in (rates or {}).items():
        measured['velocity'][row] = rate
    record = RunRecord(sensor_names=('left', 'right'))
    record.streams = {'joint_states': measured, **streams}
    record.stamps = {name: (MS * TIME).astype(int) for name in record.streams}
    return record


def analysed(record, arm, reports=None):
    return Run(record, arm, reports or {}, certificate.Certificate(problem='no gains'))


def tile(values, name):
    return next(t for t in values['tiles'] if t.name == name)


def spans(found, *more):
    return [(p.what, p.start, p.end, *(getattr(p, name) for name in more)) for p in found]


def told(**parts):
    """Reports of the nodes: what each said, by the time in ms."""
    return {who: [NodeReport(t * MS, w) for t, w in said.items()] for who, said in parts.items()}


def event(time, onset=None, detected=None, **fields):
    """An alarm event; times in ms."""
    known = {'event': AlarmEvent.RAISED, 'sensor_index': 0, 'sensor': 'left', 'size': 0.3,
             'bound': 0.1, 'kind': 'unclassified', 'confidence': 0.99}  # fmt: skip
    times = (round(MS * (time if t is None else t)) for t in (onset, detected, time))
    return RecordedAlarm(**known | fields | dict(zip(('onset', 'detected', 'stamp'), times)))


def made_up(faults=None, alarms=None, lost=(), stopped=()):
    """True faults (sensor, start, end), alarm events, and spans in which the first sensor is not
    diagnosable and the arm is stopped; times in ms."""
    state, fault, tenth = *np.zeros((2, COUNT, 2)), np.full((COUNT, 2), 0.1)
    state[within(*lost), 0] = SensorState.NOT_DIAGNOSABLE
    for sensor, *span in faults or ():
        fault[within(span), sensor] += 0.2
    known = stream('position', 'velocity', 'compensated_position')
    estimate = {'estimate': 1e-3 * np.outer(TIME, [1, -1]), 'threshold': tenth}
    record = run(
        fault_estimate=stream('alarm', state=state, bound=2.0 * tenth, **estimate),
        torque_command=stream('torque', safe_stop=1.0 * within(*stopped)),
        state_estimate={**known, 'mode': 2.0 * (TIME == 0), 'trustworthy': np.ones(COUNT)},
        **({} if faults is None else {'ground_truth': {**known, 'fault': fault}}),
    )
    record.alarms = list(alarms or ())
    record.topics = {} if alarms is None else {'fault_alarm': '/lpv/fault_alarm'}
    return record


@pytest.fixture
def page(paper_arm):
    return lambda record, reports=None: content(analysed(record, paper_arm, reports))


@pytest.fixture
def shown(paper_arm, tmp_path, monkeypatch):
    monkeypatch.setattr('lpv.report.page.picture', lambda *_: b'')

    def html(record, reports=None):
        return write(analysed(record, paper_arm, reports), tmp_path).read_text()

    return html


def test_given_rates_when_reported_then_the_fastest_joint_and_its_limit_come_first(page, shown):
    values = page(run({100: (1.5, -3.0)}))
    assert not values['ran_away'] and 'exceeded' not in values['verdict']
    assert tile(values, 'fastest joint')[1:] == ('3 rad/s', 'limit 20, joint2, measured', '')
    away = run({k: (25.0, 0.0) for k in range(100, 200)})
    values, text = page(away), shown(away)
    assert values['verdict'].startswith('The arm exceeded its speed limit for 0.200 s (joint1: 25')
    assert tile(values, 'fastest joint').look == 'bad'
    assert spans(values['phases']) == [(history.TOO_FAST, 0.2, 0.4)]
    assert '<p class="verdict bad">' in text
    assert re.findall(r'[{;\s]color: (?!#000|var)[^;]*;', text) == [], 'those of the theme'
    # The truth counts where it is faster than what was measured, an infinite rate always.
    values = page(run(ground_truth=stream('position', 'fault', velocity=np.full((COUNT, 2), 30.0))))
    assert values['ran_away'] and '30 rad/s true' in values['verdict']
    for rate, away in ((np.inf, True), (np.nan, False)):
        assert page(run({100: (rate, 0.0)}))['ran_away'] is away


def test_given_a_reference_when_reported_then_it_is_told_how_far_the_tip_was_from_it(page):
    there = np.zeros((COUNT, 2))
    there[7], there[9] = (np.pi / 2, 0.0), np.nan  # both links point up instead of ahead
    known = {'reference': stream('velocity', position=there)}
    values = page(run(ground_truth=stream('position', 'velocity', 'fault'), **known))
    assert tile(values, 'farthest from path').value == '2.83 m'


@pytest.mark.parametrize(('what', 'margins', 'bounds', 'word'), [
    ('gains', (-1.0, -0.5), 'guaranteed', 'holds'), ('gains', (-1.0, 0.5), 'statistical', 'fails'),
    ('tracking loop', (-1.0,), 'statistical', 'holds'),
])  # fmt: skip
def test_given_a_certificate_when_reported_then_bounds_are_guaranteed_just_where_it_says_so(
    paper_arm, what, margins, bounds, word
):
    proof = certificate.Certificate(what, checks=tuple(Check('any', one) for one in margins))
    values = content(Run(run(), paper_arm, {}, proof))
    told = [tile(values, name).value for name in ('bounds', f'certificate of the {what}')]
    assert told == [bounds, word]


def test_given_stamps_of_a_calendar_or_not_when_reported_then_only_those_are_dates(page):
    record = run()
    assert page(record)['begin'] == ''
    record.stamps['joint_states'] = record.stamps['joint_states'] + 1_700_000_000 * 10**9
    assert page(record)['begin'] == '2023-11-14 22:13:20'


def test_given_commands_that_stay_away_when_reported_then_the_silence_is_told(paper_arm):
    record, kept = run(torque_command={}), np.r_[0:100, 200:400]
    record.stamps['torque_command'] = record.stamps['torque_command'][kept]
    record.streams['torque_command'] = {'torque': np.zeros((300, 2)), 'safe_stop': np.zeros(300)}
    found = spans(phases(record, paper_arm, {}))
    assert found == [(history.NO_COMMAND, 0.198, 0.4), (history.NO_COMMAND, 0.798, 0.998)]


def test_given_faults_and_alarms_when_reported_then_misses_and_false_alarms_are_listed(shown):
    alarms = [event(230, 210), event(450, 210, 230, **CLEARED), event(860, 850, size=-0.2)]
    page = shown(made_up([(0, 200, 400), (1, 500, 700)], alarms))
    found, false = (cells for cells in rows(page) if cells[0] == 'left')
    assert found[2:7] == ['0.210', '0.230', '0.030', '0.450', 'rad']
    assert (found[7], false[7]) == ('+0.300', '+0.998')
    assert false[2:7] == ['0.850', '0.860', 'false alarm', 'active', 'rad']
    missed = 'Missed: a fault of right from 0.500 s to 0.700 s raised no alarm.'
    assert re.findall('Missed: [^!]*? alarm[.]', text(page)) == [missed]
    # A healthy run, and a name with markup.
    said = text(shown(made_up([], [])))
    assert 'No alarm.' in said and 'Missed' not in said
    assert 'None: no inconsistent phase, no safe stop' in said
    page = shown(made_up(alarms=[event(210, 205, sensor='<b>left</b>', kind='dropout')]))
    (line,) = (cells for cells in rows(page) if cells[0] == '<b>left</b>')
    assert '<b>' not in page and line[5:9] == ['rad', '-', '-', '-'], 'no reading, no size'


LASTED = [event(210, 205), event(400, 205, 210, **CLEARED)]


# Spans of faults, alarms; how many of them are false, faults that are missed, the delay [ms].
@pytest.mark.parametrize('faults, alarms, false, missed, delay', [
    ([(200, 201)], [event(208, 208, kind='spike')], 0, 0, 8),
    ([], [event(203, 200, kind='rate_bias')], 0, 0, None),  # the truth has no rates' faults
    ([], [event(203, 200, kind='bias')], 1, 0, None),
    # The alarm is that of a reading that jumps back.
    *(([(200, 400)], [alarm], 0, 1, None) for alarm in (event(400), event(420, 402))),
    ([(200, 400)], [event(430, 300)], 0, 0, 230),
    ([(200, 400)], [event(600)], 1, 1, None),
    ([(100, 200)], LASTED, 0, 1, None),
    ([(100, 220)], LASTED, 0, 0, 110),
    *(([span], LASTED, 1, 0, None) for span in ((300, 350), (390, 500))),
    ([(600, 800)], LASTED, 1, 1, None),
])  # fmt: skip
def test_given_a_fault_and_an_alarm_then_it_is_judged(page, faults, alarms, false, missed, delay):
    record = made_up([(0, *span) for span in faults], alarms)
    values, (found,) = page(record), episodes(record)
    numbers = [tile(values, name).value for name in ('false alarms', 'missed faults')]
    assert numbers == [str(false), str(missed)] and found.false_alarm == bool(false)
    assert found.delay == (None if delay is None else pytest.approx(1e-3 * delay))
    spans_missed = [(1000 * f.start, 1000 * f.end) for f in missed_faults(record, [found])]
    assert spans_missed == faults * missed


def test_given_a_prismatic_joint_when_reported_then_its_figures_are_in_metres(paper_arm, capsys):
    arm = with_joints(paper_arm, 1, type='prismatic')
    alarms = [event(210, **RIGHT), event(220, sensor_index=9, sensor='of another arm')]
    record = made_up([(0, 200, 400)], alarms)
    record.joint_names, record.streams['ground_truth']['velocity'][9, 1] = arm.joint_names, 30.0
    found = analysed(record, arm)
    values = content(found)
    assert 'right -0.9980 m (bound 0.2000 m)' in values['verdict']
    assert '30 m/s true, limit 20 m/s' in values['verdict']
    assert tile(values, 'fastest joint').value == '30 m/s'
    assert [row['unit'] for row in values['detectable']] == ['rad', 'm']
    units = [row.unit for row in found.table]
    assert units[:4] == ['rad²', 'm²', 'rad²/s²', 'm²/s²'] and units[-2:] == ['rad²', 'm²']
    for draw, labels in (
        (figures.faults, ['fault [rad]', 'fault [m]']),
        (figures.states, ['position [rad]', 'velocity [rad/s]', 'position [m]', 'velocity [m/s]']),
        (figures.torques, ['torque [N m]', 'torque [N]']),
    ):
        assert [axis.get_ylabel() for axis in draw(found).axes] == labels
    result = compare_runs(record, record, arm)
    units = {one.name: one.unit for one in (*result.figures, *result.differences)}
    assert (units['velocity 1'], units['velocity 2'], units['bound 2']) == ('rad/s', 'm/s', 'm')
    compare.show(result, Console(width=80))
    assert re.search(r'right +unclassified .* -0.9980 m ', capsys.readouterr().out)
    del record.streams['ground_truth']
    record.stamps = {name: 3 * stamps for name, stamps in record.stamps.items()}
    assert [row.unit for row in make_table(record, arm)] == ['rad', 'rad', 'm', 'm']


def test_given_events_of_two_sensors_when_gathered_then_each_alarm_is_one_episode():
    right, bias = event(180, 160, size=-0.2, **RIGHT), {'kind': 'bias', 'confidence': 0.5}
    updated = event(250, 100, 120, event=AlarmEvent.UPDATED, **bias)
    cleared = event(400, 100, 120, **CLEARED)
    alarms = [event(120, 100), right, updated, cleared, event(700, 690)]
    record = made_up([(0, 100, 300), (1, 150, 900)], alarms)
    first, second, third = found = episodes(record)
    assert (first.sensor, first.onset, first.raised, first.cleared) == ('left', 0.1, 0.12, 0.4)
    assert (first.kind, first.confidence, first.size) == ('bias', 0.5, 0.3)
    assert (first.largest, first.delay) == pytest.approx((0.4, 0.02))
    assert (second.sensor, second.raised, second.cleared) == ('right', 0.18, None)
    assert (second.largest, second.delay) == pytest.approx((-0.998, 0.03))
    assert (third.sensor, third.false_alarm, third.delay) == ('left', True, None)
    assert missed_faults(record, found) == []
    # Neither the start of an alarm nor the truth has to be recorded.
    ended = made_up([(0, 0, 100)], [event(150, -500, -490, **CLEARED)])
    (episode,) = episodes(ended)
    assert (episode.onset, episode.raised, episode.cleared) == (-0.5, -0.49, 0.15)
    assert missed_faults(ended, [episode]) == []
    blind = made_up(alarms=[event(210, 205)])
    (episode,) = episodes(blind)
    assert (episode.delay, episode.false_alarm, episode.true_onset) == (None, False, None)
    assert missed_faults(blind, []) == []


def test_given_stops_and_lost_sensors_when_reported_then_each_has_its_stretch(paper_arm, shown):
    reports = told(observer={100: 'observing', 500: CONFUSED, 600: CONFUSED, 800: 'observing'})
    record = made_up(lost=[(0, 2), (200, 300)], stopped=[(320, 340), (400, 700)])
    lost, first, stop, odd = phases(record, paper_arm, reports)
    assert lost == Phase('not diagnosable', 'link1_angle', 0.2, 0.3)
    assert first == Phase('safe stop', '', 0.32, 0.34)
    assert (stop, odd) == (Phase('safe stop', '', 0.4, 0.7), Phase('inconsistent', '', 0.5, 0.8))
    page, meaning = shown(record, reports), 'the tracker commanded the drives to brake'
    assert ['safe stop', 'arm', '0.400', '0.700', '0.300', meaning] in rows(page)
    assert 'Alarms were not recorded; 2 safe stops, 1 inconsistent phase.' in text(page)
    assert 'come once a second' in text(page)
    line = [cells for cells in rows(page) if cells[0] == 'link1_angle'][-1]
    assert line[-1] == '10.0 %'


def test_given_what_drives_and_tracker_report_when_reported_then_stops_have_their_reasons(page):
    fast = 'a joint is faster than its velocity limit'
    drives = {0: 'braked: no command yet', 100: 'driven', 200: 'braked: safe stop'}
    drives |= dict.fromkeys((500, 600), f'braked: {fast}')
    reports = told(drives=drives, tracking={250: 'safe stop: the observer is silent'})
    values = page(run(torque_command=stream('torque', safe_stop=within((200, 500)))), reports)
    assert spans(values['phases'], 'note') == [
        (history.BRAKED, 0.2, 0.5, 'safe stop'),
        (history.SAFE_STOP, 0.2, 0.5, 'the observer is silent'),
        (history.BRAKED, 0.5, 0.998, fast),
    ]
    assert 'the drives braked 2 times (safe stop, a joint is faster' in values['verdict']
    assert tile(values, 'stopped').value == '0.3 s'


@given(st.lists(st.floats(0.01, 10.0), min_size=9, max_size=60))
def test_given_many_stretches_when_listed_then_the_longest_are_shown_and_all_are_counted(lengths):
    many = [Phase('no data', 'left', float(k), k + length) for k, length in enumerate(lengths)]
    shown, (rest,) = listed([*many, Phase('safe stop', '', 3.0, 4.0)])
    kept = [phase.duration for phase in shown if phase.what == 'no data']
    assert len(shown) == 9 and sorted(kept) == sorted(p.duration for p in many)[-8:]
    assert (rest['what'], rest['sensor'], rest['count']) == ('no data', 'left', len(many) - 8)
    assert sum(kept) + rest['duration'] == pytest.approx(sum(p.duration for p in many))


def test_given_a_wrong_rate_beside_offsets_then_each_has_its_end_and_unit(paper_arm, capsys):
    rate, times, drift = {'kind': 'rate_bias', 'size': -0.05}, (100, 120), {'kind': 'drift'}
    alarms = [
        event(120, *times, kind='bias'),
        event(200, **rate),
        event(250, *times, kind='dropout', size=0.0, event=AlarmEvent.UPDATED),
        event(300, 200, 200, **rate, **CLEARED),
        event(400, *times, kind='bias', **CLEARED),
        event(500, **rate),
        event(510, **drift),
        event(550, 510, **drift, **CLEARED),
        event(600, kind='noise', size=0.02, **RIGHT),
        event(700, 510, **rate, **CLEARED),
        event(800, **rate),
        event(810, **drift),
    ]
    record = made_up([], alarms)
    found = episodes(record)
    told = [(e.kind, e.raised, e.cleared, e.size, e.unit(paper_arm)) for e in found]
    assert told == [
        ('bias', 0.12, 0.4, 0.3, 'rad'),
        ('rate_bias', 0.2, 0.3, -0.05, 'rad/s'),
        ('rate_bias', 0.5, 0.7, -0.05, 'rad/s'),
        ('drift', 0.51, 0.55, 0.3, 'rad'),
        ('noise', 0.6, None, 0.02, 'rad'),
        ('rate_bias', 0.8, None, -0.05, 'rad/s'),
        ('drift', 0.81, None, 0.998, 'rad'),
    ]
    unknown = [math.isnan(e.largest) for e in found]
    assert unknown == [kind in ('rate_bias', 'noise') for kind, *_ in told]
    compare.show(compare_runs(record, record, paper_arm), Console(width=80))
    assert '-0.050 rad/s' in capsys.readouterr().out


@pytest.mark.parametrize(('fields', 'said'), [
    ({'kind': 'rate_bias', 'bound': 0.01}, 'left (rate) +0.300 rad/s (bound 0.010 rad/s)'),
    ({'kind': 'dropout', 'size': 0.0, 'bound': 0.0}, 'left no readings'),
    ({'kind': 'noise', 'bound': np.inf}, 'left of unknown size'),
])  # fmt: skip
def test_given_an_alarm_of_no_offset_when_it_lasts_then_the_verdict_says_so(page, fields, said):
    verdict = page(made_up([], [event(400, **fields)]))['verdict']
    assert f'error at the end of the run: {said};' in verdict


def test_given_a_band_of_many_samples_when_thinned_then_its_sides_keep_their_extremes():
    time = 0.002 * np.arange(20_000)
    sides = [np.where(time < 10.0, 0.01, 0.0) + bound for bound in (-0.01, 0.01)]
    at, *thinned = thin(time, *sides)
    assert [len(side) for side in thinned] == [len(at)] * 2 and len(at) < 6000
    for side, whole in zip(thinned, sides):
        assert (side.min(), side.max()) == (whole.min(), whole.max())


def test_given_no_reading_at_all_when_drawn_then_there_is_no_path(paper_arm):
    record = run()
    record.joint_names = paper_arm.joint_names
    record.streams['joint_states']['position'][:] = np.nan
    (axis,) = figures.path(analysed(record, paper_arm)).axes
    assert list(axis.lines) == []


def test_given_a_scenario_of_six_joints_when_drawn_then_its_path_is_there_without_references():
    arm, record = load_arm('ur10'), run()
    record.streams['joint_states'] = {name: np.zeros((COUNT, 6)) for name in JOINTS}
    record.joint_names = arm.joint_names
    planned = load_scenario(BRINGUP / 'scenarios' / 'ur10.yaml').path(arm)
    figure = figures.path(replace(analysed(record, arm), path=planned))
    assert 'reference path' in [words.get_text() for words in figure.legends[0].get_texts()]


def test_given_the_states_of_a_sensor_when_drawn_then_bars_and_legend_agree(paper_arm):
    state = np.repeat([[int(s)] for s, _, _ in STATES], COUNT // len(STATES), axis=0)
    record = run(fault_estimate=stream(*ESTIMATES, state=np.hstack([state, state[::-1]])))
    figure, bars = timeline(analysed(record, paper_arm)), {}
    for bar in figure.axes[0].collections:
        bars.setdefault(bar.get_label(), set()).add(bar.get_facecolor().tobytes())
    (legend,) = figure.legends
    colors = [handle.get_facecolor() for handle in legend.legend_handles]
    shown = {words.get_text(): color for words, color in zip(legend.get_texts(), colors)}
    assert len(shown) == len(STATES) == len({tuple(color) for color in shown.values()})
    for label, color in shown.items():
        assert {np.asarray([color]).tobytes()} == bars[label], label


def test_given_an_arm_when_tabulated_then_only_the_papers_has_a_column(paper_arm, real_arm, capsys):
    assert is_paper_arm(paper_arm) and is_paper_arm(replace(paper_arm, name='mine'))
    other = with_joints(paper_arm, 0, link={'mass': 10.5})
    assert not is_paper_arm(other) and not is_paper_arm(real_arm)
    known = stream('position', 'velocity', 'fault')
    record, names = run(ground_truth=known, state_estimate=known), ['joint1', 'joint2'] * 2
    table = make_table(record, other)
    assert [(row.signal, row.paper) for row in table] == [(name, None) for name in names]
    assert all(row.paper for row in make_table(record, paper_arm))
    # Nothing is cut off in a terminal of 80 columns.
    rows = [Row(name, 'estimate of the position', 'rad²', 2.6e-4, PAPER[name]) for name in PAPER]
    print_table(rows, Console(width=80))
    text = capsys.readouterr().out
    assert '…' not in text and 'better by' in text
    assert (text.count('0.006'), text.count('0.00026')) == (2, len(PAPER))
