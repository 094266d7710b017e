"""Reports: certificate and versions, detectability, phases, and the printed page."""

import hashlib
import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from places import BRINGUP
from runs import Recorder, record, rows, text

from lpv_bag.rosbag.reading import open_bag
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.serial_arm.diagnosis.alarms import SensorState
from lpv_core.simulation.faults import Fault
from lpv_core.support.timestamps import NANOSECONDS
from lpv_core.uio.certificate.gains import save_gains
from lpv_design.guarantee import guarantee
from lpv_report.certificate import beside_bag
from lpv_report.figures import draw_region
from lpv_report.history import Phase, listed
from lpv_report.page import css_string
from lpv_report.run import load, write_report

pytestmark = pytest.mark.slow

BROWSER = os.environ.get('CHROMIUM') or shutil.which('chromium') or shutil.which('chromium-browser')
SHA = 64


@pytest.fixture(scope='module')
def scenario(two_faults):
    """1 s with a fault of sensor 1 from 0.5 s on."""
    return replace(two_faults, duration=1.0, faults=(Fault('link1_angle', 'bias', 0.5, size=0.3),))


@pytest.fixture(scope='module')
def foreign(paper_arm, paper_gains, scenario, tmp_path_factory):
    """A bag without gains."""
    return record(tmp_path_factory.mktemp('run') / 'bag', paper_arm, paper_gains, scenario)


@pytest.fixture
def bag(foreign, tmp_path):
    """The same bag in a place of its own."""
    return shutil.copytree(foreign, tmp_path / 'bag')


@pytest.fixture(scope='module')
def gains_file(paper_gains, tmp_path_factory):
    path = tmp_path_factory.mktemp('gains') / 'my_gains.yaml'
    save_gains(paper_gains, path, 'made by a test')
    return path


@pytest.fixture(scope='module')
def report(foreign, gains_file, paper_arm, scenario, tmp_path_factory):
    return write_report(
        foreign,
        tmp_path_factory.mktemp('report'),
        paper_arm,
        scenario.path(paper_arm),
        'A run',
        gains_file,
    )


def plain(monkeypatch):
    """Leave the pictures out: other tests look at them."""
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])


def page_of(*given, **options):
    return write_report(*given, **options).html.read_text(encoding='utf-8')


# ------------------------------------------------------------------ certificate and versions


def test_given_gains_when_reported_then_arm_region_and_every_margin_are_told(
    report, gains_file, paper_arm, paper_gains
):
    page = report.html.read_text(encoding='utf-8')
    assert report.certificate.holds
    facts = {cells[0]: cells[1] for cells in rows(page) if len(cells) == 2}
    assert facts['gains file'] == 'my_gains.yaml'
    assert facts['SHA-256 of the file'] == hashlib.sha256(gains_file.read_bytes()).hexdigest()
    assert facts['designed for arm'] == 'paper'
    limit = np.degrees(np.arccos(paper_arm.lpv.cos_min[0]))
    assert f'certified region: links within {limit:.1f}°' in text(page)
    assert f'estimation error {paper_gains.observer.decay:g} /s' in text(page)
    listed_ = {cells[0]: cells[1:] for cells in rows(page) if cells[-1] in ('yes', 'NO')}
    whole = 'gains file: numbers are those of the design'
    assert set(listed_) == {*paper_gains.certificate['margins'], whole}
    for name, margin in paper_gains.certificate['margins'].items():
        assert listed_[name] == [f'{margin:.3g}', 'yes']
    assert f'{len(listed_)} of {len(listed_)} inequalities hold' in text(page)
    assert 'no healthy arm within the stated errors crosses its threshold' in text(page)


def test_given_a_report_when_read_then_the_versions_of_the_software_are_there(report):
    import matplotlib

    versions = dict(cells for cells in rows(report.html.read_text()) if len(cells) == 2)
    assert versions['numpy'] == np.__version__
    assert versions['matplotlib'] == matplotlib.__version__
    assert {'lpv_cli', 'Python', 'rosbags', 'mcap'} <= set(versions)


