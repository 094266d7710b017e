"""Reports of campaigns: made-up rows with known answers, a small real campaign, the command."""

import json
import math
import re
from html.parser import HTMLParser
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import binomtest

from lpv_campaign.execution.run_metrics import BINS, COUNTS, FLAGS, FLOATS, LISTS, TEXTS
from lpv_campaign.execution.store import CampaignFolder, schema
from lpv_campaign.plan.campaign import resolve
from lpv_campaign.report import write_report
from lpv_campaign.report.pictures.stability_figures import draw_stability
from lpv_campaign.report.sections.detection import classes, detection
from lpv_campaign.report.sections.estimates import estimates
from lpv_campaign.report.sections.isolation import confusion, isolation
from lpv_campaign.report.sections.limit import limit
from lpv_campaign.report.sections.roc import area, roc, sweep
from lpv_campaign.report.sections.stability import stability
from lpv_campaign.report.sections.tracking import false_alarms, tracking
from lpv_campaign.report.sections.worst import command, worst
from lpv_campaign.report.statistics.intervals import area_interval, poisson_rate, proportion, spread
from lpv_campaign.report.statistics.probability import detection_curve
from lpv_campaign.report.statistics.results import Results
from lpv_campaign.report.write import report_numbers
from lpv_cli.main import main
from lpv_core.support.resources import shipped_files

pytestmark = pytest.mark.slow

SPEC = {
    'name': 'made up',
    'seed': 1,
    'duration': 10.0,
    'plan': {'method': 'random', 'runs': 100},
    'factors': {
        'fault.kind': ['none', 'bias', 'drift', 'stuck'],
        'fault.sensor': ['link1_angle', 'link2_angle'],
        'fault.size': {'bias': {'low': 0.01, 'high': 1.0, 'spacing': 'log'}},
        'fault.rate': {'drift': 0.1},
        'fault.onset': 4.0,
        'fault.duration': 2.0,
        'compensation': ['off', 'confirmed'],
        'payload': {'low': 0.0, 'high': 8.0},
        'friction': {'low': 0.0, 'high': 8.0},
        'sample_loss': [0.0, 0.5],
    },
}
SENSORS = ('link1_angle', 'link2_angle')
REAL = {
    'name': 'real',
    'seed': 1,
    'plan': {'method': 'latin_hypercube', 'runs': 6},
    'duration': 2.0,
    'factors': {
        'path': 'random',
        'fault.kind': ['none', 'bias', 'stuck'],
        'fault.size': {'bias': 0.3},
        'fault.onset': 1.2,
        'payload': {'low': 0.0, 'high': 0.05},
    },
}


@pytest.fixture(scope='module')
def campaign():
    # Shipped gains: nothing is designed.
    gains = str(shipped_files('gains')['paper'])
    return resolve({**SPEC, 'designs': [gains]}, 'made_up', '.')


def row(campaign, number, **changes):
    """A healthy run, but for the changes; keys with __ for a dot."""
    empty = {
        **dict.fromkeys(FLOATS, math.nan),
        **dict.fromkeys(TEXTS, 'none'),
        **dict.fromkeys(COUNTS, 0),
        **dict.fromkeys(FLAGS, False),
        **{name: [0.0] * (len(BINS) - 1) for name in LISTS},
    }
    common = {
        'number': number,
        'seed': number,
        'kind': 'none',
        'sensor': 'none',
        'stable': True,
        'design': campaign.spec.designs[0],
        'compensation': 'confirmed',
        'fault.onset': 4.0,
        'fault.duration': 2.0,
        'fault.kind': 'none',
        'fault.size': 0.0,
        'fault.rate': 0.0,
        'tracking_max': 0.01,
        'tracking_rms': 0.001,
        'score_before_1': 0.5,
        'score_before_2': 0.5,
    }
    given = {name.replace('__', '.'): value for name, value in changes.items()}
    if 'kind' in given:
        given.setdefault('fault.kind', given['kind'])
        given.setdefault('sensor', 'link1_angle')
    return {**empty, **common, **given}


def results(campaign, rows):
    return Results(campaign, pa.Table.from_pylist(rows, schema=schema(campaign, rows)))


