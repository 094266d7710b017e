import io
import json
import math
import re
import warnings
from copy import copy

import numpy as np
import pyarrow as pa
import pytest
from campaign_files import resolved, spec, written
from fault_injection import with_joints
from rich.console import Console
from runs import assert_stands_alone
from scipy.stats import chi2, norm

from lpv.campaign.execution.runs import run_one
from lpv.campaign.plan.campaign import resolve
from lpv.campaign.report import write
from lpv.campaign.report.statistics import Results, found_from, poisson_rate, proportion, trends
from lpv.campaign.report.write import command, confusion, report_numbers, write_report
from lpv.core.control.watchdog import StopReason

pytestmark = pytest.mark.slow

SENSORS, table = ('link1_angle', 'link2_angle'), pa.Table.from_pylist
UNITS = 'rad', 'm', 'rad or m'
FACTORS = """{fault.kind: [none, bias, stuck], fault.size: {bias: 0.3},
              compensation: ['off', confirmed]}"""
SPEC = spec(FACTORS, 120, name='made <up>', duration=10.0)


@pytest.fixture(scope='module')
def campaign():
    return resolve(SPEC, 'made_up', '.')


@pytest.fixture(scope='module')
def row():
    """Makes rows of a healthy run of 10 s, but for the changes."""
    healthy = run_one(resolved('{fault.kind: none}', duration=1.0), 0)
    healthy |= dict.fromkeys(('observed', 'healthy_time', 'early_time'), 10.0)
    return lambda number, **changes: {**healthy, 'number': number, **changes}


def made_up(row, count):
    """Rows of all sorts, with NaN here and there."""
    rng, rows = np.random.default_rng(1), []
    for number in range(count):
        kind = ('none', 'bias', 'stuck')[number % 3]
        sensor, found = (*SENSORS, 'both')[number % 4 % 3], bool(rng.random() < 0.7)
        changes = {'compensation': ('off', 'confirmed')[number % 2]}
        if kind != 'none':
            changes.update(
                kind=kind, sensor=sensor, detected=found, isolated=found, found_1=found,
                said_kind=kind if found else 'none', said_sensor=sensor if found else 'none',
                fault_size=10 ** rng.uniform(-2, 0) if kind == 'bias' else math.nan,
                detection_delay=rng.uniform(0.01, 1.0) if found else math.nan,
                score_during_1=rng.uniform(0.0, 3.0), score_during_2=rng.uniform(0.0, 3.0),
                healthy_time=8.0, early_time=4.0, stable=bool(rng.random() < 0.9),
            )  # fmt: skip
        rows.append(row(number, **changes))
    return rows


@pytest.mark.parametrize(('events', 'hours'), [(0, 2.0), (3, 1.0), (100, 7.0)])
def test_given_events_when_counted_then_their_rate_has_the_exact_poisson_interval(events, hours):
    found, tail = poisson_rate(events, hours), 0.025 if events else 0.05
    assert chi2.cdf(2.0 * hours * found['high'], 2 * events + 2) == pytest.approx(1.0 - tail)
    if events:
        assert chi2.cdf(2.0 * hours * found['low'], 2 * events) == pytest.approx(tail)
    assert poisson_rate(events, 0.0)['rate'] is None


@pytest.mark.parametrize(('hits', 'cases'), [(0, 5), (8, 10), (40, 40)])
def test_given_hits_when_counted_then_their_share_has_wilsons_interval(hits, cases):
    found, z = proportion(hits, cases), norm.ppf(0.975)
    assert found['low'] <= found['rate'] == hits / cases <= found['high']
    for end in (found['low'], found['high']):
        assert cases * (found['rate'] - end) ** 2 == pytest.approx(z**2 * end * (1.0 - end))