def test_given_a_bag_without_gains_when_reported_then_it_says_so_and_claims_nothing(
    bag, paper_arm, tmp_path, monkeypatch
):
    plain(monkeypatch)
    report = write_report(bag, tmp_path / 'report', paper_arm)
    said = text(report.html.read_text(encoding='utf-8'))
    assert not report.certificate.holds
    assert 'guaranteed: the bag carries no gains, and none were given.' in said
    assert 'certificate of the gains unknown' in said
    assert 'The certificate holds' not in said
    assert 'bounds and thresholds are statistical' in said


def test_given_gains_in_the_bag_when_reported_then_they_are_found(
    bag, gains_file, paper_arm, tmp_path, monkeypatch
):
    plain(monkeypatch)
    shutil.copy(gains_file, bag / 'gains.yaml')
    for path in (bag, bag / 'bag.mcap'):
        page = page_of(path, tmp_path / 'report', paper_arm)
        assert 'The certificate holds.' in text(page)
        assert ['gains file', 'gains.yaml of the bag'] in rows(page)


def tampered(gains_file, change, path):
    """A gains file with one thing changed by hand."""
    data = yaml.safe_load(gains_file.read_text())
    change(data['/**']['ros__parameters']['gains'])
    path.write_text(yaml.safe_dump(data))
    return path


FORGED = 'gains file: numbers are those of the design'
"""The check that the checksum of a changed file fails."""


def _weaker(gains):
    gains['observer']['kappa'][0] *= 30.0


def _retuned(gains):
    gains['observer']['kappa'][0] *= 1.01


def _renamed(gains):
    gains['arm_sha256'] = 'f' * SHA


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        (_weaker, f'The certificate does NOT hold. What fails: {FORGED}; observer, link 1'),
        (_retuned, f'The certificate does NOT hold. What fails: {FORGED}'),
        (_renamed, 'designed for another arm'),
    ],
)
def test_given_a_gains_file_that_was_tampered_with_when_reported_then_nothing_is_guaranteed(
    bag, gains_file, paper_arm, tmp_path, monkeypatch, change, says
):
    plain(monkeypatch)
    tampered(gains_file, change, bag / 'gains.yaml')
    report = write_report(bag, tmp_path / 'report', paper_arm)
    said = text(report.html.read_text(encoding='utf-8'))
    assert not report.certificate.holds
    assert says in said
    assert 'The certificate holds' not in said
    assert 'no healthy arm within the stated errors' not in said


@pytest.mark.parametrize('content', [b'', b'gains: 1', b'\xff\xfe\x00', b'[1, 2'])
def test_given_rubbish_in_the_place_of_the_gains_when_reported_then_the_run_is_shown_all_the_same(
    bag, paper_arm, tmp_path, monkeypatch, content
):
    plain(monkeypatch)
    (bag / 'gains.yaml').write_bytes(content)
    said = text(page_of(bag, tmp_path / 'report', paper_arm))
    assert 'gains.yaml' in said and 'nothing that follows from it is guaranteed' in said
    assert 'certificate of the gains unknown' in said


def test_given_a_single_file_among_others_when_gains_lie_there_then_they_are_not_taken(
    bag, gains_file, tmp_path
):
    shutil.copy(bag / 'bag.mcap', tmp_path / 'other.mcap')
    shutil.copy(gains_file, tmp_path / 'gains.yaml')
    assert beside_bag(tmp_path / 'other.mcap', 'gains.yaml') is None


# ------------------------------------------------------------------ detectability


def test_given_a_run_when_reported_then_threshold_plus_bound_is_what_is_surely_detected(
    report, foreign
):
    recorded = load_run(foreign)
    certain = sum(recorded.get('fault_estimate', name) for name in ('threshold', 'bound'))[:, 0]
    line = [cells for cells in rows(report.html.read_text()) if cells[0] == 'link1_angle'][-1]
    assert line[1:] == [
        f'{certain.min():.3f}',
        f'{np.median(certain):.3f}',
        f'{certain.max():.3f}',
        '0.0 %',
    ]