def made_up(campaign, count=100, rng=None):
    """Rows of all sorts, with NaN here and there."""
    rng = rng or np.random.default_rng(1)
    rows = []
    for number in range(count):
        kind = ('none', 'bias', 'drift', 'stuck')[number % 4]
        sensor = ('link1_angle', 'link2_angle', 'both')[number % 3] if number % 4 else 'none'
        size, found = 10 ** rng.uniform(-2, 0), bool(number % 4 and rng.random() < 0.7)
        rows.append(
            row(
                campaign,
                number,
                kind=kind,
                sensor=sensor,
                fault__size=size if kind == 'bias' else 0.0,
                fault__rate=0.1 * (kind == 'drift'),
                detected=found,
                found_1=found,
                found_2=found,
                isolated=found,
                said_kind=kind if found else 'none',
                said_sensor=sensor if found else 'none',
                detection_delay=rng.uniform(0.01, 1.0) if found else math.nan,
                score_during_1=rng.uniform(0.0, 3.0) if number % 4 else math.nan,
                score_during_2=rng.uniform(0.0, 3.0) if number % 4 else math.nan,
                score_before_1=rng.uniform(0.0, 1.1),
                payload=rng.uniform(0.0, 8.0),
                friction=rng.uniform(0.0, 8.0),
                sample_loss=float(rng.integers(2)) / 2.0,
                stable=bool(rng.random() < 0.9),
                false_alarms=int(rng.random() < 0.1),
                compensation=('off', 'confirmed')[number % 2],
                error_squares_1=[0.01] * 20,
                error_counts_1=[100.0] * 20,
            )
        )
    return rows


def numbers_of(data):
    """Every number in nested data."""
    if isinstance(data, dict):
        data = list(data.values())
    if isinstance(data, list):
        for value in data:
            yield from numbers_of(value)
    elif isinstance(data, float):
        yield data


class Page(HTMLParser):
    """Collects what a page refers to, and whether its tags are balanced."""

    VOID = ('meta', 'img', 'br', 'link')

    def __init__(self, text):
        super().__init__()
        self.references, self.ids, self.open, self.tags = [], set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [value for name, value in attrs if name in ('src', 'href', 'action')]
        self.ids |= {value for name, value in attrs if name == 'id'}
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_page(path):
    """It needs nothing from elsewhere, and is whole."""
    text = path.read_text(encoding='utf-8')
    page = Page(text)
    assert page.open == []
    assert not {'script', 'link', 'iframe'} & set(page.tags)
    for reference in page.references:
        assert reference.startswith('data:image/png;base64,') or reference[1:] in page.ids
    assert '@import' not in text
    assert 'url(' not in text
    assert not re.search(r'\bnan\b|\bNone\b', re.sub(r'base64,[^"]*', '', text))
    return text


# ------------------------------------------------------------------ intervals


@pytest.mark.parametrize(
    ('hits', 'cases'), [(0, 1), (0, 30), (1, 1), (30, 30), (7, 19), (999, 10000)]
)
def test_given_counts_when_their_rate_is_bounded_then_it_is_wilsons_interval(hits, cases):
    ours = proportion(hits, cases)
    theirs = binomtest(hits, cases).proportion_ci(0.95, 'wilson')
    assert (ours['low'], ours['high']) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert ours['low'] <= ours['rate'] == hits / cases <= ours['high']


def test_given_no_cases_when_their_rate_is_asked_for_then_there_is_none():
    assert proportion(0, 0) == {'hits': 0, 'cases': 0, 'rate': None, 'low': None, 'high': None}
    assert poisson_rate(0, 0.0)['rate'] is None
    assert spread([math.nan, math.inf]) == {'count': 0, 'low': None, 'median': None, 'high': None}


@pytest.mark.parametrize(
    ('events', 'low', 'high'),
    [
        (0, 0.0, 2.996),
        (1, 0.0253, 5.572),
        (5, 1.623, 11.668),
        (10, 4.795, 18.390),
        (100, 81.364, 121.627),
    ],
)
def test_given_events_when_their_rate_is_bounded_then_it_is_the_exact_poisson_interval(
    events, low, high
):
    # Garwood's table; without events the one-sided bound, -ln(0.05).
    rate = poisson_rate(events, 2.0)
    assert rate['rate'] == events / 2.0
    assert (2.0 * rate['low'], 2.0 * rate['high']) == pytest.approx((low, high), abs=6e-4)


