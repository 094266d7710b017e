import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT


def script(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'#!/bin/bash\n{text}\n')
    path.chmod(0o755)


@pytest.fixture
def machine(tmp_path):
    """An empty machine: run a function of the set-up with stand-ins for Python and colcon."""
    venv, built = tmp_path / 'venv', tmp_path / 'built.txt'
    script(venv / 'bin' / 'python', f'echo "$@" >> {built}')
    script(tmp_path / 'bin' / 'python-without', 'exit 1')  # imports nothing
    script(tmp_path / 'bin' / 'python-with', 'exit 0')  # imports everything

    def build(python='python-without', source='wheels'):
        built.write_text('')
        given = f'build={tmp_path}/build; python={tmp_path}/bin/{python}; source={source}'
        line = ['bash', '-c', f'source {ROOT}/tools/setup.sh; {given}; build_workspace']
        path = f'{tmp_path}/bin:/usr/bin:/bin'
        environment = {'PATH': path, 'HOME': str(tmp_path), 'VENV': str(venv)}
        subprocess.run(line, env=environment, check=True, capture_output=True)
        return built.read_text()

    build.folder, build.venv = tmp_path, venv
    return build


def test_given_no_ros2cli_or_that_of_another_place_when_set_up_then_ours_is_built(machine):
    built = machine()
    assert 'colcon' in built and 'tools/lpv_ros2cli' in built
    assert machine() == ''  # done already
    script(machine.folder / 'bin' / 'ros2', 'from lpv_ros2cli.main import main')
    assert machine() == ''  # ours is no real one


@pytest.mark.parametrize('how', ['on the path', 'importable', 'sourced'])
def test_given_a_real_ros2cli_when_set_up_then_ours_is_not_built_but_removed(machine, how):
    machine()
    package = machine.venv / 'lib' / 'python3.11' / 'site-packages' / 'lpv_ros2cli'
    stale = [machine.venv / 'bin' / 'ros2', package / 'main.py']
    for path in stale:
        script(path, 'lpv_ros2cli')
    if how == 'on the path':
        script(machine.folder / 'bin' / 'ros2', 'exec real ros2')
    python = 'python-with' if how == 'importable' else 'python-without'
    assert 'lpv_ros2cli' not in machine(python, 'sourced' if how == 'sourced' else 'wheels')
    assert [path for path in stale if path.exists()] == []


def test_given_a_set_up_that_is_done_when_set_up_again_then_nothing_is_done():
    environment = Path(sys.prefix)
    if not (environment / '.lpv').is_dir() or environment.parent != ROOT:
        pytest.skip('this environment was not made by tools/setup.sh of this checkout')
    line, given = [ROOT / 'tools' / 'setup.sh', 'test'], {**os.environ, 'VENV': sys.prefix}
    result = subprocess.run(line, env=given, text=True, capture_output=True, timeout=2000)
    assert (result.returncode, result.stdout) == (0, ''), result.stdout + result.stderr


@pytest.mark.parametrize(('line', 'offered'), [
    ('lpv de', {'demo', 'design'}), ('lpv demo --arm ', {'paper', 'real_arm'}),
    ('lpv demo --scenario tw', {'two_faults'}), ('lpv run lpv_uio ', {'uio'}),
    ('lpv campaign sm', {'smoke'}), ('lpv tune sm', {'smoke'}),
    ('ros2 topic ', {'echo', 'hz'}),
])  # fmt: skip
def test_given_a_line_when_completed_then_what_fits_is_offered(tmp_path, line, offered):
    if line.startswith('ros2'):
        pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')
    answer = tmp_path / 'answer'
    asked = {
        'COMP_LINE': line, 'COMP_POINT': str(len(line)), 'COMP_TYPE': '9', '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_IFS': '\n', '_ARGCOMPLETE_SUPPRESS_SPACE': '1',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(answer), 'ROS_DOMAIN_ID': '99',
    }  # fmt: skip
    program, environment = [Path(sys.prefix) / 'bin' / line.split()[0]], {**os.environ, **asked}
    subprocess.run(program, env=environment, timeout=600, capture_output=True, cwd=tmp_path)
    assert offered <= set(answer.read_text().split('\n'))


# Script, options without the user's own files, what to ask, and what the answer holds.
SHELLS = {
    'bash': ('env.sh', '--norc', 'complete -p lpv', '_python_argcomplete'),
    'zsh': ('env.zsh', '-f', 'print ${_comps[lpv]}', '_python_argcomplete'),
    'fish': ('env.fish', '-N', 'complete -C "lpv ver"', 'verify'),
}


