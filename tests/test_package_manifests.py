"""What a package imports is in its manifest: keys of rosdep, or a remark on what is on PyPI."""

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted((ROOT / 'ros2_ws' / 'src').iterdir())
# Keys of rosdep that are known on Ubuntu 24.04.
KEYS = {'numpy': 'python3-numpy', 'scipy': 'python3-scipy', 'yaml': 'python3-yaml',
        'matplotlib': 'python3-matplotlib', 'jinja2': 'python3-jinja2', 'rich': 'python3-rich',
        'packaging': 'python3-packaging', 'argcomplete': 'python3-argcomplete',
        'aiohttp': 'python3-aiohttp', 'filterpy': 'python3-filterpy-pip'}
# Libraries that no key of rosdep, or none for Ubuntu 24.04, stands for.
PYPI = {'cvxpy': 'cvxpy', 'distributed': 'distributed', 'foxglove': 'foxglove-sdk', 'lz4': 'lz4',
        'mcap': 'mcap', 'mujoco': 'mujoco', 'numba': 'numba', 'optuna': 'optuna',
        'pinocchio': 'pin', 'pyarrow': 'pyarrow', 'rosbags': 'rosbags', 'sqlalchemy': 'sqlalchemy',
        'zstandard': 'zstandard'}


def imported(package):
    """Names of the top-level packages that the sources of a package import, wherever."""
    names = set()
    for file in (package / package.name).rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - {package.name}


@pytest.mark.parametrize('package', PACKAGES, ids=lambda p: p.name)
def test_given_a_package_when_its_imports_are_looked_up_then_the_manifest_names_them(package):
    text = (package / 'package.xml').read_text()
    declared = {e.text for e in ElementTree.fromstring(text) if e.tag.endswith('depend')}
    remarks = ' '.join(re.findall(r'<!--(.*?)-->', text, re.DOTALL))
    missing = []
    for name in imported(package):
        if name in PYPI:
            known = re.search(rf'\b{PYPI[name]}\b', remarks)
        else:
            known = KEYS.get(name, name) in declared
        if not known:
            missing.append(name)
    assert sorted(missing) == []
    unknown = {d for d in declared if d.startswith('python3-')} - {*KEYS.values(), 'python3-pytest'}
    assert unknown == set()


def test_given_libraries_from_pypi_when_set_up_then_they_are_asked_for():
    lines = '\n'.join(p.read_text() for p in (ROOT / 'requirements').glob('*.txt'))
    asked = set(re.findall(r'^([a-z0-9-]+)', lines, re.MULTILINE))
    assert set(PYPI.values()) <= asked