def test_given_separated_scores_when_the_area_is_bounded_then_the_interval_is_not_empty():
    low, high = area_interval(1.0, 20, 20)
    assert high == 1.0
    assert 0.8 < low < 0.99
    assert area_interval(0.0, 20, 20) == pytest.approx((0.0, 1.0 - low))
    wide, narrow = area_interval(0.8, 20, 20), area_interval(0.8, 2000, 2000)
    assert wide[0] < narrow[0] < 0.8 < narrow[1] < wide[1]


# ------------------------------------------------------------------ ROC curves


def test_given_separable_scores_when_swept_then_the_area_is_1_and_a_corner_is_reached(campaign):
    rows = [row(campaign, k, score_before_1=0.1 + 0.01 * k) for k in range(20)]
    rows += [
        row(campaign, k, kind='bias', score_before_1=0.2, score_during_1=2.0 + k, found_1=True)
        for k in range(20, 50)
    ]
    (one,) = (c for c in roc(results(campaign, rows))['curves'] if c['sensor'] == 'link1_angle')
    assert one['area'] == 1.0
    assert (one['positive'], one['negative']) == (30, 50)
    assert (1.0, 0.0) in set(zip(one['points']['detection'], one['points']['false_alarm']))
    assert one['score']['detection']['rate'] == one['shipped']['detection']['rate'] == 1.0
    assert one['shipped']['false_alarm']['hits'] == 0


def test_given_equal_scores_when_swept_then_the_area_is_a_half():
    scores = np.array([0.5] * 10)
    assert area(scores, scores)['area'] == 0.5
    assert area(scores, scores[:0])['area'] is None
    assert sweep(scores, scores[:0]) == {'factor': []}


def test_given_random_scores_when_swept_then_the_area_is_that_below_the_curve():
    rng = np.random.default_rng(3)
    positive, negative = rng.normal(1.0, 1.0, 60) + 4.0, rng.normal(0.0, 1.0, 80) + 4.0
    points = sweep(positive, negative)
    below = (
        np.trapezoid(points['detection'], points['false_alarm'])
        if hasattr(np, 'trapezoid')
        else np.trapz(points['detection'], points['false_alarm'])
    )
    assert area(positive, negative)['area'] == pytest.approx(below, abs=1e-5)
    at_one = points['factor'].index(1.0)
    assert points['detection'][at_one] == np.mean(positive > 1.0)
    assert np.all(np.diff(points['factor']) < 0.0)
    assert np.all(np.diff(points['detection']) >= 0.0)
    assert points['detection'][-1] == points['false_alarm'][-1] == 1.0


def test_given_alarms_and_scores_that_differ_when_swept_then_both_are_told_apart(campaign):
    rows = [
        row(
            campaign,
            k,
            kind='bias',
            score_during_1=0.5,
            score_before_1=1.5,
            found_1=k < 3,
            alarms_before_1=int(k == 0),
        )
        for k in range(4)
    ]
    rows.append(row(campaign, 4, kind='bias', score_during_1=math.nan, found_1=True))
    (one,) = (c for c in roc(results(campaign, rows))['curves'] if c['sensor'] == 'link1_angle')
    assert one['without_score'] == 1
    assert one['score']['detection']['hits'] == 0
    assert one['score']['false_alarm']['hits'] == 4
    assert (one['shipped']['detection']['hits'], one['shipped']['detection']['cases']) == (4, 5)
    assert (one['shipped']['false_alarm']['hits'], one['shipped']['false_alarm']['cases']) == (1, 5)


# ------------------------------------------------------------------ detection against size


def test_given_faults_drawn_from_a_curve_when_fitted_then_its_sizes_are_found():
    rng = np.random.default_rng(5)
    sizes = np.exp(rng.uniform(np.log(0.01), np.log(1.0), 4000))
    truth = 1.0 / (1.0 + np.exp(-4.0 * (np.log(sizes) - np.log(0.1))))
    curve = detection_curve(sizes, rng.random(4000) < truth)
    for probability in (0.5, 0.95):
        wanted = 0.1 * math.exp(math.log(probability / (1.0 - probability)) / 4.0)
        found = curve.size(probability)
        assert found['size'] == pytest.approx(wanted, rel=0.07)
        assert found['size'] < found['bound'] < 1.2 * wanted


