"""Processes of ``ros2 launch``: output, ends, signals; small shell programs in place of nodes."""

import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')

pytestmark = pytest.mark.slow

ROS2 = Path(sys.prefix) / 'bin' / 'ros2'


@pytest.fixture
def launch(tmp_path, monkeypatch):
    """Start the text of a launch file with some options."""
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    started = []

    def start(text, *words, stdout=subprocess.PIPE):
        path = tmp_path / 'some.launch.xml'
        path.write_text(f'<launch>{text}</launch>')
        process = subprocess.Popen(
            [str(ROS2), 'launch', str(path), *words],
            text=True,
            stdout=stdout,
            stderr=subprocess.STDOUT,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def log_of(tmp_path):
    return next((tmp_path / 'log').glob('*/launch.log')).read_text()


def shell(program, attributes='output="screen"', name='p'):
    return f'<executable cmd="sh -c \'{program}\'" name="{name}" {attributes}/>'


def ended(process):
    text, _ = process.communicate(timeout=30)
    return process.returncode, text


def test_given_processes_that_end_when_launched_then_lines_and_ends_are_shown(launch, tmp_path):
    code, text = ended(
        launch(
            '<log message="hello"/>'
            + shell('echo one; echo two >&amp;2', name='a')
            + shell('echo hidden; echo shown >&amp;2', '', name='b')
        )
    )
    assert code == 0
    assert '[INFO] [launch]: All log files can be found below ' in text
    assert '[INFO] [launch.user]: hello\n' in text
    assert re.search(r'\[INFO\] \[a-1\]: process started with pid \[\d+\]\n', text)
    assert '[a-1] one\n' in text
    assert '[a-1] two\n' in text
    assert '[b-2] shown\n' in text
    assert 'hidden' not in text
    assert 'hidden' in log_of(tmp_path)
    assert re.search(r'\[INFO\] \[b-2\]: process has finished cleanly \[pid \d+\]\n', text)
    assert '[b-2] hidden\n' in ended(launch(shell('echo hidden', '', 'b') * 2, '-a'))[1]


def test_given_a_process_that_fails_when_launched_then_the_others_go_on_and_the_code_is_1(launch):
    code, text = ended(
        launch(
            shell('exit 3')
            + shell('sleep 0.3; echo still there')
            + '<executable cmd="/nowhere/program" name="q"/>'
        )
    )
    assert code == 1
    assert re.search(
        r"\[ERROR\] \[p-1\]: process has died \[pid \d+, exit code 3, cmd 'sh -c exit "
        r"3'\]\.",
        text,
    )
    assert '[p-2] still there\n' in text
    assert '[ERROR] [q-3]: cannot be started: ' in text


def test_given_a_process_that_is_respawned_when_it_ends_then_it_starts_again(launch):
    code, text = ended(
        launch(
            shell(
                'echo turn; exit 1',
                'output="screen" respawn="true" respawn_delay="0.1" respawn_max_retries="2"',
            )
        )
    )
    assert code == 1
    assert text.count('[p-1] turn\n') == 3


def test_given_a_required_process_when_it_ends_then_all_are_stopped(launch):
    start = time.monotonic()
    code, text = ended(
        launch(shell('sleep 0.3', 'on_exit="shutdown"') + shell('exec sleep 60', name='q'))
    )
    assert code == 0
    assert 'p-1 has ended: shutting down' in text
    assert time.monotonic() - start < 20


def wait_for_line(process, pattern):
    for line in process.stdout:
        if re.search(pattern, line):
            return
    raise AssertionError(f'no {pattern!r}')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_given_a_signal_when_launched_then_every_process_gets_sigint_once(launch, number):
    trap = 'trap "echo caught; exit 0" INT; echo ready; while true; do sleep 0.05; done'
    process = launch(shell(trap.replace('"', '&quot;')))
    wait_for_line(process, 'ready')
    process.send_signal(number)
    code, text = ended(process)
    assert code == 0
    assert text.count('[p-1] caught\n') == 1
    name = 'ctrl-c (SIGINT)' if number == signal.SIGINT else number.name
    assert f'user interrupted with {name}' in text


def test_given_a_terminal_that_is_closed_when_launched_then_every_process_is_stopped(
    launch, tmp_path
):
    caught, ready = tmp_path / 'caught', tmp_path / 'ready'
    ours, theirs = os.openpty()
    process = launch(
        shell(
            f'trap &quot;echo caught; touch {caught}; exit 0&quot; INT; '
            f'touch {ready}; while true; do sleep 0.05; done'
        ),
        stdout=theirs,
    )
    os.close(theirs)
    limit = time.monotonic() + 30.0
    while not ready.exists() and time.monotonic() < limit:
        time.sleep(0.01)
    os.close(ours)  # what is printed from now on fails
    process.send_signal(signal.SIGHUP)
    assert process.wait(30) == 0
    assert caught.exists()
    assert '[p-1]: process has finished cleanly' in log_of(tmp_path)


def test_given_a_process_that_ignores_signals_when_stopped_then_it_is_killed_in_the_end(launch):
    trap = 'trap &quot;&quot; INT TERM; echo ready; while true; do sleep 0.05; done'
    process = launch(shell(trap, 'output="screen" sigterm_timeout="0.3" sigkill_timeout="0.3"'))
    wait_for_line(process, 'ready')
    process.send_signal(signal.SIGINT)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    code, text = ended(process)
    assert code == 0
    assert (
        "failed to terminate '0.3' seconds after receiving 'SIGINT', escalating to 'SIGTERM'"
        in text
    )
    assert (
        "failed to terminate '0.3' seconds after receiving 'SIGTERM', escalating to 'SIGKILL'"
        in text
    )
    assert 'user interrupted with ctrl-c (SIGINT) again, ignoring...' in text


def test_given_a_storm_of_signals_when_stopped_then_none_of_them_blocks_the_end(launch):
    trap = 'trap &quot;&quot; INT; echo ready; while true; do sleep 0.05; done'
    process = launch(shell(trap, 'output="screen" sigterm_timeout="2.0"'))
    wait_for_line(process, 'ready')
    pauses = random.Random(1).choices(range(100), k=8000)

    def storm():
        for pause in pauses:
            process.send_signal(signal.SIGINT)  # nothing once the process has ended
            time.sleep(pause * 1e-6)

    thread = threading.Thread(target=storm)
    thread.start()
    code, text = ended(process)
    thread.join()
    assert code == 0
    assert text.count('ignoring...') > 100


def test_given_a_launch_file_when_only_shown_then_nothing_is_started(launch, tmp_path):
    code, text = ended(
        launch(
            '<arg name="a" default="1"/><group>' + shell('touch started') + '</group>',
            '--print',
            'a:=2',
        )
    )
    assert code == 0
    assert text == "arg a = '2'\ngroup\n    executable sh -c 'touch started'\n"
    assert not (tmp_path / 'log').exists()


@pytest.mark.ros
def test_given_respawn_and_view_when_nodes_are_killed_then_they_come_back_and_no_bag_is_overwritten(
    tmp_path, monkeypatch
):
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    import ros

    monkeypatch.setenv('ROS_DOMAIN_ID', str(ros.next_domain()))
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    process = subprocess.Popen(
        [
            str(ROS2),
            'launch',
            'lpv_bringup',
            'pipeline.launch.xml',
            'record:=true',
            'view:=true',
            'view_port:=0',
            'foxglove_port:=0',
            'respawn:=true',
            f'bag:={tmp_path / "bag"}',
        ],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    lines = []

    def until(*patterns):
        """Read on until each pattern has been seen; the groups of the matches."""
        left = {pattern: None for pattern in patterns}
        while None in left.values():
            line = process.stdout.readline()
            assert line, ''.join(lines)
            lines.append(line)
            for pattern, found in left.items():
                left[pattern] = found or re.search(pattern, line)
        return [found.groups() for found in left.values()]

    started = r'\[{}-\d\]: process started with pid \[(\d+)\]'
    try:
        ((recorder,), (uio,), (page,), *_) = until(
            started.format('recorder'),
            started.format('uio'),
            r'page: (http://127\S+)',
            'lpv.recorder.*recording 9 topics',
            'lpv.uio.*measurements flow',
        )
        with urllib.request.urlopen(page, timeout=10) as answer:
            assert answer.status == 200
        first, deadline = tmp_path / 'bag' / 'bag.mcap', time.monotonic() + 30.0
        while first.stat().st_size <= 10_000:  # what is younger than a second may be lost
            assert time.monotonic() < deadline
            time.sleep(0.1)
        os.kill(int(uio), signal.SIGKILL)
        os.kill(int(recorder), signal.SIGKILL)
        until(
            started.format('uio'),
            'lpv.uio.*measurements flow',
            'lpv.recorder.*bag exists already: recording into .*bag_1',
        )
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)  # so that no node outlives the test
            process.communicate(timeout=90)
    assert process.returncode == 1  # two of them died
    assert rest.count('process has finished cleanly') == 5
    for name, finished in (('bag', False), ('bag_1', True)):
        assert (tmp_path / name / 'metadata.yaml').exists() == finished
        assert (tmp_path / name / f'{name}.mcap').stat().st_size > 10_000
        assert (tmp_path / name / 'gains.yaml').is_file()


STARTING = """
import time
print('importing', flush=True)
time.sleep(30.0)
"""
STARTED = """
import signal, sys, time
def stop(number, frame):
    print('caught', signal.Signals(number).name, flush=True)
    time.sleep(0.5)
    sys.exit()
signal.signal(signal.SIGTERM, stop)
signal.signal(signal.SIGINT, stop)
print('started', flush=True)
while True:
    time.sleep(0.05)
"""


@pytest.fixture
def node(tmp_path, monkeypatch):
    """Install a Python program as the node of a package; its element in a launch file."""

    def install(program):
        prefix = tmp_path / 'prefix'
        path = prefix / 'lib' / 'some_package' / 'some_node'
        path.parent.mkdir(parents=True)
        path.write_text(f'#!{sys.executable}\n{program}')
        path.chmod(0o755)
        entry = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'some_package'
        entry.parent.mkdir(parents=True)
        entry.touch()
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))
        return '<node pkg="some_package" exec="some_node" name="n" output="screen"/>'

    return install


def test_given_a_node_that_is_importing_when_interrupted_then_it_ends_without_a_traceback(
    launch, node
):
    process = launch(node(STARTING))
    wait_for_line(process, 'importing')
    process.send_signal(signal.SIGINT)
    code, text = ended(process)
    assert code == 0
    assert 'Traceback' not in text
    assert re.search(
        r'\[INFO\] \[some_node-1\]: process was stopped before it had started \[pid \d+\]\n', text
    )


def test_given_a_node_that_has_started_when_interrupted_twice_then_it_gets_sigint_once(
    launch, node
):
    process = launch(node(STARTED))
    wait_for_line(process, 'started$')
    process.send_signal(signal.SIGINT)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    code, text = ended(process)
    assert code == 0
    assert re.findall('caught (SIG[A-Z]+)', text) == ['SIGINT']
    assert 'process has finished cleanly' in text
