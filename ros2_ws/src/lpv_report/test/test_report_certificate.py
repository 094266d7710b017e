"""Reports: certificate and versions, detectability along the path, phases, and the printed page."""

import hashlib
import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from places import BRINGUP
from runs import MEASURED, Recorder, record, rows, text

from lpv_bag.rosbag.reading import open_bag
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.bound.error_bound import error_bound, static_bound
from lpv_core.certificate.gains import save_gains
from lpv_core.decision.diagnosis import DiagnosisParameters, SensorState
from lpv_core.model.joints import JointMap
from lpv_core.simulation.faults import Fault
from lpv_core.support.timestamps import NANOSECONDS
from lpv_design.guarantee import guarantee
from lpv_report.guarantees.detectability import configurations, detectability, summary
from lpv_report.guarantees.gains_source import find_used_gains
from lpv_report.guarantees.region_figure import draw_region
from lpv_report.history.phases import Phase, listed, phases
from lpv_report.page import css_string
from lpv_report.run import read_used_gains, write_report

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
        read_used_gains(gains_file),
    )


def plain(monkeypatch):
    """Leave the pictures out: other tests look at them."""
    monkeypatch.setattr('lpv_report.run.write.draw_all', lambda *_: [])


def page_of(*given, **options):
    return write_report(*given, **options).html.read_text(encoding='utf-8')


# ------------------------------------------------------------------ certificate and versions


def test_given_gains_when_reported_then_method_arm_region_decay_gamma_and_solver_are_told(
    report, gains_file, paper_arm, paper_gains
):
    facts = dict(cells for cells in rows(report.html.read_text()) if len(cells) == 2)
    assert facts['gains file'] == 'my_gains.yaml'
    assert facts['SHA-256 of the file'] == hashlib.sha256(gains_file.read_bytes()).hexdigest()
    assert facts['designed for arm'] == 'paper'
    assert facts['SHA-256 of the arm'] == paper_arm.sha256()
    assert facts['method'] == 'observer exact, controller exact'
    limit = np.degrees(np.arccos(paper_arm.cos_min[0]))
    assert f'within {limit:.1f}°' in facts['certified region']
    assert facts['decay of the estimation error'].startswith(f'{paper_gains.observer.decay:g} /s')
    gravity = 9.8 * np.array([10.0 * 0.5 + 5.0 * 1.0, 5.0 * 0.5])
    expected = ', '.join(f'{1.0 / (g * 0.3):.3g}' for g in gravity)
    assert facts['γ, from unknown torques to the angle errors'] == f'{expected} rad/(N m)'
    for name in ('clarabel', 'cvxpy', 'numpy'):
        assert f'{name} {paper_gains.certificate[f"{name}_version"]}' in facts['solver']
    assert facts['solver said'] == 'observer optimal, optimal; controller optimal'


def test_given_gains_when_reported_then_every_margin_is_rebuilt_and_the_time_it_took_is_told(
    report, paper_gains
):
    page = report.html.read_text(encoding='utf-8')
    assert report.certificate.holds
    listed_ = {cells[0]: cells[1:] for cells in rows(page) if cells[-1] in ('yes', 'NO')}
    whole = 'gains file: numbers are those of the design'
    assert set(listed_) == {*paper_gains.certificate['margins'], whole}
    for name, margin in paper_gains.certificate['margins'].items():
        assert listed_[name] == [f'{margin:.3g}', f'{margin:.3g}', 'yes']
    count = len(listed_)
    assert f'{count} of {count} inequalities hold' in text(page)
    assert '12 of 12 were proved in exact rational arithmetic' in text(page)
    seconds = float(re.search('<time datetime="PT([0-9.]+)S">', page).group(1))
    assert 0.0 < seconds < 60.0
    assert 'gives the recorded fault estimates' in text(page)


def test_given_a_report_when_read_then_the_versions_of_the_software_are_there(report):
    import matplotlib

    versions = dict(cells for cells in rows(report.html.read_text()) if len(cells) == 2)
    assert versions['NumPy'] == np.__version__
    assert versions['Matplotlib'] == matplotlib.__version__
    assert {'lpv-arm-fdi', 'Python', 'rosbags', 'mcap'} <= set(versions)


def test_given_the_same_gains_when_reported_twice_then_only_the_time_of_the_check_differs(
    report, foreign, gains_file, paper_arm, scenario, tmp_path
):
    again = write_report(
        foreign, tmp_path, paper_arm, scenario.path(paper_arm), 'A run', read_used_gains(gains_file)
    )
    first, second = (re.sub('<time .*?</time>', '', r.html.read_text()) for r in (report, again))
    assert first == second


