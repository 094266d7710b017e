"""The sources: layers without imports upwards, one kind of arm, numbers that say why they are."""

import ast
import re
from graphlib import TopologicalSorter

import import_graph
import pytest
from places import ROOT

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
    names = {name for name in vars(priors) if name.isupper()} - {'CONTACT', 'LOAD'}
    assert {name.partition('[')[0] for name in rows} == names
    assert {f"SIZE['{kind}']" for kind in priors.SIZE} <= set(rows)
    assert {name: eval(name, vars(priors).copy()) for name in rows} == rows
