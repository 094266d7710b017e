"""``pip install .`` in an empty environment: no ROS, no compiler, and the commands work.

What Numba makes of the recursions takes minutes where nothing is cached, so that here it compiles
those of the certificate only; the same functions run as plain Python give the same bits.
"""

import os
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
    # A copy, because building leaves folders behind.
    source = shutil.copytree(
        ROOT,
        folder / 'source',
        ignore=shutil.ignore_patterns('.*', 'out', 'build', 'test', 'tests'),
    )
    clean = {k: v for k, v in os.environ.items() if not k.startswith(('PYTHON', 'ROS', 'AMENT'))}
    pip = [folder / 'env/bin/python', '-m', 'pip', 'install', '--quiet', '--no-compile']
    subprocess.run([*pip, f'{source}[campaign]'], check=True, env=clean, cwd=folder)
    environment = {'PATH': str(folder / 'env/bin'), 'HOME': str(folder), 'LANG': 'C.UTF-8'}

    def run(*arguments, code=0, compiled=False):
        done = subprocess.run(
            [folder / 'env/bin/lpv', *map(str, arguments)],
            cwd=folder,
            env={**environment, 'LPV_NO_JIT': str(int(not compiled))},
            text=True,
            capture_output=True,
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    run.folder = folder
    return run


@pytest.fixture(scope='module')
def bag(lpv):
    """A designed arm, a campaign, and one of its runs as a bag."""
    lpv('design', '--arm=paper', '--requirement=paper', '--out=gains.yaml', compiled=True)
    (lpv.folder / 'small.yaml').write_text(CAMPAIGN)
    lpv('campaign', 'small.yaml', '--workers', '0', '--out', 'results')
    lpv('campaign', 'results', '--run', '1', '--bag', 'bag')
    return 'bag'


def test_given_no_compiler_when_gains_are_verified_then_the_certificate_holds(lpv, bag):
    path = str(lpv.folder / 'env/bin')
    assert all(shutil.which(name, path=path) is None for name in ('g++', 'cc', 'ros2'))
    assert 'the certificate holds' in lpv('verify', 'gains.yaml', compiled=True)
    assert list((lpv.folder / '.cache').rglob('*.nbc')), 'nothing was compiled'


def test_given_a_bag_of_a_campaign_when_replayed_reported_and_recovered_then_it_is_whole(lpv, bag):
    assert (lpv.folder / 'results' / 'report.html').stat().st_size > 10_000
    lpv('replay', bag, '--gains', 'bag/gains.yaml', '--arm', 'bag/arm.yaml', '--out', 'again')
    assert '\nsame\n' in lpv('compare', bag, 'again', '--exact')
    assert 'the certificate holds' in lpv('report', bag, '--out', 'report')
    assert 'the bag is whole' in lpv('recover', bag)


@pytest.mark.parametrize(
    'command', [['demo'], ['view'], ['run', 'a', 'b'], ['replay', 'b', '--publish']]
)
def test_given_a_command_of_nodes_when_called_then_one_sentence_says_what_to_install(lpv, command):
    # A loaded machine is first told what is being done.
    *announced, text = lpv(*command, code=2).splitlines()
    assert 'ROS 2 is needed' in text and 'colcon' in text
    assert all(line.endswith(' ...') for line in announced)


def test_given_a_missing_extra_when_needed_then_the_command_that_installs_it_is_named(lpv):
    assert "pip install 'lpv-arm-fdi[tune]'" in lpv('tune', 'study.yaml', code=2)
