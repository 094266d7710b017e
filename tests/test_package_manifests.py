"""Manifests: what a package imports is named, what it ships is installed, versions agree."""

import os
import re
import runpy
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest
from import_graph import imports
from places import PACKAGES, ROOT

FOLDERS = [*sorted(PACKAGES.iterdir()), ROOT / 'tools' / 'lpv_ros2cli']
ON_CALL = {'lpv': {'lpv_design'}}
"""What a package imports when it is asked for: a dependency the other way is in the manifest."""
# Keys of rosdep that are not python3- and the name (rosdistro, rosdep/python.yaml), and libraries
# that none stands for: the manifest's comment names what pip installs.
_KEYS = 'aiohttp argcomplete hypothesis jinja2 matplotlib numba numpy packaging pytest rich scipy'
_KEYS += ' pytest-timeout sqlalchemy yaml cvxpy-pip filterpy-pip mujoco-pip rosbags-pip'
ROSDEP_KEYS = {f'python3-{name}' for name in _KEYS.split()}
_PYPI = 'clarabel cmaes distributed lz4 mcap optuna pyarrow zstandard'
PYPI = {name: name for name in _PYPI.split()} | {'foxglove': 'foxglove-sdk', 'pinocchio': 'pin'}
COMES_WITH = {'llvmlite': 'numba'}
"""Libraries that another one pins and installs: it is declared."""


def imported(folder):
    """Names of the top-level packages that the sources in a folder import, wherever."""
    found = {name for file in folder.rglob('*.py') for name in imports(file)}
    names = {name.split('.')[0] for name in found}
    return {COMES_WITH.get(name, name) for name in names} - set(sys.stdlib_module_names)


def missing_dependencies(package, declared, remarks):
    """What a package and its tests import and its manifest does not name."""
    wanted = imported(package / package.name) - ON_CALL.get(package.name, set())
    tests = package / 'test'  # a link leads to the tests of several packages together
    if not tests.is_symlink():
        wanted |= imported(tests) & {'hypothesis'}
    for file in package.glob('launch/*'):
        wanted |= {*re.findall(r'(?:<node pkg="|find-pkg-share )(\w+)', file.read_text())}
    wanted.discard(package.name)
    for name in wanted:
        keys = {name, f'python3-{name}', f'python3-{name}-pip'}
        if not (re.search(rf'\b{PYPI[name]}\b', remarks) if name in PYPI else keys & declared):
            yield name


def options_of(package, monkeypatch):
    options = {}
    monkeypatch.chdir(package)
    monkeypatch.setattr('setuptools.setup', options.update)
    runpy.run_path(str(package / 'setup.py'))
    return options


def left_out(package, options):
    """Files of a package, in its working directory, that an installation does not have."""
    installed = {Path(file) for _, files in options['data_files'] for file in files}
    for name, patterns in options.get('package_data', {}).items():
        installed |= {path for one in patterns for path in Path(*name.split('.')).glob(one)}
    shared = {path.parts[0] for path in installed} - {package.name, 'resource'}
    files = {path for name in shared for path in Path(name).rglob('*')}
    files |= {path for path in Path(package.name).rglob('*') if path.suffix != '.py'}
    files = {p for p in files if p.is_file() and not p.parent.name.startswith(('.', '__pycache__'))}
    folders = {'.'.join(p.parent.parts) for p in Path(package.name).rglob('__init__.py')}
    return files - installed | folders ^ set(options['packages'])


