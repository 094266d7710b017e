import os
import re
import shutil
import signal
import sys
from pathlib import Path

import pytest
import ros
import yaml
from places import BRINGUP
from ros2_commands import Running

from lpv.core.support.resources import shipped_files
from lpv_ros2cli.command_line import CliError
from lpv_ros2cli.launch import Launch
from lpv_ros2cli.main import main

FILES = {path.name.partition('.')[0]: path for path in (BRINGUP / 'launch').glob('*.xml')}
NODE = '<node pkg="lpv_uio" exec="uio"'


def programs(path, **given):
    launch = Launch(given)
    launch.include(path)
    return {program.name.rpartition('-')[0]: program for program in launch.programs}


def options(program, option):
    return [b for a, b in zip(program.command, program.command[1:]) if a == option]


def parameters(program):
    pairs = (text.split(':=', 1) for text in options(program, '-p'))
    return {name: yaml.safe_load(value) for name, value in pairs}


@pytest.mark.parametrize(('given', 'scenario'), [
    ({'arm': 'paper'}, 'two_faults'), ({'arm': 'real_arm'}, 'real_arm'), ({'arm': 'ur10'}, 'ur10'),
    ({'arm': '../my arm.yaml', 'scenario': '/x/s.yaml'}, '/x/s.yaml'),
    ({'arm_file': '../my arm.yaml', 'scenario_file': '/x/s.yaml'}, '/x/s.yaml'),
])  # fmt: skip
def test_given_an_arm_when_launched_then_nodes_get_its_scenario_and_gains(given, scenario):
    arm, *_ = given.values()
    found = programs(FILES['pipeline'], **given)
    assert list(found) == ['tracker', 'simulator', 'uio']
    for program in found.values():
        files = [Path(file) for file in options(program, '--params-file')]
        assert all(file.is_file() for file in files)
        assert len(given) > 1 or ('gains', f'{arm}.yaml') in [file.parts[-2:] for file in files]
        assert parameters(program)['arm_file'] == arm and program.ends_all and not program.respawn
    for name in ('tracker', 'simulator'):
        assert parameters(found[name])['scenario_file'] == scenario
    assert len(given) > 1 or scenario in shipped_files('scenarios')


def test_given_arguments_when_launched_then_they_are_forwarded_to_every_node(tmp_path):
    given = dict.fromkeys(('record', 'view', 'respawn'), 'true')
    given |= {'bag': 'my bag', 'view_port': '0', 'namespace': 'cell/arm', 'log_level': 'debug'}
    given |= {'params_file': str(tmp_path / 'my own.yaml'), 'gains_file': '/my/gains.yaml'}
    given['joint_states'] = '/x'
    found = programs(FILES['pipeline'], **given)
    assert list(found) == ['recorder', 'tracker', 'simulator', 'view', 'uio']
    for program in found.values():
        assert (program.respawn, program.respawn_delay, program.ends_all) == (True, 1.0, False)
        assert program.grace == 30.0 and options(program, '--log-level') == ['debug']
        assert {'__ns:=/cell/arm', 'joint_states:=/x'} <= {*options(program, '-r')}
        assert '/my/gains.yaml' in options(program, '--params-file')
        assert program.command[-1] == given['params_file']  # after all others
    values = {name: parameters(program) for name, program in found.items()}
    assert (values['recorder']['output'], values['view']['port']) == ('my bag', 0)
    assert values['recorder']['gains_file'] == '/my/gains.yaml'
    assert {values[n]['await_recorders'] for n in ('tracker', 'simulator', 'uio')} == {1}


def test_given_a_bag_that_is_played_when_launched_then_the_observer_takes_its_time():
    for told in (False, True):
        given = {'use_sim_time': 'true'} if told else {}
        found = programs(FILES['observer'], arm_file='my_arm.yaml', **given)
        assert parameters(found['uio'])['use_sim_time'] is told


@pytest.mark.parametrize('chosen', [None, 'SUBNET'])
@pytest.mark.parametrize('name', ['pipeline', 'observer'])
def test_given_no_range_when_launched_then_nodes_stay_on_this_machine(monkeypatch, name, chosen):
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE', raising=False)
    if chosen:
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', chosen)
    given = {} if name == 'pipeline' else {'arm_file': 'ur10', 'gains_file': '/my/gains.yaml'}
    found = [program.environment for program in programs(FILES[name], **given).values()]
    assert {one['ROS_AUTOMATIC_DISCOVERY_RANGE'] for one in found} == {chosen or 'LOCALHOST'}


def test_given_the_launch_files_when_their_arguments_are_shown_then_each_is_described(capsys):
    for name in ('observer', 'rviz', 'pipeline'):
        assert main(['launch', str(FILES[name]), 'arm:=ur10', '-s']) == 0
        text = capsys.readouterr().out
        assert text.startswith("Arguments (pass arguments as '<name>:=<value>'):\n\n    '")
        assert 'no description given' not in text
        assert "    'pkg':" not in text  # passed by the file that includes
    assert "    'arm':\n        installed arm" in text
    assert "Valid choices are: ['realtime', 'lockstep']" in text


