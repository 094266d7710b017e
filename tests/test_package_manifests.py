"""Manifests: what a package imports is named, what it ships is installed, versions agree."""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import setuptools
from places import ROOT

PACKAGES = sorted((ROOT / 'ros2_ws' / 'src').iterdir())
PYTHON_PACKAGES = [package for package in PACKAGES if (package / 'setup.py').is_file()]
# Keys of rosdep (rosdistro, rosdep/python.yaml).
KEYS = {
    'numpy': 'python3-numpy',
    'scipy': 'python3-scipy',
    'yaml': 'python3-yaml',
    'matplotlib': 'python3-matplotlib',
    'jinja2': 'python3-jinja2',
    'rich': 'python3-rich',
    'packaging': 'python3-packaging',
    'argcomplete': 'python3-argcomplete',
    'aiohttp': 'python3-aiohttp',
    'filterpy': 'python3-filterpy-pip',
    'numba': 'python3-numba',
    'sqlalchemy': 'python3-sqlalchemy',
    'cvxpy': 'python3-cvxpy-pip',
    'rosbags': 'python3-rosbags-pip',
    'mujoco': 'python3-mujoco-pip',
    'hypothesis': 'python3-hypothesis',
}
TEST_KEYS = {'python3-pytest', 'python3-pytest-timeout'}
# Libraries that no key of rosdep stands for.
PYPI = {
    'cmaes': 'cmaes',
    'distributed': 'distributed',
    'foxglove': 'foxglove-sdk',
    'lz4': 'lz4',
    'mcap': 'mcap',
    'optuna': 'optuna',
    'pinocchio': 'pin',
    'pyarrow': 'pyarrow',
    'zstandard': 'zstandard',
}
OWN = {package.name for package in PACKAGES}
BY_NAME = {'argvalues': PACKAGES, 'ids': lambda p: p.name}


def manifest(package):
    """Root element of a package's manifest, and its comments as one text."""
    text = (package / 'package.xml').read_text()
    return ElementTree.fromstring(text), ' '.join(re.findall(r'<!--(.*?)-->', text, re.DOTALL))


def imported(folder):
    """Names of the top-level packages that the sources in a folder import, wherever."""
    names = set()
    for file in folder.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names)


@pytest.mark.parametrize('package', **BY_NAME)
def test_given_a_package_when_its_imports_are_looked_up_then_the_manifest_names_them(package):
    root, remarks = manifest(package)
    declared = {e.text for e in root if e.tag.endswith('depend')}
    missing = []
    for name in imported(package / package.name) - {package.name}:
        if name in PYPI:
            known = re.search(rf'\b{PYPI[name]}\b', remarks)
        else:
            known = KEYS.get(name, name) in declared
        if not known:
            missing.append(name)
    assert sorted(missing) == []
    unknown = {d for d in declared if d.startswith('python3-')} - {*KEYS.values(), *TEST_KEYS}
    assert unknown == set()


@pytest.mark.parametrize('package', **BY_NAME)
def test_given_the_tests_of_a_package_when_looked_up_then_the_manifest_names_their_libraries(
    package,
):
    if (package / 'test').is_symlink():
        pytest.skip('tests of several packages together: all of them are needed')
    root, _ = manifest(package)
    declared = {e.text for e in root if e.tag.endswith('depend')}
    needed = {KEYS[name] for name in imported(package / 'test') if name in ('hypothesis',)}
    assert needed <= declared


def test_given_libraries_from_pypi_when_set_up_then_they_are_asked_for():
    lines = '\n'.join(p.read_text() for p in (ROOT / 'requirements').glob('*.txt'))
    asked = set(re.findall(r'^([a-z0-9-]+)', lines, re.MULTILINE))
    assert set(PYPI.values()) <= asked


def test_given_the_launch_files_when_run_by_a_real_launch_then_the_manifest_names_what_reads_them():
    root, _ = manifest(ROOT / 'ros2_ws' / 'src' / 'lpv_bringup')
    assert {'launch_xml', 'launch_ros', 'ros2launch'} <= {e.text for e in root}


def options_of(package, monkeypatch):
    """What a package's setup.py hands to setuptools."""
    options = {}
    monkeypatch.chdir(package)
    monkeypatch.setattr(setuptools, 'setup', options.update)
    runpy.run_path(str(package / 'setup.py'))
    return options


@pytest.mark.parametrize('package', PYTHON_PACKAGES, ids=lambda p: p.name)
def test_given_a_package_when_installed_then_all_that_it_ships_is_installed(package, monkeypatch):
    options = options_of(package, monkeypatch)
    installed = {Path(file) for _, files in options['data_files'] for file in files}
    for name, patterns in options.get('package_data', {}).items():
        folder = Path(*name.split('.'))
        installed |= {path for pattern in patterns for path in folder.glob(pattern)}
    inside = {
        path
        for path in Path(package.name).rglob('*')
        if path.is_file() and path.suffix != '.py' and '__pycache__' not in path.parts
    }
    shared = {
        path
        for folder in {path.parts[0] for path in installed} - {package.name, 'resource'}
        for path in Path(folder).rglob('*')
        if path.is_file()
    }
    assert {p for p in inside | shared if not p.parts[-2].startswith('.')} - installed == set()
    names = {'.'.join(p.parent.parts) for p in Path(package.name).rglob('__init__.py')}
    assert names == set(options['packages'])


@pytest.mark.parametrize('package', **BY_NAME)
def test_given_a_package_when_released_then_manifest_set_up_and_changelog_agree(
    package, monkeypatch
):
    root, _ = manifest(package)
    version = root.findtext('version')
    for name in ('name', 'description', 'maintainer', 'license'):
        assert root.findtext(name).strip()
    assert root.findtext('name') == package.name
    citation = (ROOT / 'CITATION.cff').read_text()
    assert re.search(r'^version: (.+)$', citation, re.MULTILINE).group(1) == version
    title, *_ = changelog = (package / 'CHANGELOG.rst').read_text().splitlines()
    assert changelog[1] == f'Changelog for package {package.name}'
    assert title == changelog[2] == '^' * len(changelog[1])
    sections = [line for line in changelog if re.match(r'Forthcoming$|\d+\.\d+\.\d+ \(', line)]
    assert version in {line.split()[0] for line in sections}
    if package in PYTHON_PACKAGES:
        options = options_of(package, monkeypatch)
        assert (options['version'], options['license']) == (version, root.findtext('license'))


@pytest.mark.parametrize('package', PYTHON_PACKAGES, ids=lambda p: p.name)
def test_given_a_package_when_tested_alone_then_it_has_tests(package):
    assert sorted((package / 'test').glob('test_*.py'))


def test_given_the_pytest_plugins_of_a_ros2_when_on_the_path_then_they_do_not_stop_the_tests(
    tmp_path,
):
    (tmp_path / 'old_plugin.py').write_text('def pytest_pycollect_makemodule(path, parent): pass\n')
    info = tmp_path / 'launch_testing-3.7.1.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: launch_testing\nVersion: 3.7.1\n')
    (info / 'entry_points.txt').write_text('[pytest11]\nlaunch_testing = old_plugin\n')
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    words = [sys.executable, '-m', 'pytest', '--collect-only', __file__]
    for options, code in (((), 0), (('-o', 'addopts='), 3)):  # without ours, it does stop them
        done = subprocess.run(
            [*words, *options],
            cwd=ROOT,
            env={**os.environ, 'PYTHONPATH': path},
            capture_output=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == code, done.stderr.decode()
