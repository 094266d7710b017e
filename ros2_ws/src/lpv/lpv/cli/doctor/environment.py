"""Checks of what is installed and how the shell is set up."""

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

from lpv.cli.completion import PROGRAMS
from lpv.cli.doctor.finding import Finding, error, ok, warn
from lpv.core.support.errors import LpvError
from lpv.core.support.resources import executable, installed_version

REQUIREMENTS = (
    'numpy>=1.24,<3', 'scipy>=1.10,<2', 'numba>=0.59,<1', 'pyyaml>=6,<7', 'cvxpy-base>=1.5,<1.8',
    'clarabel>=0.9,<1', 'matplotlib>=3.7,<4', 'jinja2>=3.1,<4', 'rich>=13,<16', 'mcap>=1.6,<2',
    'rosbags>=0.11.9,<0.12',
)  # fmt: skip
"""As in requirements/base.txt, which is not installed."""
_SAME = {'cvxpy-base': 'cvxpy'}
"""Distributions that do as well."""
_RANGES = ('LOCALHOST', 'SUBNET', 'SYSTEM_DEFAULT')
_PROBE = """
import importlib.util
spec = importlib.util.find_spec('rclpy')
if spec is None:
    raise SystemExit("No module named 'rclpy'")
print('lpv', spec.origin, flush=True)
from rclpy.utilities import get_rmw_implementation_identifier
print('lpv', get_rmw_implementation_identifier(), flush=True)
"""
_LARGEST_DOMAIN, _SAFE_DOMAIN = 232, 101
"""Domains above the second have ports that the operating system also gives to others."""


class RosProbe(NamedTuple):
    """What another process found: rclpy ends a process whose middleware is missing."""

    file: str  # of rclpy; empty where it cannot be imported
    middleware: str  # that was loaded; empty where none could be
    problem: str  # last line of what was printed


def check_environment() -> list[Finding]:
    """Run all checks of this module."""
    probe = probe_ros()
    plain = (check_python, check_packages, check_compiler, check_workspace, check_domain)
    found = [check() for check in plain]
    return [*found, check_ros(probe), check_middleware(probe), check_range()]


def check_python() -> Finding:
    """Version of Python."""
    version = '.'.join(map(str, sys.version_info[:3]))
    if (3, 10) <= sys.version_info[:2] <= (3, 13):
        return ok('python', version)
    return warn('python', f'{version} is not tried', 'use Python 3.10 to 3.13')


def check_packages(requirements: Sequence[str] = REQUIREMENTS) -> Finding:
    """Versions of the Python packages that all commands need."""
    from packaging.requirements import Requirement

    bad = []
    for wanted in map(Requirement, requirements):
        names = wanted.name, _SAME.get(wanted.name, wanted.name)
        version = next(filter(None, map(installed_version, names)), '')
        if not version:
            bad.append(f'{wanted.name} is missing')
        elif not wanted.specifier.contains(version, prereleases=True):
            bad.append(f'{wanted.name} is {version}, {wanted.specifier} is needed')
    if bad:
        remedy = 'make setup, or pip install -r requirements/base.txt'
        return error('packages', '; '.join(bad), remedy)
    return ok('packages', f'{len(requirements)} packages in the versions that are needed')


def check_compiler() -> Finding:
    """Whether the recursions run compiled."""
    from lpv.core.support.jit import COMPILED

    if COMPILED:
        return ok('compiler', 'the numerical code is compiled')
    text = 'the numerical code runs as plain Python, too slowly for real time'
    return warn('compiler', text, 'unset LPV_NO_JIT and NUMBA_DISABLE_JIT, and install numba')


def probe_ros() -> RosProbe:
    """Import rclpy in another process."""
    line = [sys.executable, '-c', _PROBE]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300.0)
    lines = [line[4:] for line in done.stdout.splitlines() if line.startswith('lpv ')]
    printed = [line for line in done.stderr.splitlines() if line.strip()]
    problem = re.sub(r', at /.*', '', printed[-1].split(']: ')[-1]) if printed else ''
    file, middleware = (lines + ['', ''])[:2]
    return RosProbe(file, middleware, problem)


def check_ros(probe: RosProbe | None = None) -> Finding:
    """Whether there is one ROS 2, and only one."""
    distro, probe = os.environ.get('ROS_DISTRO', ''), probe or probe_ros()
    if not probe.file:
        text = f'rclpy cannot be imported: {probe.problem}'
        return error('ros', text, 'make setup, or source the ROS 2 that it was run with')
    inside = os.path.realpath(probe.file).startswith(os.path.realpath(sys.prefix) + os.sep)
    if distro and inside and sys.prefix != sys.base_prefix:
        text = f'ROS 2 {distro} is sourced, but rclpy comes from wheels in {sys.prefix}: '
        remedy = 'use a shell without ROS 2, or make clean setup with ROS 2 sourced'
        return error('ros', text + 'two builds of the same libraries', remedy)
    return ok('ros', f'{distro} is sourced' if distro else 'from wheels')


def check_workspace() -> Finding:
    """Whether messages and programs of this workspace are built."""
    try:
        importlib.import_module('lpv_msgs.msg')
        for package, program in PROGRAMS.items():
            executable(package, program)
    except (ImportError, LpvError) as problem:
        remedy = 'make setup, or colcon build and source install/setup.bash'
        return error('workspace', str(problem), remedy)
    return ok('workspace', 'messages and programs are there')


def check_middleware(probe: RosProbe | None = None) -> Finding:
    """Whether the middleware that is asked for is installed."""
    wanted, probe = os.environ.get('RMW_IMPLEMENTATION', ''), probe or probe_ros()
    remedy = f'install {wanted}, or unset RMW_IMPLEMENTATION' if wanted else 'make setup'
    if not probe.middleware:
        return error('middleware', probe.problem or 'none could be loaded', remedy)
    if wanted and wanted != probe.middleware:
        text = f'RMW_IMPLEMENTATION is {wanted}, but {probe.middleware} is loaded'
        return error('middleware', text, remedy)
    return ok('middleware', probe.middleware)


def check_domain() -> Finding:
    """Whether ROS_DOMAIN_ID is a domain."""
    text = os.environ.get('ROS_DOMAIN_ID', '')
    remedy = 'export ROS_DOMAIN_ID=N with N from 0 to 101, the same for all nodes'
    if not text:
        return ok('domain', '0 (ROS_DOMAIN_ID is not set)')
    if not text.isdecimal() or int(text) > _LARGEST_DOMAIN:
        return error('domain', f'ROS_DOMAIN_ID is {text!r}', remedy)
    if int(text) > _SAFE_DOMAIN:
        return warn('domain', f'ROS_DOMAIN_ID {text} has ports that programs use at random', remedy)
    return ok('domain', text)


def check_range() -> Finding:
    """Where nodes are looked for."""
    name = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    text, remedy = os.environ.get(name, ''), f'export {name}=LOCALHOST (or SUBNET)'
    if os.environ.get('ROS_LOCALHOST_ONLY', '') == '1':
        said = f'ROS_LOCALHOST_ONLY overrides {name} and is out of use'
        return warn('discovery', said, 'unset ROS_LOCALHOST_ONLY')
    if text and text not in _RANGES:
        return error('discovery', f'{name} is {text!r}: nodes do not find each other', remedy)
    return ok('discovery', text or 'LOCALHOST (of lpv, as nothing is set)')