@pytest.mark.parametrize('package', FOLDERS, ids=lambda p: p.name)
def test_given_a_package_when_released_then_what_it_says_of_itself_is_right(package, monkeypatch):
    text = (package / 'package.xml').read_text()
    root, remarks = ElementTree.fromstring(text), re.findall(r'<!--(.*?)-->', text, re.DOTALL)
    declared = {e.text for e in root if e.tag.endswith('depend')}
    assert sorted(missing_dependencies(package, declared, ' '.join(remarks))) == []
    assert {d for d in declared if d.startswith('python3-')} <= ROSDEP_KEYS
    # rosdep would install them with the system's pip, which Ubuntu 24.04 refuses (PEP 668).
    skipped = re.search(r'--skip-keys "(.*?)"', (ROOT / 'docs' / 'install.md').read_text())[1]
    assert {d for d in declared if d.endswith('-pip')} <= {*skipped.split()}
    version = root.findtext('version')
    assert all(root.findtext(name).strip() for name in ('description', 'maintainer', 'license'))
    assert root.findtext('name') == package.name
    assert f'\nversion: {version}\n' in (ROOT / 'CITATION.cff').read_text()
    if (package / 'setup.py').is_file():
        options = options_of(package, monkeypatch)
        assert left_out(package, options) == set()
        assert (options['version'], options['license']) == (version, root.findtext('license'))
        assert sorted((package / 'test').glob('test_*.py'))


@pytest.mark.parametrize(('real', 'scripts'), [(1, []), (None, ['ros2 = lpv_ros2cli.main:main'])])
def test_given_a_real_ros2cli_when_built_by_hand_then_ours_is_left_out(monkeypatch, real, scripts):
    monkeypatch.setattr('importlib.util.find_spec', {'ros2cli': real}.__getitem__)
    options = options_of(ROOT / 'tools' / 'lpv_ros2cli', monkeypatch)
    assert options['entry_points']['console_scripts'] == scripts


def requirements(name):
    """Names and ranges that a file of requirements asks for."""
    lines = (ROOT / 'requirements' / f'{name}.txt').read_text().splitlines()
    return {line for line in lines if line and not line.startswith(('#', '-'))}


def test_given_libraries_and_manifests_when_compared_then_ranges_and_needs_are_named():
    data = (ROOT / 'pyproject.toml').read_text()
    base = re.search(r'^dependencies = \[(.*?)\]$', data, re.MULTILINE | re.DOTALL)[1]
    extras = re.search(r'^\[project.optional-dependencies\]\n(.*?)\n\n', data, re.M | re.DOTALL)[1]
    base, extras = (set(re.findall(r'"([a-z][^"\[]*)"', text)) for text in (base, extras))
    # In an environment of its own CVXPY comes without its other solvers.  ROS alone needs the rest.
    assert {r for r in base if not r.startswith('cvxpy')} <= requirements('base')
    assert extras <= requirements('extras')
    libraries = {re.match(r'[\w-]+', r).group() for r in requirements('base') | extras}
    assert set(PYPI.values()) - libraries == {'foxglove-sdk'}
    assert any(r.startswith('foxglove-sdk') for r in requirements('extras'))
    roots = (ElementTree.parse(package / 'package.xml').getroot() for package in FOLDERS)
    declared = {root.findtext('name'): {e.text for e in root} for root in roots}
    graph = {name: (declared.keys() & needed) - {name} for name, needed in declared.items()}
    assert len(tuple(TopologicalSorter(graph).static_order())) == 9
    to_read_launch_files = {'launch_xml', 'launch_ros', 'ros2launch'}
    assert {'lpv_design', *to_read_launch_files} <= declared['lpv_bringup']


@pytest.mark.slow
@pytest.mark.parametrize(('options', 'code'), [((), 0), (('-o', 'addopts='), 3)])
def test_given_plugins_of_a_ros2_then_options_save_us(tmp_path, monkeypatch, options, code):
    (tmp_path / 'old_plugin.py').write_text('def pytest_pycollect_makemodule(path, parent): pass\n')
    info = tmp_path / 'launch_testing-3.7.1.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: launch_testing\nVersion: 3.7.1\n')
    (info / 'entry_points.txt').write_text('[pytest11]\nlaunch_testing = old_plugin\n')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    words = [sys.executable, '-m', 'pytest', '--collect-only', __file__, *options]
    done = subprocess.run(words, cwd=ROOT, capture_output=True)
    assert done.returncode == code, done.stderr.decode()
