"""``pip install .`` in an empty environment: no ROS, no compiler, and the commands work.

What Numba makes of the recursions takes minutes where nothing is cached, so that here it compiles
those of the certificate only; the same functions run as plain Python give the same bits.
"""

import os
import re
import shutil
import subprocess
import sys

import pytest
from places import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
CAMPAIGN = """
name: small
plan: {method: random, runs: 2}
duration: 0.5
factors: {fault.kind: bias, fault.size: 0.3, fault.onset: 0.2}
"""


@pytest.fixture(scope='module')
def lpv(tmp_path_factory):
    """Runs ``lpv`` of a new environment in a folder of its own, with nothing else on the PATH."""
    folder = tmp_path_factory.mktemp('pip')
    subprocess.run([sys.executable, '-m', 'venv', folder / 'env'], check=True)
    leave_out = shutil.ignore_patterns('.*', 'out', 'build', 'test', 'tests')
    source = shutil.copytree(ROOT, folder / 'source', ignore=leave_out)  # building leaves folders
    clean = {k: v for k, v in os.environ.items() if not k.startswith(('PYTHON', 'ROS', 'AMENT'))}
    pip = [folder / 'env/bin/python', '-m', 'pip', 'install', '--quiet', '--no-compile']
    subprocess.run([*pip, f'{source}[campaign]'], check=True, env=clean, cwd=folder)
    given = {'PATH': str(folder / 'env/bin'), 'HOME': str(folder), 'LANG': 'C.UTF-8'}
    options = {'cwd': folder, 'env': given, 'text': True, 'capture_output': True}

    def run(*arguments, code=0, compiled=False):
        given['LPV_NO_JIT'] = str(int(not compiled))
        done = subprocess.run([folder / 'env/bin/lpv', *map(str, arguments)], **options)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    run.folder = folder
    return run


def test_given_no_compiler_when_an_arm_is_designed_and_run_then_its_bags_are_whole(lpv):
    path = str(lpv.folder / 'env/bin')
    assert all(shutil.which(name, path=path) is None for name in ('g++', 'cc', 'ros2'))
    lpv('design', '--arm=paper', '--requirement=paper', '--out=gains.yaml', compiled=True)
    assert 'the certificate holds' in lpv('verify', 'gains.yaml', compiled=True)
    assert list((lpv.folder / '.cache').rglob('*.nbc')), 'nothing was compiled'
    (lpv.folder / 'small.yaml').write_text(CAMPAIGN)
    lpv('campaign', 'small.yaml', '--workers', '0', '--out', 'results')
    lpv('campaign', 'results', '--run', '1', '--bag', 'bag')
    assert (lpv.folder / 'results' / 'report.html').stat().st_size > 10_000
    lpv('replay', 'bag', '--gains', 'bag/gains.yaml', '--arm', 'bag/arm.yaml', '--out', 'again')
    assert '\nsame\n' in lpv('compare', 'bag', 'again', '--exact')
    assert 'the certificate holds' in lpv('report', 'bag', '--out', 'report')
    assert 'the bag is whole' in lpv('recover', 'bag')


NEEDS = {
    **dict.fromkeys(('demo', 'view', 'run a b', 'replay b --publish'), 'ROS 2 is needed.*colcon'),
    'tune study.yaml': r"pip install 'lpv-arm-fdi\[tune\]'",
}


@pytest.mark.parametrize('command', NEEDS)
def test_given_what_is_missing_when_needed_then_one_sentence_says_what_to_install(lpv, command):
    # A loaded machine is first told what is being done.
    *announced, text = lpv(*command.split(), code=2).splitlines()
    assert re.search(NEEDS[command], text)
    assert all(line.endswith(' ...') for line in announced)