def test_given_sizes_that_separate_when_fitted_then_the_curve_is_finite_and_in_between():
    sizes = np.geomspace(0.01, 1.0, 60)
    found = detection_curve(sizes, sizes > 0.1).size(0.95)
    assert 0.1 < found['size'] < 0.2
    assert found['bound'] > found['size']


def test_given_faults_all_or_none_of_which_are_found_when_fitted_then_it_says_so():
    sizes = np.geomspace(0.01, 1.0, 200)
    all_found = detection_curve(sizes, np.ones(200, bool)).size(0.95)
    assert all_found['below']
    assert all_found['size'] == 0.01
    assert detection_curve(sizes, np.zeros(200, bool)).size(0.95)['size'] is None
    assert detection_curve(sizes[:9], np.ones(9, bool)) is None
    assert detection_curve(np.full(20, 0.1), np.ones(20, bool)) is None


def test_given_delays_when_gathered_then_median_and_spread_are_those_of_detected_faults(campaign):
    rows = [
        row(
            campaign,
            k,
            kind='bias',
            fault__size=-0.1 * (1 + k % 2),
            detected=k < 100,
            detection_delay=(k + 1) / 100 if k < 100 else math.nan,
        )
        for k in range(110)
    ]
    (one,) = detection(results(campaign, rows))
    assert (one['kind'], one['sensor']) == ('bias', 'link1_angle')
    assert one['delay']['median'] == pytest.approx(0.505)
    assert one['delay']['low'] == pytest.approx(0.0595)
    assert one['delay']['high'] == pytest.approx(0.9505)
    assert (one['detected']['hits'], one['detected']['cases']) == (100, 110)
    assert [c['middle'] for c in one['classes']] == [0.1, 0.2]


def test_given_a_kind_without_size_when_gathered_then_there_are_no_classes(campaign):
    (one,) = detection(results(campaign, [row(campaign, k, kind='stuck') for k in range(20)]))
    assert one['classes'] == []
    assert one['smallest'] == {'0.95': None, '0.99': None}
    assert one['delay']['count'] == 0


def test_given_many_values_when_classed_then_all_are_in_classes_of_equal_size():
    values = np.random.default_rng(1).random(1000)
    parts = classes(values)
    assert sorted(np.concatenate(parts)) == list(range(1000))
    assert {len(part) for part in parts} == {125}
    assert all(values[a].max() <= values[b].min() for a, b in zip(parts, parts[1:]))


# ------------------------------------------------------------------ isolation, estimates


def test_given_answers_when_counted_then_the_matrix_is_that_of_the_rows(campaign):
    said = ['bias'] * 3 + ['drift'] + ['none'] * 4 + ['inconsistent'] * 2
    rows = [
        row(
            campaign,
            k,
            kind='bias',
            said_kind=answer,
            said_sensor='none' if answer == 'none' else 'link2_angle',
        )
        for k, answer in enumerate(said)
    ]
    rows += [
        row(campaign, 10, kind='drift', said_kind='drift', said_sensor='link1_angle'),
        row(campaign, 11),
        row(campaign, 12, false_alarms=2),
    ]
    found = isolation(results(campaign, rows))
    kinds = found['kinds']
    assert (kinds['rows'], kinds['columns']) == (
        ['bias', 'drift'],
        ['bias', 'drift', 'none', 'inconsistent'],
    )
    assert kinds['counts'] == [[3, 1, 4, 2], [0, 1, 0, 0]]
    assert kinds['rates'][0] == [0.3, 0.1, 0.4, 0.2]
    assert [r['rate'] for r in kinds['right']] == [0.3, 1.0]
    assert kinds['right_if_said'][0]['rate'] == 0.5
    assert found['sensors']['columns'] == ['link1_angle', 'link2_angle', 'none']
    assert found['sensors']['counts'] == [[1, 6, 4]]
    assert (found['healthy']['hits'], found['healthy']['cases']) == (1, 2)


def test_given_no_cases_when_counted_then_the_matrix_is_empty():
    nothing = np.array([], object)
    assert confusion(nothing, nothing, ('a',), ('none',))['counts'] == []


