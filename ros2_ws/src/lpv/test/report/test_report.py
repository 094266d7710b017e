import base64
import hashlib
import html
import io
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from nested import changed
from places import BRINGUP
from runs import ALL, MEASURED, assert_stands_alone, copied, record, rows, text
from serial_bags import crane, crane_run, record_crane

from lpv import Fault, load_arm, save_gains
from lpv.bag.run.record import load_run, node_reports
from lpv.core.serial_arm.arm_file import save_arm
from lpv.report.certificate import beside_bag, examine
from lpv.report.figures import draw_region
from lpv.report.history import load
from lpv.report.page import css_string
from lpv.report.run import write as write_report
from lpv_design.guarantee import guarantee

pytestmark = pytest.mark.slow

ARM_FILE = str(BRINGUP / 'arms' / 'paper.yaml')
SCENARIO = str(BRINGUP / 'scenarios' / 'two_faults.yaml')
PAPER = {'x1': 0.006, 'x2': 0.002, 'x3': 0.024, 'x4': 0.047, 'f1': 0.006, 'f2': 0.002,
         'y1': 0.034, 'y2': 0.053, 'e_t1': 0.003, 'e_t2': 0.007}  # fmt: skip
LARGE = Fault('encoder2', 'bias', 0.6, size=0.05)
FORGED = 'gains file: numbers are those of the design'
"""The check that the checksum of a changed file fails."""


@pytest.fixture(scope='module')
def run(paper_arm, paper_gains, two_faults, tmp_path_factory):
    """A bag of all streams, without gains; every test of this file looks at it.  1.5 s with a fault
    of sensor 1 from 0.8 s on, and sensor 2 silent for a while."""
    bias = Fault('link1_angle', 'bias', 0.8, size=0.3)
    silence = Fault('link2_angle', 'dropout', 1.3, duration=0.02)
    scenario = replace(two_faults, duration=1.5, faults=(bias, silence))
    return record(tmp_path_factory.mktemp('run') / 'bag', paper_arm, paper_gains, scenario)


@pytest.fixture
def bag(run, tmp_path):
    return shutil.copytree(run, tmp_path / 'bag')


@pytest.fixture(scope='module')
def gains_file(paper_gains, tmp_path_factory):
    path = tmp_path_factory.mktemp('gains') / 'my_gains.yaml'
    save_gains(paper_gains, path, 'made by a test')
    return path


@pytest.fixture(scope='module')
def loaded(run, gains_file, paper_arm):
    return load(run, paper_arm, SCENARIO, 'A run', gains_file)


@pytest.fixture(scope='module')
def report(loaded, tmp_path_factory):
    return write_report(loaded, tmp_path_factory.mktemp('report') / 'new' / 'folder')


@pytest.fixture(scope='module')
def page(report):
    return report.read_text(encoding='utf-8')


def pictures(report):
    return {path.stem for path in report.parent.glob('*.png')}


@pytest.fixture
def plain(monkeypatch):
    """Leave the pictures out: drawing takes a second a run."""
    monkeypatch.setattr('lpv.report.page.picture', lambda *_: b'')


@pytest.fixture
def page_of(plain, paper_arm, tmp_path):
    def write(bag, *given, **options):
        page = write_report(load(bag, paper_arm, *given, **options), tmp_path / 'report')
        return page.read_text(encoding='utf-8')

    return write


def part_of(bag, out, streams, name=b'paper\0'):
    """The bag with some streams, as another arm's node would have published it."""
    kept = {f'/lpv/{stream}' for stream in streams}
    return copied(bag, out, kept.__contains__, lambda _, data: data.replace(b'paper\0', name))


def test_given_a_simulated_run_when_reported_then_the_table_is_that_of_the_paper(loaded, page, run):
    recorded, figures = load_run(run), []  # of absolute angles, of sensors, of the tracking
    for stream, field, other, of_other in (
        ('ground_truth', 'position', 'state_estimate', 'position'),
        ('ground_truth', 'velocity', 'state_estimate', 'velocity'),
        ('ground_truth', 'fault', 'fault_estimate', 'estimate'),
        ('reference', 'position', 'joint_states', 'position'),
        ('reference', 'position', 'ground_truth', 'position'),
    ):
        error = recorded.aligned(stream, field) - recorded.aligned(other, of_other)
        error = error if field == 'fault' else np.cumsum(error, axis=1)
        figures += np.nanmean(error**2, axis=0).tolist()
    expected = dict(zip(PAPER, figures))
    assert {row.signal: row.paper for row in loaded.table} == PAPER
    found = {cells[0]: cells for cells in rows(page) if cells[0] in PAPER}
    for row in loaded.table:
        assert row.value == pytest.approx(expected[row.signal], rel=1e-9)
        assert found[row.signal][3] == f'{row.value:.2g}'
    assert not re.search('(?i)[+-]?nan|inf', ' '.join(sum(rows(page), []))), 'a dropout has none'


