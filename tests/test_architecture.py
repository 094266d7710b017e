"""The sources: layers without imports upwards, one kind of arm, numbers that say why they are; and
manifests: what a package imports is named, what it ships is installed, versions agree."""

import ast
import os
import re
import runpy
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import import_graph
import pytest
from fault_matrix import COMPILED
from places import PACKAGES, ROOT

from lpv.core.serial_arm.diagnosis import priors

LAYERS = {
    '': [{'lpv', 'lpv_bringup'}, {'lpv_design', 'lpv_node'},
         {'lpv_arm_sim', 'lpv_ros2cli', 'lpv_tracker', 'lpv_uio'}],
    # Its own modules, the Python API, are above them.
    'lpv.': [{'core'}, {'bag'}, {'report'}, {'campaign', 'identify'}, {'cli'}],
    'lpv.core.': [{'support'}, {'serial_arm'}, {'export'}, {'uio'}, {'control'}, {'monitoring'},
                  {'simulation'}],
}  # fmt: skip
"""What is in a package, from the bottom up; nothing imports from higher layers."""
ON_CALL = {'': {('lpv', 'lpv_design')}}
"""Imports upwards that wait until a design is asked for."""


@pytest.mark.parametrize('package', ['', 'lpv.bag.', 'lpv.campaign.', 'lpv.report.'])
def test_given_modules_or_sub_packages_when_they_import_then_there_is_no_cycle(package):
    graph = import_graph.collapse(3 if package else 99)
    names = {name for name in graph if name.startswith(package)}
    inside = {name: graph[name] & names for name in names}
    TopologicalSorter(inside).prepare()
    assert any(inside.values())


@pytest.mark.parametrize(('package', 'layers'), LAYERS.items())
def test_given_layers_when_what_is_in_them_imports_then_only_downwards(package, layers):
    graph = import_graph.collapse(package.count('.') + 1)
    level = {f'{package}{name}': height for height, names in enumerate(layers) for name in names}
    inside = {name for name in graph if name.startswith(package)}
    files = import_graph.module_files()
    assert level.keys() == {name for name in inside if files[name].name == '__init__.py'}
    top = len(layers)
    upward = {
        (name, other)
        for name in inside
        for other in graph[name]
        if other.startswith(package[:4]) and level.get(other, top) > level.get(name, top)
    }
    assert upward == ON_CALL.get(package, set())


def test_given_the_library_when_imported_then_no_other_package_is_and_its_mathematics_is_alone():
    for name, file in import_graph.module_files().items():
        text = file.read_text(encoding='utf-8')
        # A command is imported when it is called.
        if name.split('.')[0] == 'lpv' and not name.startswith('lpv.cli.commands'):
            assert not re.search(r'^(from|import) lpv_', text, re.MULTILINE), name
        if name.startswith(('lpv.core', 'lpv.identify', 'lpv_design')):
            assert 'rclpy' not in text, name
        if name.startswith('lpv.core.'):
            others = import_graph.module_imports()[name]
            assert all(other.startswith('lpv.core') for other in others), name


def test_given_the_benchmarks_when_run_alone_then_they_need_nothing_of_the_tests():
    scripts = {path.stem: path for path in (ROOT / 'benchmarks').glob('*.py')}
    tests = {path.stem for path in (ROOT / 'tests' / 'support').glob('*.py')}
    wrong = {name: tests & {*import_graph.imports(path)} for name, path in scripts.items()}
    assert {name: found for name, found in wrong.items() if found} == {}
    page = (ROOT / 'benchmarks' / 'README.md').read_text(encoding='utf-8')
    assert {*re.findall(r'python benchmarks/(\w+)\.py', page)} <= scripts.keys()


READS_OLD_FILES = ('serial_arm/old_arm_file.py', 'serial_arm/arm_file.py')
"""There is one kind of arm; only these see files of older versions."""
QUESTIONS = {
    'type': r'isinstance\([^()]*(\([^()]*\))?[^()]*\b(SerialArm|ArmParameters|Scenario)\b',
    'links': r"hasattr\(\s*\w*arm\w*\s*,\s*'links'",
    'kind of an arm file': r"(arm|data|content|top)\w*(\[|\.get\(|\.text\()\s*'kind'",
}


@pytest.mark.parametrize('question', QUESTIONS)
def test_given_the_product_when_searched_then_it_never_asks_for_the_kind_of_an_arm(question):
    files = import_graph.module_files().values()
    others = [path for path in files if not path.as_posix().endswith(READS_OLD_FILES)]
    found = {path: re.search(QUESTIONS[question], path.read_text()) for path in others}
    assert len(found) > 100 and {path: match for path, match in found.items() if match} == {}


def test_given_priors_that_compiled_functions_read_then_none_of_them_can_be_scaled():
    kept = set()
    for file in import_graph.module_files().values():
        for one in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            decorators = map(ast.unparse, getattr(one, 'decorator_list', []))
            if any(name.startswith('njit') for name in decorators):
                kept |= {*re.findall(r'priors\.([A-Z_]+)', ast.unparse(one))}
    assert kept - {'STEADY_FOR'} == COMPILED


LITERAL = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple, ast.operator, ast.unaryop, ast.Load)