def test_given_sums_of_squares_when_gathered_then_the_rms_is_over_all_samples(campaign):
    def lists(square, count):
        return {'error_squares_1': [0.0] * 19 + [square], 'error_counts_1': [0.0] * 19 + [count]}

    rows = [
        row(campaign, 0, **lists(1.0, 100.0)),
        row(campaign, 1, **lists(9.0, 300.0)),
        row(campaign, 2, **lists(0.0, 0.0)),
    ]
    one, two = estimates(results(campaign, rows))
    (cell,) = one['classes']
    assert cell['rms'] == pytest.approx(math.sqrt(10.0 / 400.0))
    assert cell['runs']['count'] == 2
    assert (cell['low'], cell['high'], cell['samples']) == (BINS[-2], 1.0, 400)
    assert two['classes'] == []
    # What the design says of the arm at rest: more where gravity says less.
    least = [t['least'] for t in one['threshold']]
    assert len(least) > 3
    assert least[0] > least[-1] > 0.0


# ------------------------------------------------------------------ stability, tracking


@pytest.mark.parametrize(('count', 'cells'), [(30, 2), (200, 6), (2000, 8)])
def test_given_few_runs_when_mapped_then_cells_are_few_enough_to_say_something(
    campaign, count, cells
):
    rng = np.random.default_rng(2)
    rows = [
        row(campaign, k, payload=p, friction=f, stable=p < 4.0)
        for k, (p, f) in enumerate(rng.uniform(0.0, 8.0, (count, 2)))
    ]
    (found,) = stability(results(campaign, rows))['maps']
    assert len(found['cells']) == cells


@pytest.mark.parametrize('count', [10, 200])
def test_given_runs_that_all_end_well_or_too_few_when_mapped_then_there_is_no_map(campaign, count):
    rows = [row(campaign, k, payload=k / 40.0, friction=1.0 + k % 7) for k in range(count)]
    found = stability(results(campaign, rows))
    assert found['maps'] == []
    assert draw_stability(found) is None


def test_given_a_map_when_drawn_then_labels_at_its_corners_do_not_meet(campaign):
    rng = np.random.default_rng(2)
    rows = [
        row(campaign, k, payload=p, friction=f, stable=p < 4.0, sample_loss=0.5 * (k % 2))
        for k, (p, f) in enumerate(rng.uniform(0.0, 8.0, (400, 2)))
    ]
    figure = draw_stability(stability(results(campaign, rows)))
    figure.canvas.draw()
    boxes = [
        text.get_window_extent()
        for axis in figure.axes
        for side in (axis.xaxis, axis.yaxis)
        for text in side.get_ticklabels()
        if axis.get_visible() and text.get_text()
    ]
    meeting = [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]
    plt.close(figure)
    assert meeting == []


def test_given_a_corner_of_unstable_runs_when_mapped_then_it_is_found(campaign):
    rng = np.random.default_rng(2)
    rows = []
    for k in range(2000):
        payload, friction = rng.uniform(0.0, 8.0, 2)
        if payload < 1.0 and friction < 1.0:
            continue
        corner = payload >= 6.0 and friction >= 4.0
        rows.append(
            row(
                campaign,
                k,
                payload=payload,
                friction=friction,
                stable=not corner,
                sample_loss=0.5 * (k % 2),
                safe_stops=3 * (payload < 1.0),
            )
        )
    found = stability(results(campaign, rows))
    assert {f['name'] for f in found['factors'][:2]} == {'payload', 'friction'}
    one = next(
        m for m in found['maps'] if {m['x']['name'], m['y']['name']} == {'payload', 'friction'}
    )
    rates = np.array(
        [[np.nan if c['rate'] is None else c['rate'] for c in line] for line in one['cells']]
    )
    going = np.array(
        [[np.nan if c['rate'] is None else c['rate'] for c in line] for line in one['going']]
    )
    if one['x']['name'] == 'friction':
        rates, going = rates.T, going.T
    wanted = np.ones((8, 8))
    wanted[4:, 6:] = 0.0
    wanted[0, 0] = np.nan
    assert np.array_equal(rates, wanted, equal_nan=True)
    wanted[1:, 0] = 0.0
    assert np.array_equal(going, wanted, equal_nan=True)
    assert sum(c['cases'] for line in one['cells'] for c in line) == len(rows)
    (loss,) = (f for f in found['factors'] if f['name'] == 'sample_loss')
    assert loss['levels'] == [0.0, 0.5]
    assert found['unstable'] == sum(not r['stable'] for r in rows)
    assert found['safe_stops'] == 3 * found['stopped'] > 0