def test_given_a_report_when_written_then_it_stands_alone_and_can_be_printed(report, page):
    assert_stands_alone(page)
    style = re.search('<style>(.*)</style>', page, re.DOTALL).group(1)
    _, printed = style.split('@media print', 1)
    for rule in ('break-inside: avoid', 'break-after: avoid', 'display: table-header-group',
                 '--ink: #000', '--paper: #fff'):  # fmt: skip
        assert rule in printed
    for rule in ('@page { size: A4;', '@top-left { content: "A\\000020run"', 'counter(page)'):
        assert rule in style
    names = ['timeline', 'path', 'faults', 'measured', 'states', 'torques']
    inside = [base64.b64decode(data) for data in re.findall(r'base64,([^"]*)"', page)]
    assert inside == [(report.parent / f'{name}.png').read_bytes() for name in names]
    for name, data in zip(names, inside):
        pixels = matplotlib.image.imread(io.BytesIO(data), format='png')
        assert min(pixels.shape[:2]) > (400 if name != 'timeline' else 200)
        assert pixels[..., :3].std() > 0.01  # not an empty sheet
    assert sorted(p.name for p in report.parent.iterdir()) == sorted(
        ['report.html', *(f'{n}.png' for n in names)])  # fmt: skip


def test_given_a_fault_that_is_found_when_reported_then_onset_alarm_and_delay_are_listed(page, run):
    found = load_run(run)
    alarms = [a for a in found.alarms if a.sensor == 'link1_angle']
    line, *_, other = (cells[1:] for cells in rows(page) if cells[0] == 'link1_angle')
    onset, detected = found.seconds(alarms[0].onset), found.seconds(alarms[0].detected)
    assert onset == pytest.approx(0.8, abs=0.003)
    times = [f'{onset:.3f}', f'{detected:.3f}', f'{detected - 0.8:.3f}', 'active']
    estimate = found.get('fault_estimate', 'estimate')[-1, 0]
    now = f'{estimate:+.3f}'  # not at its alarm
    assert line[:7] == [alarms[-1].kind, *times, 'rad', now]
    assert float(line[8]) == pytest.approx(0.3, abs=0.1)
    certain = sum(found.get('fault_estimate', name) for name in ('threshold', 'bound'))[:, 0]
    figures = certain.min(), np.median(certain), certain.max()
    assert other == ['rad', *(f'{figure:.3f}' for figure in figures), '0.0 %'], 'surely detected'
    assert 'no false alarms' in text(page) and 'false alarm' not in sum(rows(page), [])
    assert '1.5 s of measurements' in text(page)
    counts = dict(cells for cells in rows(page) if cells[0].startswith('/'))
    assert counts['/lpv/joint_states'] == counts['/lpv/ground_truth'] == '751'
    assert {f'/lpv/{name}' for name in ALL} <= set(counts)
    assert 'observer' in node_reports(run, '/lpv') and node_reports(run, '/other') == {}


def test_given_a_title_with_markup_when_reported_twice_then_it_is_text(run, page_of, gains_file):
    title = '<script>alert("x")</script> a & b < c {{ 7 * 7 }} %s'
    page = page_of(run, title=title, gains=gains_file)
    assert page_of(run, title=title, gains=gains_file) == page
    for tag in ('title', 'h1'):
        (inside,) = re.findall(f'<{tag}>(.*?)</{tag}>', page, re.DOTALL)
        assert '<' not in inside and html.unescape(inside) == title