# ------------------------------------------------------------------ phases


MS = 1_000_000
CONFUSED = 'inconsistent, cause unknown: rates, torques and model contradict each other'


def made_up(path, lost=(), stopped=(), reports=(), name='/lpv/uio: observer'):
    """1 s of every 10 ms: not diagnosable, stopped [ms], and what the observer says [ms]."""
    streams = {'joint_states', 'fault_estimate', 'torque_command', 'state_estimate'}
    with Recorder(path, streams) as bag:
        bag._writer.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        for time in range(0, 1010, 10):
            stamp = NANOSECONDS + time * MS
            state = (
                SensorState.NOT_DIAGNOSABLE
                if any(a <= time < b for a, b in lost)
                else SensorState.OK
            )
            bag.measure(stamp, [1.0, 0.2], [0.0, 0.0], [0.0, 0.0])
            bag.stream(
                'fault_estimate',
                stamp,
                sensor_names=['left', 'right'],
                estimate=[0.0, 0.0],
                bound=[0.1, 0.1],
                threshold=[0.1, 0.1],
                state=[state, SensorState.OK],
                alarm=[False, False],
            )
            bag.stream(
                'torque_command',
                stamp,
                torque=[0.0, 0.0],
                safe_stop=any(a <= time < b for a, b in stopped),
            )
            bag.stream(
                'state_estimate',
                stamp,
                position=[1.0, 0.2],
                velocity=[0.0, 0.0],
                compensated_position=[1.0, 0.2],
                measured_position=[1.0, 0.2],
                measured_velocity=[0.0, 0.0],
                mode=2 if time == 0 else 0,
                trustworthy=True,
            )
        for time, message in reports:
            bag._writer.write(
                '/diagnostics',
                NANOSECONDS + time * MS,
                bag._messages.diagnostics(
                    NANOSECONDS + time * MS,
                    [
                        {
                            'level': 1,
                            'name': name,
                            'message': message,
                            'hardware_id': 'paper',
                            'values': {},
                        },
                        {
                            'level': 1,
                            'name': '/lpv/uio: left',
                            'message': CONFUSED,
                            'hardware_id': 'left',
                            'values': {},
                        },
                    ],
                ),
            )
    return path


def test_given_stops_contradictions_and_lost_sensors_when_reported_then_each_has_its_stretch(
    paper_arm, tmp_path, monkeypatch
):
    plain(monkeypatch)
    path = made_up(
        tmp_path / 'bag',
        lost=[(0, 10), (200, 300)],
        stopped=[(400, 700)],
        reports=[(100, 'observing'), (500, CONFUSED), (600, CONFUSED), (800, 'observing')],
    )
    assert load(path, paper_arm).phases == [
        Phase('not diagnosable', 'link1_angle', 0.2, 0.3),
        Phase('safe stop', '', 0.4, 0.7),
        Phase('inconsistent', '', 0.5, 0.8),
    ]
    page = page_of(path, tmp_path / 'report', paper_arm)
    assert [
        'safe stop',
        'arm',
        '0.400',
        '0.700',
        '0.300',
        'the tracker commanded the drives to brake',
    ] in rows(page)
    assert 'Alarms were not recorded; 1 safe stop, 1 inconsistent phase.' in text(page)
    assert 'come once a second' in text(page)
    line = [cells for cells in rows(page) if cells[0] == 'link1_angle'][-1]
    assert line[-1] == f'{100 * 10 / 101:.1f} %'


def test_given_the_reports_of_another_arm_when_reported_then_they_are_not_taken_for_ours(
    paper_arm, tmp_path
):
    path = made_up(tmp_path / 'bag', reports=[(500, CONFUSED)], name='/other/uio: observer')
    assert load(path, paper_arm).phases == []


