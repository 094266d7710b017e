"""Reports: table against an independent computation, alarms and misses, one file for all."""

import base64
import html
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import matplotlib.image
import numpy as np
import pytest
from places import BRINGUP
from rich.console import Console
from rosbags.highlevel import AnyReader
from runs import ALL, MEASURED, Recorder, record, rows, text

from lpv_bag.run.record import BagError, load_run
from lpv_cli.main import main
from lpv_core.simulation.faults import Fault
from lpv_core.support.timestamps import NANOSECONDS
from lpv_report.history import episodes, missed_faults
from lpv_report.run import print_table, write_report

pytestmark = pytest.mark.slow

ARM_FILE = str(BRINGUP / 'arms' / 'paper.yaml')
SIGNALS = ['x1', 'x2', 'x3', 'x4', 'f1', 'f2', 'y1', 'y2', 'e_t1', 'e_t2']


@pytest.fixture(scope='module')
def scenario(two_faults):
    """1.5 s with a fault of sensor 1 from 0.8 s on."""
    return replace(two_faults, duration=1.5, faults=(Fault('link1_angle', 'bias', 0.8, size=0.3),))


@pytest.fixture(scope='module')
def run(paper_arm, paper_gains, scenario, tmp_path_factory):
    return record(tmp_path_factory.mktemp('run') / 'bag', paper_arm, paper_gains, scenario)


@pytest.fixture(scope='module')
def report(run, paper_arm, scenario, tmp_path_factory):
    return write_report(
        run,
        tmp_path_factory.mktemp('report') / 'new' / 'folder',
        paper_arm,
        scenario.path(paper_arm),
        'A run',
    )


# ------------------------------------------------------------------ a complete run


def independent_mise(bag):
    """The paper's ten figures from the bag's messages, with nothing of the project's."""
    columns = {}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            columns.setdefault(connection.topic[5:], {})[stamp.sec, stamp.nanosec] = message

    def values(stream, field):
        return np.array([getattr(columns[stream][s], field) for s in columns['joint_states']])

    def mean_square(stream, field, other, other_field, absolute=True):
        error = values(stream, field) - values(other, other_field)
        return list(np.mean((np.cumsum(error, axis=1) if absolute else error) ** 2, axis=0))

    return dict(
        zip(
            SIGNALS,
            [
                *mean_square('ground_truth', 'position', 'state_estimate', 'position'),
                *mean_square('ground_truth', 'velocity', 'state_estimate', 'velocity'),
                *mean_square('ground_truth', 'fault', 'fault_estimate', 'estimate', absolute=False),
                *mean_square('reference', 'position', 'joint_states', 'position'),
                *mean_square('reference', 'position', 'ground_truth', 'position'),
            ],
        )
    )


def test_given_a_simulated_run_when_reported_then_the_table_is_that_of_the_paper(report, run):
    expected = independent_mise(run)
    assert [row.signal for row in report.table] == SIGNALS
    for row in report.table:
        assert row.value == pytest.approx(expected[row.signal], rel=1e-9)
    assert [row.paper for row in report.table] == [
        0.006,
        0.002,
        0.024,
        0.047,
        0.006,
        0.002,
        0.034,
        0.053,
        0.003,
        0.007,
    ]
    found = {cells[0]: cells for cells in rows(report.html.read_text()) if cells[0] in SIGNALS}
    assert list(found) == SIGNALS
    for signal, value in expected.items():
        assert found[signal][3] == f'{value:.2g}'


def test_given_a_simulated_run_when_the_table_is_printed_then_each_signal_has_its_line(report):
    stream = io.StringIO()
    print_table(report.table, Console(file=stream, width=120))
    lines = [line.split() for line in stream.getvalue().splitlines()]
    for row in report.table:
        (line,) = [cells for cells in lines if cells and cells[0] == row.signal]
        assert f'{row.value:.2g}' in line
        assert f'{row.paper:g}' in line


class References(HTMLParser):
    """What a page refers to."""

    LOADS = {
        'src',
        'srcset',
        'href',
        'data',
        'poster',
        'action',
        'formaction',
        'background',
        'xlink:href',
    }

    def __init__(self, page):
        super().__init__()
        self.pictures, self.links, self.others, ids = [], set(), [], set()
        self._ids = ids
        self.feed(page)
        self.targets = self.links & {f'#{name}' for name in ids}

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name == 'id':
                self._ids.add(value)
            elif (tag, name) == ('img', 'src'):
                self.pictures.append(value)
            elif (tag, name) == ('a', 'href'):
                self.links.add(value)
            elif name in self.LOADS or name.startswith('on') or name == 'style':
                self.others.append((tag, name, value))
        if tag in ('script', 'link', 'iframe', 'object', 'embed', 'base'):
            self.others.append(tag)