def test_given_sizes_when_swept_then_the_smallest_that_is_found_is_that_of_the_curve():
    sizes = np.linspace(0.1, 2.0, 20)
    assert found_from(sizes, sizes > 0.95) == pytest.approx(1.0)
    assert found_from(sizes, np.ones(20, bool)) == pytest.approx(0.1)
    assert math.isnan(found_from(sizes, np.zeros(20, bool)))
    assert math.isnan(found_from(sizes[:5], np.ones(5, bool)))  # too few to say anything
    levels, found = np.repeat([0.5, 0.1], 10), np.arange(20) < 11
    assert found_from(levels, found) == found_from(levels[::-1], found[::-1]) == 0.5


def test_given_answers_when_counted_then_the_matrix_is_that_of_the_rows():
    truth = np.array(['bias', 'bias', 'drift', 'drift'], object)
    said = np.array(['bias', 'none', 'odd', 'drift'], object)
    found = confusion(truth, said, ('bias', 'drift', 'none'))
    shares = [[share['rate'] for share in found.pop(key)] for key in ('right', 'right_if_said')]
    assert shares == [[0.5, 0.5], [1.0, 0.5]]
    rows, columns = ['bias', 'drift'], ['bias', 'drift', 'none', 'odd']
    counts = [[1, 0, 1, 0], [0, 1, 0, 1]]
    assert found.items() >= {'rows': rows, 'columns': columns, 'counts': counts}.items()
    assert confusion(truth[:0], said[:0], ())['rows'] == []


def test_given_runs_when_numbers_are_gathered_then_they_are_of_the_rows(campaign, row, tmp_path):
    rows = made_up(row, 120)
    rows[0].update(false_alarms=3, alarms_before_2=2)
    found = report_numbers(campaign, table(rows), tmp_path, 120)
    faulty = [r for r in rows if r['kind'] != 'none']
    assert found['overall']['detected']['hits'] == sum(r['detected'] for r in faulty)
    assert found['overall']['detected']['cases'] == len(faulty) == 80
    rates = {rate['name']: (rate['events'], 3600.0 * rate['hours']) for rate in found['alarms']}
    known = {
        'false alarms': (3, pytest.approx(40 * 10.0 + 80 * 8.0)),
        'before any fault, or without one': (2, pytest.approx(40 * 10.0 + 80 * 4.0)),
        'after the end of a fault': (1, pytest.approx(80 * 4.0)),
    }
    assert {name: rates[name] for name in known} == known
    both = next(e for e in found['detection'] if e['kind'] == 'bias' and e['sensor'] == 'both')
    mine = [r for r in rows if r['kind'] == 'bias' and r['sensor'] == 'both']
    delays = [r['detection_delay'] for r in mine if r['detected']]
    ends = zip(('low', 'median', 'high'), np.quantile(delays, (0.05, 0.5, 0.95)))
    assert both['delay'] == pytest.approx({'count': len(delays), **dict(ends)})
    assert sorted(both['sizes']) == sorted(r['fault_size'] for r in mine)
    assert sum(c['detected']['cases'] for c in both['classes']) == len(mine)
    by = {one['factor']: {g['value']: g['count'] for g in one['groups']} for one in found['groups']}
    kinds = dict.fromkeys(('none', 'bias', 'stuck'), 40)
    assert by == {'kind': kinds, 'compensation': {'off': 60, 'confirmed': 60}}


def test_given_runs_when_the_worst_are_listed_then_each_has_its_command(campaign, row, tmp_path):
    rows = [row(k, tracking_max=0.1 * k) for k in range(20)]
    rows[3].update(tracking_max=math.nan, stable=False)
    rows[5].update(kind='bias', sensor=SENSORS[0], fault_size=0.5)
    rows[6].update(kind='bias', sensor=SENSORS[0], fault_size=0.9, detected=True)
    lost, missed, late, false = report_numbers(campaign, table(rows), tmp_path, 120)['worst']
    assert [r['number'] for r in lost['runs']][:3] == [3, 19, 18] and len(lost['runs']) == 10
    assert [(r['number'], r['value']) for r in missed['runs']] == [(5, pytest.approx(0.5 / 0.9))]
    assert late['runs'] == false['runs'] == []
    assert missed['runs'][0]['command'] == command(tmp_path, 5)
    told = "lpv campaign 'my results' --run 7 --bag 'my results/bags/run_7'"
    assert command('my results', 7) == told