def test_given_hundreds_of_stretches_when_listed_then_the_longest_are_shown_and_all_are_counted():
    many = [Phase('no data', 'left', float(k), k + 0.1 + (k == 50)) for k in range(100)]
    shown, (rest,) = listed([*many, Phase('safe stop', '', 3.0, 4.0)])
    assert len(shown) == 9
    assert many[50] in shown
    assert (rest['what'], rest['sensor'], rest['count']) == ('no data', 'left', 92)
    assert sum(p.duration for p in shown if p.what == 'no data') + rest[
        'duration'
    ] == pytest.approx(sum(p.duration for p in many))


def test_given_nothing_to_tell_when_reported_then_it_says_so(paper_arm, tmp_path, monkeypatch):
    plain(monkeypatch)
    page = page_of(made_up(tmp_path / 'bag'), tmp_path / 'report', paper_arm)
    assert 'None: no inconsistent phase, no safe stop' in text(page)


def test_given_a_bag_of_measurements_alone_when_reported_then_nothing_is_said_of_alarms(
    paper_arm, paper_gains, scenario, tmp_path
):
    bag = record(tmp_path / 'bag', paper_arm, paper_gains, scenario, {'joint_states'})
    said = text(page_of(bag, tmp_path / 'report', paper_arm))
    assert 'Alarms were not recorded; no safe stops' in said
    assert 'Not known: the bag holds no fault estimates.' in said
    assert 'Diagnostics were not recorded' in said


# ------------------------------------------------------------------ on paper


def test_given_a_report_when_its_style_is_read_then_it_can_be_printed(report):
    style = re.search('<style>(.*)</style>', report.html.read_text(), re.DOTALL).group(1)
    assert '@page { size: A4;' in style
    printed = style[style.index('@media print') :]
    for rule in (
        'break-inside: avoid',
        'break-after: avoid',
        'display: table-header-group',
        '--ink: #000',
        '--paper: #fff',
    ):
        assert rule in printed
    assert '@top-left { content: "A\\000020run"' in style
    assert 'counter(page)' in style


@pytest.mark.parametrize('title', ['"; } body { display: none } "', '</style><b>', 'a\\b\n', 'ä'])
def test_given_any_title_when_it_goes_into_the_style_sheet_then_it_stays_a_string(title):
    inside = css_string(title)[1:-1]
    assert re.fullmatch(r'(?:[0-9A-Za-z]|\\[0-9a-f]{6})*', inside)
    assert re.sub(r'\\([0-9a-f]{6})', lambda m: chr(int(m.group(1), 16)), inside) == title


def test_given_a_browser_when_the_report_is_opened_and_printed_then_all_is_there_in_black_on_white(
    report, tmp_path
):
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    if not BROWSER:
        pytest.skip('there is no Chromium: apt-get install chromium, or set CHROMIUM')
    asked, complaints = [], []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=['--no-sandbox'])
        page = browser.new_page(viewport={'width': 1100, 'height': 900}, color_scheme='dark')
        page.on('request', lambda request: asked.append(request.url))
        page.on('console', lambda message: complaints.append(message.text))
        page.goto(report.html.as_uri())
        widths = page.evaluate('[...document.images].map(i => i.naturalWidth)')
        page.emulate_media(media='print')
        look = page.evaluate("""() => {
            const body = getComputedStyle(document.body);
            return [body.color, body.backgroundColor,
                    getComputedStyle(document.querySelector('nav')).display,
                    document.documentElement.scrollWidth <= innerWidth]}""")
        pdf = page.pdf(prefer_css_page_size=True)
        browser.close()
    assert len(widths) == 6
    assert min(widths) > 1000
    assert [url for url in asked if not url.startswith('data:')] == [report.html.as_uri()]
    assert complaints == []
    assert look == ['rgb(0, 0, 0)', 'rgb(255, 255, 255)', 'none', True]
    boxes = [
        [float(v) for v in box.split()] for box in re.findall(rb'/MediaBox\s*\[([^\]]*)\]', pdf)
    ]
    assert 4 <= len(boxes) <= 8
    assert all(box[2:] == pytest.approx([595.3, 841.9], abs=1.5) for box in boxes)  # A4