def test_given_a_report_when_read_then_it_needs_nothing_from_elsewhere(report):
    page = report.html.read_text(encoding='utf-8')
    assert page.startswith('<!DOCTYPE html>')
    assert '://' not in page
    assert '<script' not in page
    assert '<link' not in page
    assert '@import' not in page
    assert 'url(' not in page
    found = References(page)
    assert len(found.pictures) == 6
    assert all(source.startswith('data:image/png;base64,') for source in found.pictures)
    assert found.links == found.targets  # within the page alone
    assert found.others == []


def test_given_a_report_when_written_then_its_pictures_are_files_and_inside_the_page(report):
    assert [p.stem for p in report.pictures] == [
        'timeline',
        'path',
        'faults',
        'measured',
        'states',
        'torques',
    ]
    page = report.html.read_text(encoding='utf-8')
    inside = [base64.b64decode(data) for data in re.findall(r'base64,([^"]*)"', page)]
    assert inside == [p.read_bytes() for p in report.pictures]
    for data in inside:
        assert data.startswith(b'\x89PNG\r\n\x1a\n')
        assert data.endswith(b'IEND\xaeB`\x82')
        pixels = matplotlib.image.imread(io.BytesIO(data), format='png')
        assert min(pixels.shape[:2]) > (400 if data != inside[0] else 200)
        assert pixels[..., :3].std() > 0.01  # not an empty sheet
    assert {p.name for p in report.html.parent.iterdir()} == {
        'report.html',
        *(p.name for p in report.pictures),
    }


def test_given_a_fault_that_is_found_when_reported_then_onset_alarm_and_delay_are_listed(
    report, run
):
    first, last = load_run(run).alarms[0], load_run(run).alarms[-1]
    page = report.html.read_text(encoding='utf-8')
    line = next(cells for cells in rows(page) if cells[0] == 'link1_angle')
    onset, detected = first.onset / NANOSECONDS, first.detected / NANOSECONDS
    assert onset == pytest.approx(0.8, abs=0.003)
    assert line[1] == last.kind
    assert line[2:6] == [f'{onset:.3f}', f'{detected:.3f}', f'{detected - 0.8:.3f}', 'active']
    estimate = load_run(run).get('fault_estimate', 'estimate')[-1, 0]
    assert line[6] == f'{estimate:+.3f}', 'the fault now, not at its alarm'
    assert float(line[8]) == pytest.approx(0.3, abs=0.1)
    assert 'Missed' not in text(page)
    assert 'no false alarms, no faults missed' in text(page)
    assert 'false alarm' not in sum(rows(page), [])
    assert '1.5 s of measurements' in text(page)


def test_given_recorded_topics_when_reported_then_their_messages_are_counted(report):
    counts = dict(cells for cells in rows(report.html.read_text()) if cells[0].startswith('/'))
    assert counts['/lpv/joint_states'] == counts['/lpv/ground_truth'] == '751'
    assert set(counts) == {f'/lpv/{name}' for name in ALL}


def test_given_the_same_run_when_reported_twice_then_every_byte_is_the_same(
    report, run, paper_arm, scenario, tmp_path
):
    again = write_report(run, tmp_path, paper_arm, scenario.path(paper_arm), 'A run')
    assert again.html.read_bytes() == report.html.read_bytes()


@pytest.mark.parametrize('title', ['<script>alert("x")</script>', 'a & b < c', '{{ 7 * 7 }} %s'])
def test_given_a_title_with_markup_when_reported_then_it_is_text(
    run, paper_arm, tmp_path, title, monkeypatch
):
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])
    page = write_report(run, tmp_path, paper_arm, title=title).html.read_text(encoding='utf-8')
    for tag in ('title', 'h1'):
        (inside,) = re.findall(f'<{tag}>(.*?)</{tag}>', page, re.DOTALL)
        assert '<' not in inside
        assert html.unescape(inside) == title


# ------------------------------------------------------------------ runs with less in them


