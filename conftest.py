"""Fixtures shared by the tests of the maths: shipped arms, scenario, designed gains."""

import contextlib
import importlib.util
import os
import re
import shutil
import signal
import sys
from dataclasses import replace

import pytest
from hypothesis import settings
from places import ROOT

for _name, _place in (('lpv', 'ros2_ws/src/lpv'), ('lpv_design', 'design/lpv_design')):
    if importlib.util.find_spec(_name) is None:
        sys.path.insert(0, str(ROOT / _place))

# Tests share the machine: before NumPy is loaded, and for all processes that tests start.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

# Compilation takes seconds in the first example; the same examples are drawn in every run, for
# which Hypothesis may not draw constants of the modules that happen to be imported by then.
with contextlib.suppress(ImportError):  # an older one draws none
    providers = importlib.import_module('hypothesis.internal.conjecture.providers')
    providers.is_local_module_file = lambda path: False
settings.register_profile('lpv', deadline=None, derandomize=True, database=None, max_examples=200)
settings.load_profile('lpv')

import lpv  # noqa: E402  # its functions are loaded when asked for: not where nothing is run

_ROS = importlib.util.find_spec('rclpy') is not None
_OF_ROS = re.compile(r'^(import|from) (rclpy|hostile|lpv_node|\w+_msgs)\b', re.MULTILINE)
_STAND_IN = importlib.util.find_spec('lpv_ros2cli') is not None  # where there is no ros2cli


def pytest_report_header():
    return None if _ROS else 'no ROS 2, neither wheels nor a sourced one: no tests of nodes'


def pytest_ignore_collect(collection_path, config):
    """Tests of nodes need ROS 2, those of our ros2 that it is there; files without a test of the
    markers asked for are not imported."""
    if not collection_path.name.startswith('test_'):
        return None
    text, marker = collection_path.read_text(encoding='utf-8'), config.option.markexpr
    unmarked = marker.isidentifier() and f'mark.{marker}' not in text
    left_out = [] if ' or ' in marker else re.findall(r'\bnot (\w+)', marker)
    whole = (rf'^pytestmark = .*mark\.{one}\b' for one in left_out)  # all tests of the file
    marked = any(re.search(one, text, re.MULTILINE) for one in whole)
    no_ros2 = not _STAND_IN and 'lpv_ros2cli' in collection_path.parts
    return unmarked or marked or no_ros2 or (not _ROS and bool(_OF_ROS.search(text))) or None


def pytest_configure():
    """A run that is cancelled stops the nodes that it started, as one that is interrupted does."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # A shell without job control has it ignored, and all that tests start would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def signals_as_before():
    """What a test sets is reset; SIGHUP acts, also where nohup has it ignored."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope='session')
def paper_arm():
    """Arm of the paper's Table 1."""
    return lpv.load_arm('paper')


@pytest.fixture(scope='session')
def real_arm():
    """Arm of the recordings: relative encoders, hanging, with rotors and friction."""
    return lpv.load_arm('real_arm')


def in_plane(arm):
    from lpv.core.uio.planar import planar_model

    return planar_model(arm)


@pytest.fixture(scope='session')
def paper_model(paper_arm):
    """The same in the paper's symbols, as designs take it."""
    return in_plane(paper_arm)


@pytest.fixture(scope='session')
def real_model(real_arm):
    return in_plane(real_arm)


@pytest.fixture(params=['paper_arm', 'real_arm'])
def arm(request):
    """Both arms in turn; of function scope, so that tests keep the order of their files."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def planar(arm):
    """The same in the paper's symbols."""
    return in_plane(arm)


@pytest.fixture(scope='session')
def two_faults():
    """Shipped scenario with an abrupt and an incipient fault."""
    return lpv.load_scenario('two_faults')


@pytest.fixture(scope='session')
def paper_gains():
    """Shipped gains as a design returns them: tests change what a checksum of a file would tell."""
    return replace(lpv.load_gains('paper'), checksum='')


@pytest.fixture(scope='session')
def real_gains():
    return replace(lpv.load_gains('real_arm'), checksum='')


@pytest.fixture(scope='session')
def literal_gains(paper_arm):
    """Gains of the shipped requirement ``paper_literal``: LMI (55) as published."""
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    return design(paper_arm, load_requirement('paper_literal')).gains


@pytest.fixture(scope='session')
def gains_of(paper_gains, real_gains):
    """Gains by the arm's name."""
    return {'paper': paper_gains, 'real_arm': real_gains}


@pytest.fixture
def call(capsys):
    """Calls a command that has to end with a code, without a traceback; what it printed."""
    from lpv.cli.main import main

    def run(*words, code=0):
        capsys.readouterr()
        assert main([str(word) for word in words]) == code
        said = capsys.readouterr()
        assert 'Traceback' not in said.out + said.err
        return said

    return run


@pytest.fixture
def refused(call):
    """Calls a command that has to refuse: code 2, and one line that begins with its name."""

    def run(told, command, *arguments):
        said = call(command, *arguments, code=2).err
        assert said.startswith(f'lpv {command}: ') and said.count('\n') == 1 and told in said, said
        return True

    return run


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    """A headless Chromium with an empty profile of its own."""
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    names = os.environ.get('CHROMIUM'), shutil.which('chromium'), shutil.which('chromium-browser')
    program = next(filter(None, names), None)
    if program is None:
        pytest.skip('there is no Chromium: apt-get install chromium, or set CHROMIUM')
    flags = '--headless --no-sandbox --disable-gpu --disable-quic --no-first-run'
    flags += ' --disable-background-networking --disable-component-update --disable-sync'
    options = {'executable_path': program, 'args': flags.split(), 'headless': True}
    profile = str(tmp_path_factory.mktemp('profile'))
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch_persistent_context(profile, **options)
        yield started
        started.close()


@pytest.fixture
def quiet(caplog):
    """Ten thousands of warnings about bags are not worth keeping."""
    caplog.set_level('CRITICAL', 'lpv.bag')