def test_given_alarms_when_counted_then_hours_are_those_without_a_fault(campaign):
    # 10 s each; the fault acts from 4 s to 6 s.
    rows = [row(campaign, k) for k in range(180)]
    rows += [
        row(campaign, k, kind='bias', false_alarms=k % 2, alarms_before_1=int(k == 181))
        for k in range(180, 360)
    ]
    found = false_alarms(results(campaign, rows))
    assert found['hours'] == pytest.approx(180 * 18.0 / 3600.0)
    assert found['events'] == 90
    assert found['before']['events'] == 1
    assert found['before']['hours'] == pytest.approx(180 * 14.0 / 3600.0)
    assert found['after']['events'] == 89
    assert found['after']['hours'] == pytest.approx(180 * 4.0 / 3600.0)
    assert found['runs']['hits'] == 90


def test_given_a_fault_without_end_when_hours_are_counted_then_only_those_before_it_count(campaign):
    one = results(campaign, [row(campaign, 0, kind='bias', fault__duration=0.0)])
    assert one.healthy_hours[0] == pytest.approx(4.0 / 3600.0)
    assert one.faulty_time[0] == 6.0


def test_given_unstable_runs_when_tracking_is_shown_then_they_count_but_do_not_spoil_it(campaign):
    rows = [row(campaign, k, compensation='off', tracking_rms=0.001 * (k + 1)) for k in range(3)]
    rows.append(row(campaign, 3, compensation='off', tracking_rms=1e4, stable=False))
    rows.append(row(campaign, 4, kind='bias', tracking_ratio=1.5))
    off, bias = tracking(results(campaign, rows))
    assert (off['kind'], off['compensation'], off['runs']) == ('none', 'off', 4)
    assert off['rms']['median'] == 0.002
    assert off['stable']['hits'] == 3
    assert bias['ratio']['median'] == 1.5


# ------------------------------------------------------------------ worst runs, limit


def test_given_runs_when_the_worst_are_listed_then_each_has_its_command(campaign):
    rows = [row(campaign, k, tracking_max=0.001 * k) for k in range(20)]
    rows.append(row(campaign, 20, tracking_max=math.nan, stable=False))
    rows += [
        row(campaign, 21, kind='bias', fault__size=0.02),
        row(campaign, 22, kind='bias', fault__size=-0.9),
        row(campaign, 23, kind='bias', fault__size=1.0, detected=True, detection_delay=0.7),
        row(campaign, 24, false_alarms=3),
    ]
    lost, missed, slow, false = worst(results(campaign, rows), 'out/my results')
    assert [r['number'] for r in lost['runs']] == [20, 19, 18, 17, 16, 15, 14, 13, 12, 11]
    assert lost['runs'][0]['value'] is None
    assert [(r['number'], r['size']) for r in missed['runs']] == [(22, '0.9 rad'), (21, '0.02 rad')]
    assert [r['number'] for r in slow['runs']] == [23]
    assert [(r['number'], r['value']) for r in false['runs']] == [(24, 3.0)]
    assert lost['runs'][1]['command'] == (
        "lpv campaign 'out/my results' --run 19 --bag 'out/my results/bags/run_19'"
    )
    assert command('a', 3) == 'lpv campaign a --run 3 --bag a/bags/run_3'


def test_given_figures_of_the_limit_when_shown_then_squares_are_averaged_by_kind(campaign):
    rows = [
        row(campaign, k, limit_fault_ours=ours, limit_fault_limit_within_priors=1e-3)
        for k, ours in enumerate((1e-3, 7e-3, math.nan))
    ]
    rows.append(row(campaign, 3, kind='bias', limit_fault_ours=2e-3))
    healthy, bias = limit(results(campaign, rows))
    assert (healthy['kind'], healthy['runs'], bias['kind'], bias['runs']) == ('none', 2, 'bias', 1)
    assert healthy['rms']['ours'] == pytest.approx(5e-3)
    assert healthy['ratio'] == pytest.approx(5.0)
    assert bias['ratio'] is None and bias['rms']['ekf'] is None