def test_given_no_ground_truth_when_reported_then_the_sizes_of_fault_estimates_are_shown(
    paper_arm, paper_gains, scenario, tmp_path
):
    bag = record(tmp_path / 'bag', paper_arm, paper_gains, scenario, MEASURED)
    report = write_report(bag, tmp_path / 'report', paper_arm)
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == '/lpv/fault_estimate']
        later = np.array(
            [
                reader.deserialize(data, c.msgtype).estimate
                for c, time, data in reader.messages(connections)
                if time > NANOSECONDS
            ]
        )
    assert [row.signal for row in report.table] == ['link1_angle'] * 2 + ['link2_angle'] * 2
    assert [row.paper for row in report.table] == [None] * 4
    for i in range(2):
        largest, rms = (row.value for row in report.table[2 * i : 2 * i + 2])
        assert largest == np.abs(later[:, i]).max()
        assert rms == pytest.approx(np.sqrt(np.mean(later[:, i] ** 2)), rel=1e-12)
    assert len(report.pictures) == 6
    page = report.html.read_text(encoding='utf-8')
    assert 'false alarm' not in text(page)
    line = next(cells for cells in rows(page) if cells[0] == 'link1_angle')
    assert len(line) == 9  # no delay without a true onset
    stream = io.StringIO()
    print_table(report.table, Console(file=stream, width=120))
    assert stream.getvalue().count('link1_angle') == 2


@pytest.mark.parametrize(
    ('streams', 'pictures'),
    [
        ({'joint_states'}, ['path', 'measured', 'torques']),
        ({'joint_states', 'fault_estimate'}, ['path', 'faults', 'measured', 'torques']),
        ({'joint_states', 'state_estimate'}, ['path', 'measured', 'states', 'torques']),
        (ALL - {'reference'}, ['path', 'faults', 'measured', 'states', 'torques']),
        (ALL - {'state_estimate'}, ['path', 'faults', 'measured', 'torques']),
        (ALL - {'fault_estimate'}, ['path', 'measured', 'states', 'torques']),
        ({'joint_states', 'ground_truth'}, ['path', 'measured', 'torques']),
    ],
    ids=lambda value: ' '.join(sorted(value)),
)
def test_given_a_run_without_some_topics_when_reported_then_what_is_there_is_shown(
    paper_arm, paper_gains, scenario, tmp_path, monkeypatch, streams, pictures
):
    # Rendering takes a second a run, and other tests look at pictures.
    monkeypatch.setattr('lpv_report.run.png', lambda figure: b'drawn')
    bag = record(tmp_path / 'bag', paper_arm, paper_gains, scenario, streams)
    report = write_report(bag, tmp_path / 'report', paper_arm)
    more = ['timeline'] if 'fault_estimate' in streams else []
    assert [p.stem for p in report.pictures] == more + pictures
    assert report.html.read_text(encoding='utf-8').count('<figure>') == len(pictures + more)


def test_given_no_reference_when_reported_then_tracking_is_left_out(
    paper_arm, paper_gains, scenario, tmp_path, monkeypatch
):
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])
    bag = record(tmp_path / 'bag', paper_arm, paper_gains, scenario, ALL - {'reference'})
    assert [row.signal for row in write_report(bag, tmp_path, paper_arm).table] == SIGNALS[:6]


def test_given_a_dropout_when_reported_then_table_and_figures_are_made_of_the_rest(
    paper_arm, paper_gains, scenario, tmp_path
):
    fault = Fault('link2_angle', 'dropout', onset=0.8, duration=0.2)
    bag = record(tmp_path / 'bag', paper_arm, paper_gains, replace(scenario, faults=(fault,)))
    report = write_report(bag, tmp_path / 'report', paper_arm)
    assert all(np.isfinite(row.value) for row in report.table)
    assert len(report.pictures) == 6
    assert not re.search('(?i)[+-]?nan|inf', ' '.join(sum(rows(report.html.read_text()), [])))


# ------------------------------------------------------------------ alarms and misses


ALARM = {
    'sensor': 'left',
    'sensor_index': 0,
    'event': 0,
    'size': 0.3,
    'bound': 0.1,
    'kind': 'unclassified',
    'confidence': 0.99,
}
MS = 1_000_000


