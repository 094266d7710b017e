"""Index from the paper's equations to functions that implement them, in ``docs/paper-notes.md``.

Equation numbers are read from docstrings ("eq. (38)", "eqs. (13)-(20)", "LMI (67)"); a function,
class or module that states one is listed.  ``--check`` fails where the page is not what the
docstrings say.
"""

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / 'docs' / 'paper-notes.md'
FOLDERS = ('ros2_ws/src/lpv/lpv', 'design/lpv_design/lpv_design')
LAST = 70
"""Number of the paper's last equation."""

_NUMBERS = re.compile(r'\((\d{1,2})\)(?:\s*-\s*\((\d{1,2})\))?')
_STATED = re.compile(
    r'(?:\b[Ee]qs?\.|\bLMIs?)\s*((?:\(\d{1,2}\)(?:\s*-\s*\(\d{1,2}\))?(?:,\s*|\s+and\s+)?)+)'
)
_HEAD = ' Code by equation:\n\n'
"""Beginning of the index, which ends the page."""


def stated_equations(text: str) -> set[int]:
    """Numbers of the paper's equations that a docstring states."""
    numbers: set[int] = set()
    for group in _STATED.findall(text):
        for first, last in _NUMBERS.findall(group):
            numbers.update(range(int(first), int(last or first) + 1))
    return {number for number in numbers if 1 <= number <= LAST}


def _documented(tree: ast.Module, module: str) -> Iterator[tuple[str, str]]:
    """Dotted name and docstring of a module's public functions, classes and methods."""

    def walk(node: ast.AST, prefix: str) -> Iterator[tuple[str, str]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)) and child.name != '__init__':
                name = f'{prefix}.{child.name}'
                yield name, ast.get_docstring(child) or ''
                yield from walk(child, name)

    yield module, ast.get_docstring(tree) or ''
    yield from walk(tree, module)


def _link(name: str, file: Path) -> str:
    return f'[`{name}`](../{file.relative_to(ROOT)})'


def find_equations() -> dict[int, list[str]]:
    """Links to code by equation; a module only where none of its functions states the number."""
    index: dict[int, list[str]] = {}
    for folder in FOLDERS:
        for file in sorted((ROOT / folder).rglob('*.py')):
            module = '.'.join(file.relative_to((ROOT / folder).parent).with_suffix('').parts)
            entries = list(_documented(ast.parse(file.read_text(encoding='utf-8')), module))
            inner = set().union(*(stated_equations(text) for _, text in entries[1:]), set())
            for position, (name, text) in enumerate(entries):
                for number in stated_equations(text) - (inner if position == 0 else set()):
                    index.setdefault(number, []).append(_link(name, file))
    return index


def _ranges(numbers: list[int]) -> str:
    """Numbers of equations as text, three and more in a row by the first and the last."""
    rows = [
        [number for _, number in row]
        for _, row in groupby(enumerate(numbers), lambda one: one[1] - one[0])
    ]
    texts = [[f'({one})' for one in row] for row in rows]
    return ', '.join(f'{row[0]}-{row[-1]}' if len(row) > 2 else ', '.join(row) for row in texts)


def page() -> str:
    """The page's text, with a new index; neighbours that name the same code share a line."""
    index = find_equations()
    rows = [
        f'- {_ranges([*numbers])}: {", ".join(links)}'
        for links, numbers in groupby(sorted(index), key=index.__getitem__)
    ]
    return PAGE.read_text(encoding='utf-8').partition(_HEAD)[0] + _HEAD + '\n'.join(rows) + '\n'


def main() -> int:
    """Write the page, or compare it."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--check', action='store_true', help='fail if the page is not up to date')
    text = page()
    if parser.parse_args().check:
        if PAGE.read_text(encoding='utf-8') != text:
            print('docs/paper-notes.md is out of date: run python tools/equation_index.py')
            return 1
        return 0
    PAGE.write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