@pytest.mark.parametrize(('text', 'told'), [
    (f'{NODE} nmae="x"/>', "<node uio>: attribute 'nmae' is not covered"),
    ('<node pkg="lpv_uio"/>', "'exec' of <node> is missing"),
    ('<group><param/></group>', '<param>: is not covered by this ros2 in <group>'),
    (f'{NODE} name="$(var nix)"/>', 'does not exist'), (f'{NODE} name="$(var"/>', 'is not closed'),
    (f'{NODE} if="maybe"/>', 'must be true or false'),
    ('<arg name="a"/>', 'required launch argument: give a:='),
    ('<arg name="a" default="3"><choice value="1"/></arg>', 'one of 1; got'),
    ('<include file="/nowhere.launch.xml"/>', 'nowhere.launch.xml cannot be read'),
    ('<include file="$(dirname)/some.launch.xml"/>', 'included by itself'),
    ('<let name="a" value="$(eval \'__import__(1)\')"/>', 'is not covered'),
])  # fmt: skip
def test_given_a_wrong_launch_file_when_launched_then_one_line_says_why(tmp_path, text, told):
    path = tmp_path / 'some.launch.xml'
    path.write_text(f'<launch>{text}</launch>')
    with pytest.raises(CliError, match=rf'\A.*{re.escape(told)}.*\Z'):  # on one line
        programs(path)


def processes(*given, **options):
    """Run shell programs with options of theirs as a launch does, in a process of its own."""
    code = 'import os, sys; from lpv_ros2cli.processes import Processes, Program\n'
    code += 'programs = [Program(f"p-{i}", ["sh", "-c", text], dict(os.environ), **options)'
    code += f' for i, (text, options) in enumerate({given!r})]\n'
    code += 'sys.exit(Processes(programs).run())'
    return Running(program=[sys.executable, '-c', code], **options)


@pytest.mark.parametrize('unbuffered', ['', '1'])
def test_given_programs_that_print_at_once_when_run_then_no_line_is_within_another(unbuffered):
    prints = 'i=0; while [ $i -lt 500 ]; do echo line; i=$((i + 1)); done'
    environment = dict(os.environ, PYTHONUNBUFFERED=unbuffered)
    with processes((prints, {}), (prints, {}), (prints, {}), env=environment) as launch:
        code, text = launch.end()
    assert code == 0 and len(re.findall(r'^\[p-\d\] line$', text, re.MULTILINE)) == 1500
    assert len(text.splitlines()) == 1500 + 2 * 3  # starts and ends


def test_given_a_line_without_end_when_run_then_the_launch_goes_on_without_it():
    prints = 'head -c 3000000 /dev/zero | tr "\\0" x; echo; echo after'
    with processes((prints, {})) as launch:
        code, text = launch.end()
    assert code == 0 and 'bytes without an end of line)\n' in text
    assert text.count('[p-0] after\n') == 1 and len(text) < 3_000_000


def test_given_processes_when_they_end_then_it_is_told_and_they_start_again_if_asked():
    with processes(('echo one; echo two >&2', {}), ('exit 3', {})) as launch:
        code, text = launch.end()
    assert code == 1 and re.search(r'\[p-0\] one\n(.*\n)*\[p-0\] two\n', text)
    assert re.search(r'\[INFO\] \[p-0\]: process has finished cleanly \[pid \d+\]\n', text)
    assert re.search(r"\[ERROR\] \[p-1\]: process has died \[pid \d+, exit code 3, cmd 'sh", text)
    with processes(('exec sleep 600', {}), ('exit 2', {'ends_all': True})) as launch:
        code, text = launch.end()
    assert code == 1 and 'p-1 has ended: shutting down' in text
    with processes(('echo turn; exit 1', {'respawn': True, 'respawn_delay': 0.05})) as launch:
        for _ in range(3):
            launch.until('turn')
        assert launch.interrupt()[0] == 1


@pytest.mark.usefixtures('signals_as_before')
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_given_a_signal_when_run_then_programs_are_told_once_and_killed_if_deaf(number):
    waits = 'echo ready; while :; do sleep 0.05; done'
    tidy, deaf = f'trap "echo caught; exit 0" TERM; {waits}', f'trap "" TERM; {waits}'
    with processes((tidy, {}), (deaf, {'grace': 0.5})) as launch:
        for _ in range(2):
            launch.until('ready')
        launch.process.send_signal(number)
        code, text = launch.end()
    assert code == 0 and text.count('[p-0] caught\n') == 1
    assert "escalating to 'SIGKILL'" in text


def test_given_a_deaf_child_of_a_program_that_has_ended_when_interrupted_then_it_is_killed():
    child = "trap '' TERM; echo ready; while :; do sleep 0.05; done"
    with processes((f'sh -c "{child}" &', {'grace': 0.5})) as launch:
        launch.until('ready')
        code, text = launch.interrupt()
    assert code == 0 and "escalating to 'SIGKILL'" in text


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_given_files_when_launched_then_nodes_start_and_come_back_and_end_cleanly(tmp_path):
    for kind, name in (('arms', 'paper'), ('scenarios', 'two_faults')):
        shutil.copy(BRINGUP / kind / f'{name}.yaml', tmp_path / f'{kind}.yaml')
    words = ['view:=true', 'view_port:=0', 'foxglove_port:=0', 'respawn:=true']
    words += [f'gains_file:={shipped_files("gains")["paper"]}']
    words += ['arm:=arms.yaml', 'scenario:=scenarios.yaml']
    environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.next_domain()), ROS_LOG_DIR=str(tmp_path))
    with Running('launch', FILES['pipeline'], *words, env=environment, cwd=tmp_path) as launch:
        text = launch.until('lpv.uio.*measurements flow')
        uio = re.search(r'\[uio-\d\]: process started with pid \[(\d+)\]', text).group(1)
        threads = {file.read_text() for file in Path(f'/proc/{uio}/task').glob('*/comm')}
        assert any(name.startswith('dds.') for name in threads)
        assert not any(name.startswith('dds.tls') for name in threads), 'waits for types'
        os.kill(int(uio), signal.SIGKILL)
        launch.until(r'\[uio-\d\]: process started')
        launch.until('lpv.uio.*measurements flow')
        code, text = launch.interrupt(100.0)
    assert code == 1 and text.count('process has finished cleanly') == 4  # one of them died