def made_up(path, faults, alarms, truth=True):
    """Bag of 1 s in steps of 10 ms: true faults (sensor, start, end [ms]) and alarm events."""
    with Recorder(
        path,
        {'joint_states', 'fault_estimate', 'fault_alarm'} | ({'ground_truth'} if truth else set()),
    ) as bag:
        for time in range(0, 1010, 10):
            stamp, fault = 7 * NANOSECONDS + time * MS, np.zeros(2)
            for sensor, start, end in faults:
                fault[sensor] = 0.2 if start <= time < end else fault[sensor]
            bag.measure(stamp, [0.1, 0.2], [0.0, 0.0], [0.0, 0.0])
            bag.stream(
                'ground_truth',
                stamp,
                position=[0.1, 0.2],
                velocity=[0.0, 0.0],
                torque=[0.0, 0.0],
                fault=fault,
                disturbance=0.0,
            )
            bag.stream(
                'fault_estimate',
                stamp,
                sensor_names=['left', 'right'],
                estimate=[1e-3 * time, -1e-3 * time],
                bound=[0.1, 0.1],
                threshold=[0.1, 0.1],
                state=[0, 0],
                alarm=[False, False],
            )
        for time, onset, detected, fields in alarms:
            first = 7 * NANOSECONDS
            bag.stream(
                'fault_alarm',
                first + time * MS,
                **{
                    **ALARM,
                    'onset': first + onset * MS,
                    'detected': first + detected * MS,
                    **fields,
                },
            )
    return path


CLEARED, UPDATED = {'event': 2}, {'event': 1}
RIGHT = {'sensor': 'right', 'sensor_index': 1}


def test_given_faults_and_alarms_when_reported_then_misses_and_false_alarms_are_listed(
    paper_arm, tmp_path, monkeypatch
):
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])
    bag = made_up(
        tmp_path / 'bag',
        [(0, 200, 400), (1, 500, 700)],
        [(230, 210, 230, {}), (450, 210, 230, CLEARED), (860, 850, 860, {'size': -0.2})],
    )
    page = write_report(bag, tmp_path, paper_arm).html.read_text(encoding='utf-8')
    found, false = (cells for cells in rows(page) if cells[0] == 'left')
    assert found[2:7] == ['0.210', '0.230', '0.030', '0.450', '+0.300']
    assert false[2:7] == ['0.850', '0.860', 'false alarm', 'active', '+1.000']
    assert re.findall('Missed: [^!]*? alarm[.]', text(page)) == [
        'Missed: a fault of right from 0.500 s to 0.700 s raised no alarm.'
    ]


def test_given_a_healthy_run_when_reported_then_it_says_that_there_was_no_alarm(
    paper_arm, tmp_path, monkeypatch
):
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])
    bag = made_up(tmp_path / 'bag', [], [])
    page = write_report(bag, tmp_path, paper_arm).html.read_text(encoding='utf-8')
    assert 'No alarm.' in text(page)
    assert 'Missed' not in text(page)


def test_given_events_of_two_sensors_when_gathered_then_each_alarm_is_one_episode(tmp_path):
    bag = made_up(
        tmp_path / 'bag',
        [(0, 100, 300), (1, 150, 900)],
        [
            (120, 100, 120, {}),
            (180, 160, 180, {**RIGHT, 'size': -0.2}),
            (250, 100, 120, {**UPDATED, 'kind': 'bias', 'confidence': 0.5}),
            (400, 100, 120, CLEARED),
            (700, 690, 700, {}),
        ],
    )
    first, second, third = episodes(load_run(bag))
    assert (first.sensor, first.onset, first.raised, first.cleared) == ('left', 0.1, 0.12, 0.4)
    assert (first.kind, first.confidence, first.size) == ('bias', 0.5, 0.3)
    assert first.largest == pytest.approx(0.4)
    assert first.delay == pytest.approx(0.02)
    assert (second.sensor, second.raised, second.cleared) == ('right', 0.18, None)
    assert second.largest == pytest.approx(-1.0)
    assert second.delay == pytest.approx(0.03)
    assert (third.sensor, third.false_alarm, third.delay) == ('left', True, None)
    assert missed_faults(load_run(bag), [first, second, third]) == []


def test_given_an_alarm_whose_start_is_not_in_the_bag_when_gathered_then_it_is_known_by_its_end(
    tmp_path,
):
    record = load_run(made_up(tmp_path / 'bag', [(0, 0, 100)], [(150, -500, -490, CLEARED)]))
    (episode,) = episodes(record)
    assert (episode.onset, episode.raised, episode.cleared) == (-0.5, -0.49, 0.15)
    assert missed_faults(record, [episode]) == []


