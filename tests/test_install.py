"""Where the ros2 command of ours is installed, tab completion, and the gains that are shipped."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

BIN = Path(sys.prefix) / 'bin'


# ------------------------------------------------------------------ set-up


def script(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'#!/bin/bash\n{text}\n')
    path.chmod(0o755)


@pytest.fixture
def machine(tmp_path):
    """An empty machine: run a function of the set-up with stand-ins for Python and colcon."""
    venv = tmp_path / 'venv'
    script(venv / 'bin' / 'python', f'echo "$@" >> {tmp_path}/built.txt')
    script(tmp_path / 'bin' / 'python-without', 'exit 1')  # imports nothing
    script(tmp_path / 'bin' / 'python-with', 'exit 0')  # imports everything

    def build(python='python-without', source='wheels'):
        (tmp_path / 'built.txt').write_text('')
        command = (
            f'source {ROOT}/tools/setup.sh; build={tmp_path}/build; '
            f'python={tmp_path}/bin/{python}; source={source}; build_workspace'
        )
        path = f'{tmp_path}/bin:/usr/bin:/bin'
        environment = {'PATH': path, 'HOME': str(tmp_path), 'VENV': str(venv)}
        subprocess.run(['bash', '-c', command], env=environment, check=True, capture_output=True)
        return (tmp_path / 'built.txt').read_text()

    build.folder, build.venv = tmp_path, venv
    return build


def test_given_no_ros2cli_or_ours_of_another_environment_when_set_up_then_the_stand_in_is_built(
    machine,
):
    built = machine()
    assert 'colcon' in built and 'tools/lpv_ros2cli' in built
    assert machine() == ''  # done already
    script(machine.folder / 'bin' / 'ros2', 'from lpv_ros2cli.main import main')
    assert machine() == ''  # ours is no real one


@pytest.mark.parametrize('how', ['on the path', 'importable', 'sourced'])
def test_given_a_real_ros2cli_when_set_up_then_ours_is_not_built_and_an_old_one_is_removed(
    machine, how
):
    machine()
    package = machine.venv / 'lib' / 'python3.11' / 'site-packages' / 'lpv_ros2cli'
    stale = [machine.venv / 'bin' / 'ros2', package / 'main.py']
    for path in stale:
        script(path, 'lpv_ros2cli')
    if how == 'on the path':
        script(machine.folder / 'bin' / 'ros2', 'exec real ros2')
    python = 'python-with' if how == 'importable' else 'python-without'
    built = machine(python, 'sourced' if how == 'sourced' else 'wheels')
    assert 'lpv_ros2cli' not in built
    assert [path for path in stale if path.exists()] == []


@pytest.mark.parametrize(
    ('real', 'scripts'), [(True, []), (False, ['ros2 = lpv_ros2cli.main:main'])]
)
def test_given_a_workspace_built_by_hand_when_ros2cli_is_there_then_no_ros2_command_is_made(
    tmp_path, real, scripts
):
    if real:
        script(tmp_path / 'ros2cli' / '__init__.py', '')
    code = (
        'import runpy, setuptools; setuptools.setup = lambda **given: '
        'print(given["entry_points"]["console_scripts"]); runpy.run_path("setup.py")'
    )
    done = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT / 'tools' / 'lpv_ros2cli',
        env=dict(os.environ, PYTHONPATH=str(tmp_path)),
    )
    assert done.stdout.strip() == str(scripts)


# ------------------------------------------------------------------ completion


def completions(line, tmp_path):
    """What the shell offers after a line."""
    answer = tmp_path / 'answer'
    asked = {
        'COMP_LINE': line, 'COMP_POINT': str(len(line)), 'COMP_TYPE': '9', '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_IFS': '\n', '_ARGCOMPLETE_SUPPRESS_SPACE': '1',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(answer), 'ROS_DOMAIN_ID': '99',
    }  # fmt: skip
    program = [str(BIN / line.split()[0])]
    subprocess.run(
        program, env={**os.environ, **asked}, timeout=600, capture_output=True, cwd=tmp_path
    )
    return answer.read_text().split('\n')


@pytest.mark.parametrize(
    ('line', 'offered'),
    [
        ('lpv de', {'demo', 'design'}),
        ('lpv demo --arm ', {'paper', 'real_arm'}),
        ('lpv demo --scenario tw', {'two_faults'}),
        ('lpv run lpv_uio ', {'uio'}),
        ('ros2 topic ', {'echo', 'hz'}),
    ],
)
def test_given_a_line_when_completed_then_what_fits_is_offered(tmp_path, line, offered):
    if line.startswith('ros2'):
        pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')
    assert offered <= set(completions(line, tmp_path))


# ------------------------------------------------------------------ nodes without their files


@pytest.mark.ros
@pytest.mark.parametrize(
    ('words', 'told'),
    [
        (
            ('--params-file', '/nowhere/gains.yaml'),
            'there is no file /nowhere/gains.yaml; gains of an arm are written by: lpv design',
        ),
        (('-p', 'broken'), '--ros-args: '),
        (('--nix',), '--ros-args: '),
    ],
)
def test_given_ros_arguments_that_are_wrong_when_a_node_starts_then_one_line_says_so(words, told):
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    from lpv.core.support.resources import executable

    line = [str(executable('lpv_uio', 'uio')), '--ros-args', *words]
    done = subprocess.run(line, capture_output=True, text=True, timeout=600)
    assert done.returncode == 1
    assert 'Traceback' not in done.stderr
    assert told in done.stderr.splitlines()[-1]