def is_number(value):
    """Whether an expression is made of numbers; one that names others says itself what it is."""
    parts = list(ast.walk(value))
    kinds = {type(one.value) for one in parts if isinstance(one, ast.Constant)}
    return all(isinstance(one, LITERAL) for one in parts) and bool(kinds & {int, float})


def silent_constants(path):
    """Numeric constants of a module that neither a string below nor a comment explains."""
    lines, (body, _) = path.read_text(encoding='utf-8').splitlines(), import_graph.parsed(path)
    for one, following in zip(body, [*body[1:], None]):
        if not isinstance(one, (ast.Assign, ast.AnnAssign)) or not is_number(one.value):
            continue
        target = one.targets[0] if isinstance(one, ast.Assign) else one.target
        if isinstance(target, ast.Subscript) or not ast.unparse(target).strip('(').isupper():
            continue  # an entry, or a state
        beside = '#' in lines[one.end_lineno - 1] or lines[one.lineno - 2].startswith('#')
        below = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        if not (beside or below):
            yield f'{path.name}:{one.lineno}: {lines[one.lineno - 1]}'


def test_given_a_module_when_a_number_has_no_word_then_it_is_found_and_ours_have_none(tmp_path):
    files = import_graph.module_files().values()
    assert [one for path in files for one in silent_constants(path)] == []
    path, text = tmp_path / 'module.py', 'A = 1.0\n"""Why."""\nB = 2  # why\n_C, D = 3, 4\n'
    path.write_text(f'{text}E = 1 << 3\nF = 2 * A\ng = 0\n')
    assert [one.split()[1] for one in silent_constants(path)] == ['_C,', 'E']


def test_given_the_priors_when_documented_then_all_of_them_with_their_values():
    page = (ROOT / 'docs' / 'diagnosis.md').read_text(encoding='utf-8')
    table = page.partition('## Priors')[2].partition('\n## ')[0]
    cells = re.findall(r'^\|.*`(.+)`.* \| ([^|]+) \|$', table, re.MULTILINE)
    rows = {name: ast.literal_eval(value) for name, value in cells}
    names = {name for name in vars(priors) if name.isupper()} - {'CONTACT', 'LOAD', 'STAMPS'}
    assert {name.partition('[')[0] for name in rows} == names
    assert {f"SIZE['{kind}']" for kind in priors.SIZE} <= set(rows)
    assert {name: eval(name, vars(priors).copy()) for name in rows} == rows


FOLDERS = [*sorted(PACKAGES.iterdir()), ROOT / 'tools' / 'lpv_ros2cli']
IMPORTED_ON_CALL = {'lpv': {'lpv_design'}}
"""What a package imports when it is asked for: a dependency the other way is in the manifest."""
# Keys of rosdep that are not python3- and the name (rosdistro, rosdep/python.yaml), and libraries
# that none stands for: the manifest's comment names what pip installs.
_KEYS = 'aiohttp argcomplete hypothesis jinja2 matplotlib numba numpy packaging pytest rich scipy'
_KEYS += ' pytest-timeout sqlalchemy yaml cvxpy-pip mujoco-pip rosbags-pip'
ROSDEP_KEYS = {f'python3-{name}' for name in _KEYS.split()}
_PYPI = 'clarabel cmaes distributed lz4 mcap optuna pyarrow zstandard'
PYPI = {name: name for name in _PYPI.split()} | {'foxglove': 'foxglove-sdk', 'pinocchio': 'pin'}
COMES_WITH = {'llvmlite': 'numba'}
"""Libraries that another one pins and installs: it is declared."""


def imported(folder):
    """Names of the top-level packages that the sources in a folder import, wherever."""
    found = {name for file in folder.rglob('*.py') for name in import_graph.imports(file)}
    names = {name.split('.')[0] for name in found}
    return {COMES_WITH.get(name, name) for name in names} - set(sys.stdlib_module_names)


def missing_dependencies(package, declared, remarks):
    """What a package and its tests import and its manifest does not name."""
    wanted = imported(package / package.name) - IMPORTED_ON_CALL.get(package.name, set())
    tests = package / 'test'  # a link leads to the tests of several packages together
    texts = [] if tests.is_symlink() else [p.read_text() for p in tests.rglob('*.py')]
    wanted |= {'hypothesis'} if any('\nfrom hypothesis import' in text for text in texts) else set()
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


def test_given_a_workspace_when_searched_as_rosdep_does_then_each_package_is_there_once():
    """It follows links, goes no deeper than a manifest, and ends where a name comes twice."""
    found = []
    for folder, folders, files in os.walk(ROOT, followlinks=True):
        if 'AMENT_IGNORE' in files or 'package.xml' in files:
            folders.clear()
            found += [Path(folder).name] if 'package.xml' in files else []
        folders[:] = [one for one in folders if not one.startswith('.')]
    assert sorted(found) == sorted(one.name for one in FOLDERS)


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
    words = [sys.executable, '-m', 'pytest', '--collect-only', 'tests/test_install.py', *options]
    done = subprocess.run(words, cwd=ROOT, capture_output=True)
    assert done.returncode == code, done.stderr.decode()