@pytest.mark.parametrize(
    ('start', 'end', 'missed'),
    [(100, 220, False), (100, 200, True), (300, 350, False), (600, 800, True), (390, 500, False)],
)
def test_given_an_alarm_from_210_to_400_ms_when_a_fault_acts_then_it_is_missed_outside(
    tmp_path, start, end, missed
):
    record = load_run(
        made_up(
            tmp_path / 'bag', [(0, start, end)], [(210, 205, 210, {}), (400, 205, 210, CLEARED)]
        )
    )
    faults = missed_faults(record, episodes(record))
    assert [(f.sensor_index, f.start, f.end) for f in faults] == (
        [(0, start / 1000, end / 1000)] if missed else []
    )


def test_given_no_truth_when_gathered_then_alarms_are_neither_right_nor_false(tmp_path):
    record = load_run(made_up(tmp_path / 'bag', [], [(210, 205, 210, {})], truth=False))
    (episode,) = episodes(record)
    assert (episode.delay, episode.false_alarm, episode.true_onset) == (None, False, None)
    assert missed_faults(record, []) == []


def test_given_a_sensor_name_with_markup_when_reported_then_it_is_text(
    paper_arm, tmp_path, monkeypatch
):
    monkeypatch.setattr('lpv_report.run.draw_all', lambda *_: [])
    bag = made_up(tmp_path / 'bag', [], [(210, 205, 210, {'sensor': '<b>left</b>'})])
    page = write_report(bag, tmp_path, paper_arm).html.read_text(encoding='utf-8')
    assert '<b>' not in page
    assert '<b>left</b>' in [cells[0] for cells in rows(page)]


# ------------------------------------------------------------------ command line


def test_given_the_command_when_run_then_table_and_place_of_the_report_are_shown(
    run, tmp_path, capsys
):
    assert (
        main(
            [
                'report',
                str(run),
                '--arm',
                ARM_FILE,
                '--out',
                str(tmp_path / 'report'),
                '--scenario',
                str(BRINGUP / 'scenarios' / 'two_faults.yaml'),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert 'e_t2' in said
    assert str(tmp_path / 'report' / 'report.html') in said
    assert 'bag, arm “paper”' in (tmp_path / 'report' / 'report.html').read_text()


@pytest.mark.parametrize(
    ('changes', 'named'),
    [
        ({'bag': 'nothing'}, 'nothing: there is no such bag'),
        ({'bag': '.'}, 'metadata.yaml'),
        ({'--arm': 'unknown_arm'}, ''),
        ({'--arm': 'nothing.yaml'}, ''),
        ({'--arm': str(BRINGUP / 'scenarios' / 'two_faults.yaml')}, 'two_faults.yaml'),
        ({'--scenario': 'unknown_scenario'}, ''),
        ({'--scenario': ARM_FILE}, 'paper.yaml'),
    ],
    ids=str,
)
def test_given_bad_input_when_the_command_is_run_then_one_line_says_so_and_the_code_is_2(
    run, tmp_path, monkeypatch, capsys, changes, named
):
    monkeypatch.chdir(tmp_path)
    options = {'--arm': ARM_FILE, '--out': 'report', **changes}
    bag = options.pop('bag', str(run))
    assert main(['report', bag, *(part for pair in options.items() for part in pair)]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err.startswith('lpv report: ')
    assert said.err.count('\n') == 1
    assert named in said.err
    assert not (tmp_path / 'report').exists()


def test_given_a_file_in_the_place_of_the_folder_when_the_command_is_run_then_one_line_says_so(
    run, tmp_path, capsys
):
    (tmp_path / 'report').write_text('mine')
    assert main(['report', str(run), '--arm', ARM_FILE, '--out', str(tmp_path / 'report')]) == 2
    assert capsys.readouterr().err.count('\n') == 1
    assert (tmp_path / 'report').read_text() == 'mine'


def test_given_the_joints_of_another_arm_when_reported_then_the_missing_one_is_named(
    run, paper_arm, tmp_path
):
    names = zip(paper_arm.joints, ('shoulder', 'elbow'))
    renamed = replace(paper_arm, joints=tuple(replace(joint, name=name) for joint, name in names))
    with pytest.raises(BagError, match="'shoulder'.*joint1, joint2"):
        write_report(run, tmp_path, renamed)