@given(st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs'])))
@example('"; } body { display: none } "')
@example('</style><b>')
def test_given_any_title_when_it_goes_into_the_style_sheet_then_it_stays_a_string(title):
    inside = css_string(title)[1:-1]
    assert re.fullmatch(r'(?:[0-9A-Za-z]|\\[0-9a-f]{6})*', inside)
    assert re.sub(r'\\([0-9a-f]{6})', lambda m: chr(int(m.group(1), 16)), inside) == title


def test_given_no_truth_when_reported_then_estimates_are_listed(run, paper_arm, page_of, tmp_path):
    bag = part_of(run, tmp_path / 'part', MEASURED)
    table, recorded = load(bag, paper_arm).table, load_run(bag)
    later = recorded.get('fault_estimate', 'estimate')[recorded.time > 1.0]
    names = ['link1_angle'] * 2 + ['link2_angle'] * 2
    assert [(row.signal, row.paper) for row in table] == [(name, None) for name in names]
    assert [row.value for row in table[::2]] == np.nanmax(np.abs(later), axis=0).tolist()
    rms = np.sqrt(np.nanmean(later**2, axis=0))
    assert [row.value for row in table[1::2]] == pytest.approx(rms, rel=1e-12)
    page = page_of(bag)
    assert 'false alarm' not in text(page)
    line = next(cells for cells in rows(page) if cells[0] == 'link1_angle')
    assert len(line) == 10  # no delay without a true onset


@pytest.mark.parametrize('streams, missing', [
    ({'joint_states'}, {'timeline', 'faults', 'states'}),
    ({'joint_states', 'fault_estimate'}, {'states'}),
    ({'joint_states', 'state_estimate'}, {'timeline', 'faults'}),
    (ALL - {'reference'}, set()),
    (ALL - {'state_estimate'}, {'states'}),
    (ALL - {'fault_estimate'}, {'timeline', 'faults'}),
    ({'joint_states', 'ground_truth'}, {'timeline', 'faults', 'states'}),
], ids=lambda value: ' '.join(sorted(value)))  # fmt: skip
def test_given_a_run_without_some_topics_when_reported_then_what_is_there_is_shown(
    run, paper_arm, report, tmp_path, monkeypatch, streams, missing
):
    monkeypatch.setattr(Figure, 'savefig', lambda _, file, **options: file.write(b'drawn'))
    part = part_of(run, tmp_path / 'part', streams)
    found = load(part, paper_arm)
    written = write_report(found, tmp_path / 'report')
    assert pictures(written) == pictures(report) - missing
    page = written.read_text(encoding='utf-8')
    assert page.count('<figure>') == len(pictures(written))
    if streams == ALL - {'reference'}:
        assert [row.signal for row in found.table] == list(PAPER)[:6], 'no tracking'
    if streams == {'joint_states'}:
        assert 'Alarms were not recorded; no safe stops' in text(page)
        assert 'Not known: the bag holds no fault estimates.' in text(page)
        assert 'Diagnostics were not recorded' in text(page)


def test_given_gains_then_margins_and_all_is_told(loaded, page, gains_file, paper_arm, paper_gains):
    assert loaded.certificate.holds
    facts = dict(cells for cells in rows(page) if len(cells) == 2)
    known = {
        'gains file': 'my_gains.yaml', 'designed for arm': 'paper',
        'SHA-256 of the file': hashlib.sha256(gains_file.read_bytes()).hexdigest(),
        'numpy': np.__version__, 'matplotlib': matplotlib.__version__,
    }  # fmt: skip
    assert facts.items() >= known.items() and {'lpv', 'Python', 'rosbags', 'mcap'} <= set(facts)
    limit = np.degrees(np.arccos(paper_arm.lpv.cos_min[0]))
    margins = {cells[0]: cells[1:] for cells in rows(page) if cells[-1] in ('yes', 'NO')}
    for told in (
        f'certified region: links within {limit:.1f}°',
        f'estimation error {paper_gains.observer.decay:g} /s',
        f'{len(margins)} of {len(margins)} inequalities hold',
        'no healthy arm within the stated errors crosses its threshold',
    ):
        assert told in text(page)
    designed = paper_gains.certificate['margins'].items()
    known = {name: [f'{margin:.3g}', 'yes'] for name, margin in designed}
    assert margins == {**known, FORGED: margins[FORGED]}


def test_given_a_bag_when_reported_then_its_gains_are_found(bag, gains_file, page_of, tmp_path):
    shutil.copy(gains_file, bag / 'gains.yaml')
    for path in (bag, bag / 'bag.mcap'):
        page = page_of(path)
        assert 'The certificate holds.' in text(page)
        assert ['gains file', 'gains.yaml of the bag'] in rows(page)
    shutil.copy(bag / 'bag.mcap', tmp_path / 'other.mcap')
    shutil.copy(gains_file, tmp_path / 'gains.yaml')
    assert beside_bag(tmp_path / 'other.mcap', 'gains.yaml') is None, 'a file among others'


def tampered(gains_file, change, path):
    """A gains file with the arm or a number changed by hand."""
    data, part = yaml.safe_load(gains_file.read_text()), '/**.ros__parameters.gains.'
    named = change == 'name'
    field, value = ('arm_sha256', 'f' * 64) if named else ('observer.kappa[0]', change.__mul__)
    path.write_text(yaml.safe_dump(changed(data, part + field, value)))
    return path


FAILS = f'The certificate does NOT hold. What fails: {FORGED}'


@pytest.mark.parametrize('change, says', [
    (None, 'guaranteed: the bag carries no gains, and none were given.'),
    (30.0, f'{FAILS}; observer, link 1'),
    (1.01, FAILS),
    ('name', 'designed for another arm'),
    *((rubbish, 'gains.yaml') for rubbish in (b'', b'gains: 1', b'\xff\xfe\x00', b'[1, 2')),
])  # fmt: skip
def test_given_bad_gains_when_reported_then_no_guarantee(bag, gains_file, page_of, change, says):
    if isinstance(change, bytes):
        (bag / 'gains.yaml').write_bytes(change)
    elif change:
        tampered(gains_file, change, bag / 'gains.yaml')
    said, unknown = text(page_of(bag)), not isinstance(change, float)
    assert says in said
    for never in ('The certificate holds', 'no healthy arm within the stated errors'):
        assert never not in said
    assert ('certificate of the gains unknown' in said) == unknown
    assert ('Not known, and nothing that follows from it is guaranteed' in said) == unknown
    assert change or 'bounds and thresholds are statistical' in said


def test_given_gains_when_examined_or_drawn_then_all_is_there(paper_model, paper_gains, tmp_path):
    arm, region = load_arm('ur10'), 'gains are designed for its region'
    for gains, problem in (('ur10', ''), ('panda', 'another arm'), ('paper', region)):
        found = examine(BRINGUP / 'gains' / f'{gains}.yaml', arm)
        assert found.holds == (not problem) and problem in found.problem and not found.bounds_faults
    found = guarantee(paper_model, paper_gains, points=5)
    draw_region(found, paper_model, tmp_path / 'a' / 'map.png')
    assert (tmp_path / 'a' / 'map.png').read_bytes().startswith(b'\x89PNG')


def test_given_three_joints_when_reported_then_names_like_markup_and_alarms_are_there(
    tmp_path, call
):
    name, report = 'a[/b] \u8098 [red]$x_{1$', tmp_path / 'report' / 'report.html'
    sensors = (replace(j.sensors, name=f'{name}{j.name}') for j in crane().joints)
    joints = tuple(replace(j, sensors=s) for j, s in zip(crane().joints, sensors))
    save_arm(replace(crane(), joints=joints), tmp_path / 'arm.yaml')
    measured = record_crane(tmp_path / name[-5:], crane_run(faults=[LARGE]))
    files = ['--arm', tmp_path / 'arm.yaml', '--out', tmp_path / '[out]']
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        said = call('replay', measured, *files, '--report', report.parent).out
    assert f'ALARM, {name}joint2: ' in said and f'{tmp_path}/[out]\n' in said
    page = report.read_text()
    assert len(pictures(report)) == 6
    assert [f'{name}joint2', 'bias'] in [row[:2] for row in rows(page)]
    for said in (f'1 alarm, of {name}joint2', 'bounds and thresholds are statistical',
                 'joint1, joint2, joint3', 'the bag carries no gains, and none'):  # fmt: skip
        assert said in text(page)
    assert 'Mean squared errors (MISE, eq. (70))' not in text(page)


def test_given_a_browser_when_it_prints_then_all_is_there_in_black_on_white(report, browser):
    asked, complaints, page = [], [], browser.new_page()
    page.set_viewport_size({'width': 1100, 'height': 900})
    page.emulate_media(color_scheme='dark')
    page.on('request', lambda request: asked.append(request.url))
    page.on('console', lambda message: complaints.append(message.text))
    page.goto(report.as_uri())
    widths = page.evaluate('[...document.images].map(i => i.naturalWidth)')
    page.emulate_media(media='print')
    look = page.evaluate("""() => {
        const body = getComputedStyle(document.body);
        return [body.color, body.backgroundColor,
                getComputedStyle(document.querySelector('nav')).display,
                document.documentElement.scrollWidth <= innerWidth]}""")
    pdf = page.pdf(prefer_css_page_size=True)
    page.close()
    assert len(widths) == 6 and min(widths) > 1000
    assert [url for url in asked if not url.startswith('data:')] == [report.as_uri()]
    assert complaints == [] and look == ['rgb(0, 0, 0)', 'rgb(255, 255, 255)', 'none', True]
    boxes = re.findall(rb'/MediaBox\s*\[([^\]]*)\]', pdf)
    assert 4 <= len(boxes) <= 8
    for box in boxes:
        assert list(map(float, box.split()[2:])) == pytest.approx([595.3, 841.9], abs=1.5)  # A4


def test_given_the_command_when_run_then_a_table_is_shown(run, gains_file, plain, tmp_path, call):
    line = ['report', run, '--out', tmp_path / 'report']
    said = call(*line, '--arm', ARM_FILE, '--scenario', SCENARIO).out
    assert 'e_t2' in said and str(tmp_path / 'report' / 'report.html') in said
    assert 'certificate not known: the bag carries no gains' in said
    # Without an arm it is that of the gains.
    assert 'my_gains.yaml: the certificate holds' in call(*line, '--gains', gains_file).out
    assert 'bag, arm “paper”' in (tmp_path / 'report' / 'report.html').read_text()
    said = call(*line, '--gains', tampered(gains_file, 30.0, tmp_path / 'gains.yaml')).out
    fails = f'the certificate does NOT hold: {FORGED}; observer, link 1'
    assert fails in ' '.join(said.split())


def test_given_bad_input_when_run_then_it_is_said(run, gains_file, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    shutil.copy(gains_file, 'gains.yaml')
    tampered(gains_file, 'name', tmp_path / 'renamed.yaml')
    mine = tmp_path / 'mine'
    mine.write_text('mine')
    renamed = Path(ARM_FILE).read_text().replace('joint2', 'elbow')
    (tmp_path / 'renamed_joint.yaml').write_text(renamed)
    for bag, changes, named in (
        ('nothing', '', 'nothing: there is no such bag'),
        ('.', '', 'metadata.yaml'),
        (run, '--arm unknown_arm', 'is neither a file nor shipped'),
        (run, '--arm nothing.yaml', 'is neither a file nor shipped'),
        (run, '--scenario unknown_scenario', 'is neither a file nor shipped'),
        (run, f'--arm {SCENARIO}', 'two_faults.yaml'),
        (run, '--arm renamed_joint.yaml', "'elbow' is not in joint_states, which has joint1"),
        (run, '--scenario ur10', 'waypoints[0]'),
        (run, f'--scenario {ARM_FILE}', 'paper.yaml'),
        (run, '--gains nothing.yaml', 'nothing.yaml'),
        (run, '--gains renamed.yaml', 'designed for another arm'),
        (run, '--gains gains.yaml --arm real_arm', 'designed for another arm'),
        (run, '--out mine', 'mine'),
    ):
        usual = ['--arm', ARM_FILE, '--out', 'report']
        assert refused(named, 'report', bag, *usual, *changes.split())
        assert not (tmp_path / 'report').exists() and mine.read_text() == 'mine'


def test_given_no_arm_when_run_then_one_is_sought(run, plain, tmp_path, monkeypatch, call, refused):
    shipped, out = 'lpv.report.certificate.shipped_files', ['--out', tmp_path / 'report']
    monkeypatch.setattr(shipped, lambda kind: {'paper': BRINGUP / kind / 'paper.yaml'})
    said = call('report', run, *out).out
    assert "shipped gains of arm 'paper', which the messages name" in said
    assert 'the certificate holds' in said
    other = part_of(run, tmp_path / 'other', ALL, b'mine!\0')
    for line in (['report', other], ['compare', other, run]):
        told = "the bag is of arm 'mine!', which is not a shipped one; e.g. --arm mine!.yaml"
        assert refused(told, *line, *out)