@pytest.mark.parametrize('shell', SHELLS)
def test_given_a_shell_when_its_script_is_sourced_then_lpv_is_found_and_completed(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f'{shell} is not installed')
    script, bare, question, answer = SHELLS[shell]
    given = {k: v for k, v in os.environ.items() if k not in ('ROS_DISTRO', 'PYTHONPATH')}
    given |= {'VENV': sys.prefix, 'PATH': '/usr/bin:/bin', 'HOME': str(tmp_path)}
    text = f'source {ROOT / "tools" / script}\ntype lpv\n{question}\n'
    line, options = [shell, bare, '-i', '-c', text], {'capture_output': True, 'text': True}
    done = subprocess.run(line, env=given, stdin=subprocess.DEVNULL, **options)
    assert f'{sys.prefix}/bin/lpv' in done.stdout and answer in done.stdout
    assert 'not found' not in done.stdout + done.stderr


CAMPAIGN = """
name: small
designs: [gains.yaml]
plan: {method: random, runs: 1}
duration: 0.06
factors: {fault.kind: bias, fault.size: 0.3, fault.onset: 0.02}
"""


@pytest.fixture(scope='module')
def lpv(tmp_path_factory):
    """Runs ``lpv`` of a new environment in a folder of its own, with nothing else on the PATH.

    What Numba makes of the recursions takes minutes where nothing is cached, so that here it
    compiles those of the certificate only; the same functions as plain Python give the same bits.
    """
    folder = tmp_path_factory.mktemp('pip')
    subprocess.run([sys.executable, '-m', 'venv', folder / 'env'], check=True)
    leave_out = shutil.ignore_patterns('.*', 'out', 'build', 'test', 'tests')
    source = shutil.copytree(ROOT, folder / 'source', ignore=leave_out)  # building leaves folders
    clean = {k: v for k, v in os.environ.items() if not k.startswith(('PYTHON', 'ROS', 'AMENT'))}
    # By uv or pip, as the set-up does it.
    install = f'source {ROOT}/tools/setup.sh; source=wheels; install_packages lpv "$0"'
    line, place = ['bash', '-c', install, f'{source}[campaign]'], {'VENV': str(folder / 'env')}
    subprocess.run(line, check=True, env={**clean, **place}, cwd=folder)
    given = {'PATH': str(folder / 'env/bin'), 'HOME': str(folder), 'LANG': 'C.UTF-8'}
    options = {'cwd': folder, 'env': given, 'text': True, 'capture_output': True}

    def run(*arguments, code=0, compiled=False):
        given['LPV_NO_JIT'] = str(int(not compiled))
        done = subprocess.run([folder / 'env/bin/lpv', *map(str, arguments)], **options)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    run.folder = folder
    return run


@pytest.mark.slow
def test_given_no_compiler_when_an_arm_is_designed_and_run_then_its_bags_are_whole(lpv):
    path = str(lpv.folder / 'env/bin')
    assert all(shutil.which(name, path=path) is None for name in ('g++', 'cc', 'ros2'))
    lpv('design', '--arm=paper', '--requirement=paper', '--out=gains.yaml', compiled=True)
    assert 'the certificate holds' in lpv('verify', 'gains.yaml', compiled=True)
    assert list((lpv.folder / '.cache').rglob('*.nbc')), 'nothing was compiled'
    (lpv.folder / 'small.yaml').write_text(CAMPAIGN)
    lpv('campaign', 'small.yaml', '--workers', '0', '--out', 'results')
    lpv('campaign', 'results', '--run', '0', '--bag', 'bag')
    assert (lpv.folder / 'results' / 'report.html').stat().st_size > 10_000
    lpv('replay', 'bag', '--gains', 'bag/gains.yaml', '--arm', 'bag/arm.yaml', '--out', 'again')
    assert '\nsame\n' in lpv('compare', 'bag', 'again', '--exact')
    assert 'the certificate holds' in lpv('report', 'bag', '--out', 'report')
    assert 'the bag is whole' in lpv('recover', 'bag')


NEEDS = {
    **dict.fromkeys(('demo', 'view', 'run a b', 'replay b --publish'), 'ROS 2 is needed.*colcon'),
    'tune study.yaml': r"pip install 'lpv-arm-fdi\[tune\]'",
}


@pytest.mark.slow
@pytest.mark.parametrize('command', NEEDS)
def test_given_what_is_missing_when_needed_then_one_sentence_says_what_to_install(lpv, command):
    # A loaded machine is first told what is being done.
    *announced, text = lpv(*command.split(), code=2).splitlines()
    assert re.search(NEEDS[command], text) and all(line.endswith(' ...') for line in announced)