def test_given_a_bag_without_gains_when_reported_then_it_says_so_and_claims_nothing(
    bag, paper_arm, tmp_path, monkeypatch
):
    plain(monkeypatch)
    report = write_report(bag, tmp_path / 'report', paper_arm)
    said = text(report.html.read_text(encoding='utf-8'))
    assert report.certificate is None
    assert 'Not known. The bag carries no gains, and none were given.' in said
    assert 'certificate of the gains unknown' in said
    assert 'The certificate holds' not in said
    assert 'The gains are not known. Only what was recorded is shown' in said
    assert 'at rest: from' not in said


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


def _prettier(gains):
    name = next(iter(gains['certificate']['margins']))
    gains['certificate']['margins'][name] *= 10.0


def _unproven(gains):
    gains['certificate'] = {'arm_json': gains['certificate']['arm_json'], 'margins': 'many'}


def _renamed(gains):
    gains['arm_sha256'] = 'f' * SHA


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        (_weaker, f'The certificate does NOT hold. What fails: {FORGED}; observer, link 1'),
        (_retuned, 'the file was changed after the design'),
        (_prettier, 'the file was changed after the design'),
        (_unproven, 'the file was changed after the design'),
        (_renamed, 'does not hold for this run'),
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
    assert 'The certificate does not hold: nothing is guaranteed at rest.' in said
    assert 'at rest: from' not in said


def test_given_other_gains_than_those_of_the_run_when_reported_then_the_difference_is_told(
    bag, gains_file, paper_arm, tmp_path, monkeypatch
):
    plain(monkeypatch)
    tampered(gains_file, _retuned, bag / 'gains.yaml')
    assert 'gives other fault estimates than the recorded ones' in text(
        page_of(bag, tmp_path / 'report', paper_arm)
    )


@pytest.mark.parametrize('content', [b'', b'gains: 1', b'\xff\xfe\x00', b'[1, 2'])
def test_given_rubbish_in_the_place_of_the_gains_when_reported_then_the_run_is_shown_all_the_same(
    bag, paper_arm, tmp_path, monkeypatch, content
):
    plain(monkeypatch)
    (bag / 'gains.yaml').write_bytes(content)
    said = text(page_of(bag, tmp_path / 'report', paper_arm))
    assert 'The gains in the bag cannot be used' in said
    assert 'certificate of the gains unknown' in said


def test_given_a_single_file_among_others_when_gains_lie_there_then_they_are_not_taken(
    bag, gains_file, tmp_path
):
    shutil.copy(bag / 'bag.mcap', tmp_path / 'other.mcap')
    shutil.copy(gains_file, tmp_path / 'gains.yaml')
    assert find_used_gains(tmp_path / 'other.mcap').gains is None


def test_given_the_method_of_the_paper_when_reported_then_its_figures_are_told(
    bag, paper_arm, literal_gains, tmp_path, monkeypatch
):
    plain(monkeypatch)
    save_gains(literal_gains, bag / 'gains.yaml')
    page = page_of(bag, tmp_path / 'report', paper_arm)
    facts = dict(cells for cells in rows(page) if len(cells) == 2)
    assert facts['γ, from disturbances and faults'] == f'{literal_gains.observer.gamma:g}'
    assert literal_gains.observer.lmi in facts['box of φ₁, φ₂, φ₃']


# ------------------------------------------------------------------ detectability


def test_given_a_run_when_its_detectability_is_computed_then_it_is_threshold_plus_bound(
    foreign, paper_arm, paper_gains
):
    run = load_run(foreign)
    found = detectability(run, paper_arm, paper_gains)
    assert found.source == 'true'
    np.testing.assert_array_equal(
        found.moving, run.get('fault_estimate', 'threshold') + run.get('fault_estimate', 'bound')
    )
    tuning, theta = (
        DiagnosisParameters(),
        JointMap(paper_arm).absolute_position(run.get('ground_truth', 'position')),
    )
    constants = error_bound(paper_arm, paper_gains, tuning.sigmas, tuning.friction_uncertainty)
    assert len(found.places) == 400
    for k in (0, 100, 399):
        bound = static_bound(constants, theta[found.places[k]])
        np.testing.assert_allclose(found.resting[k], bound + np.maximum(bound, 0.02), rtol=1e-9)
    row = summary(found, paper_arm.sensor_names)[1]
    assert (row.smallest, row.largest) == (found.moving[:, 1].min(), found.moving[:, 1].max())
    assert row.middle == np.median(found.moving[:, 1])
    assert (row.rest_smallest, row.unbounded, row.lost) == (found.resting[:, 1].min(), 0.0, 0.0)