# ------------------------------------------------------------------ command line


def test_given_gains_when_the_command_is_run_then_the_arm_is_theirs_and_the_verdict_is_shown(
    foreign, gains_file, tmp_path, capsys, monkeypatch
):
    plain(monkeypatch)
    assert (
        main(
            ['report', str(foreign), '--gains', str(gains_file), '--out', str(tmp_path / 'report')]
        )
        == 0
    )
    assert 'my_gains.yaml: the certificate holds' in capsys.readouterr().out
    assert 'bag, arm “paper”' in (tmp_path / 'report' / 'report.html').read_text()


def test_given_tampered_gains_when_the_command_is_run_then_the_verdict_is_shown(
    foreign, gains_file, tmp_path, capsys, monkeypatch
):
    plain(monkeypatch)
    path = tampered(gains_file, _weaker, tmp_path / 'gains.yaml')
    assert main(['report', str(foreign), '--gains', str(path), '--out', str(tmp_path)]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert f'the certificate does NOT hold: {FORGED}; observer, link 1' in said


@pytest.mark.parametrize(
    ('options', 'named'),
    [
        (['--gains', 'nothing.yaml'], 'nothing.yaml'),
        (['--gains', 'renamed.yaml'], 'designed for another arm'),
        (['--gains', 'gains.yaml', '--arm', 'real_arm'], 'designed for another arm'),
    ],
    ids=' '.join,
)
def test_given_bad_gains_when_the_command_is_run_then_one_line_says_so_and_the_code_is_2(
    foreign, gains_file, tmp_path, monkeypatch, capsys, options, named
):
    monkeypatch.chdir(tmp_path)
    shutil.copy(gains_file, 'gains.yaml')
    tampered(gains_file, _renamed, tmp_path / 'renamed.yaml')
    assert main(['report', str(foreign), *options]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count('\n')) == ('', 1)
    assert named in said.err
    assert not (tmp_path / 'out').exists()


def test_given_a_bag_of_a_shipped_arm_when_the_command_is_run_without_an_arm_then_it_is_found(
    bag, tmp_path, monkeypatch, capsys
):
    plain(monkeypatch)
    monkeypatch.setattr(
        'lpv_report.certificate.shipped_files',
        lambda kind: {'paper': BRINGUP / kind / 'paper.yaml'},
    )
    assert main(['report', str(bag), '--out', str(tmp_path / 'report')]) == 0
    said = capsys.readouterr().out
    assert "shipped gains of arm 'paper', which the messages name" in said
    assert 'the certificate holds' in said


def renamed(bag, out, name):
    """The same bag as another arm's node would have published it."""
    with open_bag(bag) as reader, BagWriter(out) as writer:
        for connection in reader.connections:
            writer.copy_topic(connection)
        for connection, time, data in reader.messages():
            writer.write_raw(connection.topic, time, data.replace(b'paper\0', name))
    return out


def test_given_a_bag_of_another_arm_when_the_command_is_run_then_it_asks_for_its_files(
    bag, tmp_path, capsys
):
    other = renamed(bag, tmp_path / 'other', b'mine!\0')
    assert main(['report', str(other), '--out', str(tmp_path / 'report')]) == 2
    said = capsys.readouterr().err
    assert "the bag is of arm 'mine!', which is not a shipped one" in said
    assert '--arm mine!.yaml --gains gains.yaml' in said and said.count('\n') == 1


def test_given_a_map_when_drawn_then_it_is_a_picture(paper_model, paper_gains, tmp_path):
    found = guarantee(paper_model, paper_gains, points=5)
    draw_region(found, paper_model, tmp_path / 'a' / 'map.png')
    assert (tmp_path / 'a' / 'map.png').read_bytes().startswith(b'\x89PNG')