def test_given_safe_stops_when_reported_then_each_reason_names_its_runs(campaign, row, tmp_path):
    late, far = 'estimates come too late', 'a joint is too far'
    reasons = {0: late, 2: f'{far}; {late}', 5: late}
    rows = [row(k, safe_stops=1, stop_reasons=reasons.get(k, '')) for k in range(7)]
    said, console = io.StringIO(), Console(soft_wrap=True)
    console.file = said
    found = write_report(campaign, table(rows), tmp_path, 120)
    known = [{'reason': late, 'runs': 3, 'numbers': [0, 2, 5]}]
    assert found['stops'] == [*known, {'reason': far, 'runs': 1, 'numbers': [2]}]
    assert late in (tmp_path / 'report.html').read_text()
    write.print_summary(found, console)
    assert '0, 2, 5' in said.getvalue()


@pytest.mark.parametrize(
    ('fault', 'why'), [('dropout', 'NOT_TRUSTWORTHY'), ('bias, fault.size: 3.0', 'OVERSPEED')]
)
def test_given_a_run_that_stops_when_measured_then_its_row_says_why(fault, why):
    of_fault = 'fault.sensor: both, fault.onset: 1.0'
    factors = f"{{fault.kind: {fault}, {of_fault}, compensation: 'off'}}"
    row = run_one(resolved(factors, duration=1.5), 0)
    assert row['safe_stops'] == 1 and row['stop_reasons'] == StopReason[why].text


def test_given_a_run_shorter_than_its_approach_when_measured_then_nothing_is_warned_of():
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        row = run_one(resolved('{fault.kind: none}', duration=0.5), 0)
    assert math.isnan(row['mean_threshold_1']) and row['stop_reasons'] == ''


def test_given_a_joint_that_slides_when_reported_then_metres_are_told(campaign, row, tmp_path):
    sliding = copy(campaign)
    sliding.arm = with_joints(campaign.arm, 1, type='prismatic')
    found = write_report(sliding, table(made_up(row, 120)), tmp_path, 120)
    biases = [e for e in found['detection'] if e['kind'] == 'bias']
    assert [(e['sensor'], e['unit']) for e in biases] == list(zip((*SENSORS, 'both'), UNITS))
    assert [e['unit'] for e in found['estimates']] == list(UNITS[:2])
    assert found['worst'][0]['unit'] == '[rad or m]'
    assert 'tracking RMS [rad or m]' in (tmp_path / 'report.html').read_text()


def test_given_faults_never_found_when_reported_then_no_delay_is_drawn(campaign, row, tmp_path):
    faults = [{'fault_size': 0.01 * k, 'detection_delay': math.nan} for k in range(1, 20)]
    rows = [row(k, kind='bias', sensor=SENSORS[0], **fault) for k, fault in enumerate(faults)]
    (found,) = write_report(campaign, table(rows), tmp_path, len(rows))['detection']
    assert len(found['classes']) > 1 and found['delay']['count'] == 0