# ------------------------------------------------------------------ the whole report


@pytest.fixture(scope='module')
def whole(campaign, tmp_path_factory):
    folder = tmp_path_factory.mktemp('whole')
    rows = [{**r, 'limit_fault_ours': 0.0125} for r in made_up(campaign)]
    return write_report(campaign, pa.Table.from_pylist(rows, schema=schema(campaign, rows)), folder)


def test_given_a_report_when_read_then_it_needs_nothing_from_elsewhere(whole):
    text = check_page(whole.html)
    assert text.count('<img') == 5  # no safe stops: no second map
    for heading in (
        'Detection against false alarms',
        'Isolation',
        'Comparison',
        'Limit of accuracy',
        'Runs that deserve a look',
    ):
        assert heading in text
    assert 'fault.onset: 4.0' in text  # the campaign file
    assert re.search(r'(\d+) of \1 checks hold', text)
    assert sorted(p.name for p in whole.html.parent.iterdir()) == ['report.html', 'report.json']


def test_given_a_report_when_its_numbers_are_read_then_they_are_those_of_the_page(whole):
    numbers = json.loads(whole.json.read_text(), parse_constant=lambda name: 1 / 0)
    assert numbers == whole.numbers
    assert all(map(math.isfinite, numbers_of(numbers)))
    assert numbers['head']['runs'] == 100
    assert numbers['head']['hours'] == pytest.approx(1000.0 / 3600.0)
    assert {c['kind'] for c in numbers['roc']['curves']} == {'bias', 'drift', 'stuck', 'all'}


@pytest.mark.parametrize(
    'make',
    [
        lambda c: [row(c, 0)],
        lambda c: [row(c, 0, kind='bias', fault__size=0.1)],
        lambda c: [row(c, k) for k in range(12)],
        lambda c: [row(c, k, kind='drift', fault__rate=0.1, sensor='both') for k in range(12)],
        lambda c: [{**dict.fromkeys(row(c, k)), 'number': k} for k in range(4)],
        lambda c: [{'number': 0}],
        lambda c: [
            row(
                c,
                k,
                tracking_max=math.inf,
                tracking_rms=math.inf,
                stable=False,
                score_before_1=math.inf,
                kind='bias',
                score_during_1=math.inf,
            )
            for k in range(4)
        ],
    ],
    ids=[
        'one healthy',
        'one fault',
        'no faults',
        'only faults',
        'nothing measured',
        'no columns',
        'infinities',
    ],
)
def test_given_little_to_report_when_reported_then_nothing_fails_and_nothing_is_nan(
    campaign, tmp_path, monkeypatch, make
):
    monkeypatch.setattr('lpv_campaign.report.write.embedded', lambda _: 'data:image/png;base64,')
    rows = make(campaign)
    table = pa.Table.from_pylist(rows, schema=schema(campaign, rows) if 'kind' in rows[0] else None)
    report = write_report(campaign, table, tmp_path)
    check_page(report.html)
    assert all(map(math.isfinite, numbers_of(json.loads(report.json.read_text()))))


def test_given_a_name_with_markup_when_reported_then_it_is_text(campaign, tmp_path, monkeypatch):
    monkeypatch.setattr('lpv_campaign.report.write.embedded', lambda _: 'data:image/png;base64,')
    gains = str(shipped_files('gains')['paper'])
    name = '"</style></title><script>x</script>{{ 7 * 7 }}'
    other = resolve({**SPEC, 'designs': [gains], 'name': name}, 'made_up', '.')
    rows = [row(campaign, 0)]
    table = pa.Table.from_pylist(rows, schema=schema(campaign, rows))
    text = check_page(write_report(other, table, tmp_path).html)
    assert '<script' not in text
    assert text.count('</style>') == 1


def test_given_ten_thousand_rows_when_their_numbers_are_computed_then_every_case_counts(campaign):
    rows = made_up(campaign, 400) * 25
    rows = [{**r, 'number': k} for k, r in enumerate(rows)]
    numbers = report_numbers(results(campaign, rows), 'here')
    assert sum(e['detected']['cases'] for e in numbers['detection']) == 7500
    assert sum(sum(line) for line in numbers['isolation']['kinds']['counts']) == 7500
    assert numbers['stability']['stable']['cases'] == 10_000


