"""Numbers at the top of a module say where they come from, in the source."""

import ast
import re

import import_graph
from places import ROOT

from lpv.core.serial_arm.diagnosis import priors

LITERAL = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple, ast.operator, ast.unaryop, ast.Load)


def is_number(value):
    """Whether an expression is made of numbers; one that names others says itself what it is."""
    parts = list(ast.walk(value))
    numbers = [one for one in parts if isinstance(one, ast.Constant)]
    return all(isinstance(one, LITERAL) for one in parts) and any(
        type(one.value) in {int, float} for one in numbers
    )


def silent_constants(path):
    """Numeric constants of a module that neither a string below nor a comment explains."""
    text = path.read_text(encoding='utf-8')
    lines, body = text.splitlines(), ast.parse(text).body
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


def test_given_the_sources_when_a_module_has_a_number_then_it_says_why():
    files = import_graph.module_files().values()
    assert [one for path in files for one in silent_constants(path)] == []


def test_given_a_number_without_a_word_when_looked_for_then_it_is_found(tmp_path):
    path = tmp_path / 'module.py'
    path.write_text(
        'A = 1.0\n"""Why."""\nB = 2  # why\n_C, D = 3, 4\nE = 1 << 3\nF = 2 * A\ng = 0\n'
    )
    assert [one.split()[1] for one in silent_constants(path)] == ['_C,', 'E']


def test_given_the_priors_when_documented_then_all_of_them_with_their_values():
    page = (ROOT / 'docs' / 'diagnosis.md').read_text(encoding='utf-8')
    table = page.partition('## Priors')[2].partition('\n## ')[0]
    cells = re.findall(r'^\|.*`(.+)`.* \| ([^|]+) \|$', table, re.MULTILINE)
    rows = {name: ast.literal_eval(value) for name, value in cells}
    names = {name for name in vars(priors) if name.isupper()} - {'CONTACT'}
    sizes = {f"SIZE['{kind}']" for kind in priors.SIZE}
    assert {name.partition('[')[0] for name in rows} == names
    assert sizes <= set(rows)
    assert {name: eval(name, vars(priors).copy()) for name in rows} == rows