def test_given_an_encoder_that_ages_when_trends_are_asked_for_then_its_arm_is_the_first():
    def trends_of(bags, threshold=0.05):
        same = {'kind': None, 'sensor': None, 'fault_mean_2': 0.0}
        same |= dict.fromkeys(('threshold_mean_1', 'threshold_mean_2'), threshold)
        found = [{**same, 'unit': unit, 'start': int((1e4 + day) * 86400e9), 'fault_mean_1': mean}
                 for unit, day, mean in bags]  # fmt: skip
        return trends(Results(table(found), {'one': 'rad', 'two': 'm'}))

    noise, days = 0.002 * np.random.default_rng(3).standard_normal((8, 12)), 7.0 * np.arange(12)
    noise[5] += 2e-4 * days
    found = trends_of((f'arm{unit}', days[k], noise[unit, k]) for unit, k in np.ndindex(8, 12))
    assert len(found) == 16
    assert [(t['unit'], t['sensor']) for t in found if t['clear']] == [('arm5', 'one')]
    assert {(t['sensor'], t['position_unit']) for t in found} == {('one', 'rad'), ('two', 'm')}
    low, high = found[0]['interval']
    assert 1e-4 < low < 2e-4 < high
    assert found[0]['days_left'] == pytest.approx((0.05 - 77 * 2e-4) / 2e-4, rel=0.25)
    drift = [('a', day, 1e-3 * day) for day in range(9)]
    assert trends_of(drift, None)[0]['days_left'] == np.inf  # there is no threshold to reach
    # Without dates there is no order, and few bags say nothing.
    assert trends_of(('a', 0.0, k) for k in range(9)) == []
    assert trends_of(('a', k, k) for k in range(4)) == []


def test_given_bags_when_ranked_then_alarms_come_first_then_contradictions_then_scores():
    calm = {'bag': 'a', 'alarms': 0, 'observed': 3600.0, 'inconsistent_time': 0.0, 'score': 0.5}
    near, odd = {**calm, 'score': 0.9}, {**calm, 'inconsistent_time': 100.0}
    rows = [{**calm, 'alarms': 1, 'score': 0.2}, odd, near, calm]
    assert sorted(reversed(rows), key=write.suspicion, reverse=True) == rows


def check_page(path):
    """It needs nothing from elsewhere, and has a number wherever there is one."""
    text = path.read_text(encoding='utf-8')
    assert_stands_alone(text)
    assert not re.search(r'\bnan\b|\bNone\b', re.sub(r'base64,[^"]*', '', text))
    return text


@pytest.mark.parametrize(('count', 'pictures'), [(1, 0), (2, 0), (120, 1)])
def test_given_results_when_reported_then_all_is_there(campaign, row, tmp_path, count, pictures):
    numbers = write_report(campaign, table(made_up(row, count)), tmp_path, 120)
    text = check_page(tmp_path / 'report.html')
    assert text.count('<img') == len([*tmp_path.glob('*.png')]) == pictures
    assert 'made &lt;up&gt;' in text
    assert ('are missing' in text) == (count < 120)
    assert json.loads((tmp_path / 'report.json').read_text()) == json.loads(json.dumps(numbers))


def test_given_a_long_text_when_summed_up_then_it_is_wrapped_and_not_cut(campaign, row, tmp_path):
    numbers = write_report(campaign, table(made_up(row, 2)), tmp_path, 2)
    alarms = ', '.join(f'{number} stuck of link2_angle' for number in range(1, 6))
    bag = {'bag': 'monday', 'unit': '', 'alarm_text': alarms, 'score': 1.0}
    console = Console(soft_wrap=True, width=80, file=io.StringIO())
    write.print_summary({**numbers, 'bags': [bag]}, console)
    said = console.file.getvalue()
    assert said.count('link2_angle') >= 5 and '\u2026' not in said


def test_given_unfinished_results_when_reported_then_it_is_said_what_is_missing(tmp_path, call):
    factors, out = '{path: random, fault.kind: [none, bias], fault.size: 0.3}', tmp_path / 'out'
    file = written(tmp_path / 'spec.yaml', spec(factors, 22, duration=2.0))

    def missing():
        return json.loads((out / 'report.json').read_text())['head']['missing']

    call('campaign', file, '--out', out, '--workers', 0)
    assert missing() == 0 and check_page(out / 'report.html')
    (out / 'chunks' / '00000000.parquet').unlink()
    assert '20 of 22 runs are missing' in call('campaign', out).out and missing() == 20