def test_given_an_arm_when_mapped_then_outside_of_its_region_its_sensors_are_not_diagnosable(
    foreign, paper_arm, paper_gains, real_arm
):
    grid = configurations(detectability(load_run(foreign), paper_arm, paper_gains), paper_arm)
    limit = np.arccos(0.3)
    assert grid.one[0] < -limit
    assert grid.two[-1] > limit
    np.testing.assert_array_equal(grid.lost[:, 5, 0], np.abs(grid.one) > limit)
    np.testing.assert_array_equal(grid.lost[5, :, 1], np.abs(grid.two) > limit)
    middle = (len(grid.one) // 2, len(grid.two) // 2)
    assert np.isfinite(grid.detectable[middle]).all()
    assert grid.detectable[middle][0] < grid.detectable[middle[0] // 2, middle[1], 0]
    # An encoder of the relative angle sees both links.
    run = load_run(foreign)
    other = replace(real_arm, joint_names=run.joint_names)
    both = configurations(detectability(run, other), other).lost
    assert both[0, len(grid.two) // 2, 1]
    assert both[len(grid.one) // 2, 0].tolist() == [False, True]


def test_given_a_run_when_reported_then_the_table_of_detectability_is_that_of_the_run(
    report, foreign, paper_arm, paper_gains
):
    row = summary(detectability(load_run(foreign), paper_arm, paper_gains), paper_arm.sensor_names)[
        0
    ]
    line = [cells for cells in rows(report.html.read_text()) if cells[0] == 'link1_angle'][-1]
    assert line[1:] == [
        f'{row.smallest:.3f}',
        f'{row.middle:.3f}',
        f'{row.largest:.3f}',
        f'{row.rest_smallest:.3f}',
        f'{row.rest_largest:.3f}',
        '0.0 %',
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
    found = phases(load_run(path), path, ['left', 'right'])
    assert found == [
        Phase('not diagnosable', 'left', 0.2, 0.3),
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


def test_given_the_reports_of_another_arm_when_reported_then_they_are_not_taken_for_ours(tmp_path):
    path = made_up(tmp_path / 'bag', reports=[(500, CONFUSED)], name='/other/uio: observer')
    assert phases(load_run(path), path, ['left', 'right']) == []


def test_given_hundreds_of_stretches_when_listed_then_the_longest_are_shown_and_all_are_counted():
    many = [Phase('no data', 'left', float(k), k + 0.1 + (k == 50)) for k in range(100)]
    shown, (rest,) = listed([*many, Phase('safe stop', '', 3.0, 4.0)])
    assert len(shown) == 9
    assert many[50] in shown
    assert (rest.what, rest.sensor, rest.count) == ('no data', 'left', 92)
    assert sum(p.duration for p in shown if p.what == 'no data') + rest.duration == pytest.approx(
        sum(p.duration for p in many)
    )


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
    assert 'Not known: the bag holds no fault estimates, and its gains are not known.' in said
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
    assert len(widths) == 8
    assert min(widths) > 1000
    assert [url for url in asked if not url.startswith('data:')] == [report.html.as_uri()]
    assert complaints == []
    assert look == ['rgb(0, 0, 0)', 'rgb(255, 255, 255)', 'none', True]
    boxes = [
        [float(v) for v in box.split()] for box in re.findall(rb'/MediaBox\s*\[([^\]]*)\]', pdf)
    ]
    assert 5 <= len(boxes) <= 9
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
        (['--gains', 'short.yaml'], 'arm_json'),
    ],
    ids=' '.join,
)
def test_given_bad_gains_when_the_command_is_run_then_one_line_says_so_and_the_code_is_2(
    foreign, gains_file, tmp_path, monkeypatch, capsys, options, named
):
    monkeypatch.chdir(tmp_path)
    shutil.copy(gains_file, 'gains.yaml')
    tampered(gains_file, _renamed, tmp_path / 'renamed.yaml')
    tampered(
        gains_file, lambda gains: gains['certificate'].pop('arm_json'), tmp_path / 'short.yaml'
    )
    assert main(['report', str(foreign), *options]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count('\n')) == ('', 1)
    assert named in said.err
    assert not (tmp_path / 'out').exists()


def test_given_streams_of_a_real_arm_when_reported_with_the_gains_then_the_path_is_the_estimate(
    paper_arm, paper_gains, scenario, tmp_path
):
    path = record(tmp_path / 'bag', paper_arm, paper_gains, scenario, MEASURED)
    assert detectability(load_run(path), paper_arm, paper_gains).source == 'estimated'


def test_given_a_bag_of_a_shipped_arm_when_the_command_is_run_without_an_arm_then_it_is_found(
    bag, tmp_path, monkeypatch, capsys
):
    plain(monkeypatch)
    gains = {'paper': BRINGUP / 'gains' / 'paper.yaml'}
    monkeypatch.setattr('lpv_report.guarantees.gains_source.shipped_files', lambda _: gains)
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


def test_given_a_map_when_drawn_then_it_is_a_picture(paper_arm, paper_gains, tmp_path):
    draw_region(guarantee(paper_arm, paper_gains, points=5), paper_arm, tmp_path / 'a' / 'map.png')
    assert (tmp_path / 'a' / 'map.png').read_bytes().startswith(b'\x89PNG')