# ------------------------------------------------------------------ the command


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    """A small real campaign, run by the command."""
    folder = tmp_path_factory.mktemp('real')
    file, gains = folder / 'real.yaml', str(shipped_files('gains')['paper'])
    file.write_text(json.dumps({**REAL, 'designs': [gains]}))
    assert main(['campaign', str(file), '--out', str(folder / 'out'), '--workers', '0']) == 0
    return file, folder / 'out'


def test_given_a_real_campaign_when_run_then_its_report_is_written(finished):
    text = check_page(finished[1] / 'report.html')
    numbers = json.loads((finished[1] / 'report.json').read_text())
    assert numbers['head']['runs'] == 6
    assert numbers['stability']['stable']['rate'] == 1.0
    assert sum(e['detected']['cases'] for e in numbers['detection']) == 4
    one = next(c for c in numbers['roc']['curves'] if c['kind'] == 'bias')
    assert one['shipped']['detection']['rate'] == 1.0
    assert f'lpv campaign {finished[1]} --run' in text


def test_given_a_real_campaign_when_run_then_its_figures_of_single_sensors_fit_the_others(finished):
    rows = CampaignFolder(finished[1]).table().to_pylist()
    assert {r['kind'] for r in rows} == {'none', 'bias', 'stuck'}
    for r in rows:
        assert (r['found_1'], r['found_2']) == (r['detected'], False)  # sensor 1 is faulty
        assert r['alarms_before_1'] + r['alarms_before_2'] <= r['false_alarms']


def test_given_a_folder_of_results_when_the_command_is_run_then_only_the_report_is_written(
    finished, capsys
):
    results_file, report = finished[1] / 'runs.parquet', finished[1] / 'report.json'
    before, content = results_file.stat().st_mtime_ns, report.read_bytes()
    report.unlink()
    assert main(['campaign', str(finished[1])]) == 0
    assert report.read_bytes() == content
    assert results_file.stat().st_mtime_ns == before
    said = capsys.readouterr().out
    assert 'missing' not in said
    assert 'report.html' in said


def test_given_unfinished_results_when_reported_then_it_says_how_many_runs_are_missing(
    finished, tmp_path, capsys
):
    whole = CampaignFolder(finished[1])
    part = CampaignFolder(tmp_path / 'part')
    campaign = whole.load()
    part.begin(campaign)
    part.add(campaign, whole.table().to_pylist()[:4])
    assert main(['campaign', str(part.path)]) == 0
    assert '2 of 6 runs are missing' in capsys.readouterr().out
    assert '2 of 6 runs are missing' in check_page(part.path / 'report.html')
    assert not part.runs_file.exists()  # it can go on


def test_given_no_report_is_wanted_when_run_then_there_is_none(finished, tmp_path):
    assert (
        main(
            [
                'campaign',
                str(finished[0]),
                '--out',
                str(tmp_path / 'out'),
                '--workers',
                '0',
                '--no-report',
            ]
        )
        == 0
    )
    assert not (tmp_path / 'out' / 'report.html').exists()


def test_given_a_folder_and_another_one_when_the_command_is_run_then_it_is_refused(
    finished, tmp_path, capsys
):
    assert main(['campaign', str(finished[1]), '--out', str(tmp_path / 'out')]) == 2
    assert capsys.readouterr().err.startswith('lpv campaign: --out')


def test_given_a_folder_without_a_campaign_when_the_command_is_run_then_one_line_says_so(
    tmp_path, capsys
):
    assert main(['campaign', str(tmp_path)]) == 2
    assert capsys.readouterr().err.count('\n') == 1


@pytest.mark.parametrize('name', ['smoke', 'thresholds', 'robustness'])
def test_given_a_shipped_campaign_when_read_by_its_name_then_it_is_valid(name):
    from lpv_campaign.plan.spec import load_spec
    from lpv_core.support.resources import bringup_file

    spec = load_spec(bringup_file('campaigns', name))
    assert spec.name == name
    assert spec.runs >= 30


def test_given_an_unknown_campaign_when_named_then_the_shipped_ones_are(capsys):
    assert main(['campaign', 'nothing']) == 2
    said = capsys.readouterr().err
    assert 'smoke' in said
    assert said.count('\n') == 1
