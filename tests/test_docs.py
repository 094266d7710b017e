"""The documentation says what the code says: references resolve, the index of equations is complete."""

import importlib
import re
import subprocess
import sys

import import_graph
import pytest
from places import ROOT

PAGES = sorted((ROOT / 'docs').glob('*.md')) + [
    ROOT / name for name in ('README.md', 'CONTRIBUTING.md')
]
WITHOUT_CODE = {69}
"""Equations that nothing implements: the paper's remark on a choice of alpha."""

_REFERENCE = re.compile(r'`((?:lpv\w*|[a-z]\w*)(?:\.[A-Za-z_]\w*)+)(?:\(\))?`')
_FILES = ('yaml', 'yml', 'md', 'py', 'png', 'html', 'csv', 'mcap', 'json', 'xml', 'txt', 'db3', 'urdf')


def _module_names():
    """Every module by its full name, and by its last word where that is unique."""
    modules, short = set(import_graph.module_imports()), {}
    for module in modules:
        short.setdefault(module.rpartition('.')[2], []).append(module)
    return modules | {key: found[0] for key, found in short.items() if len(found) == 1}.keys(), {
        key: found[0] for key, found in short.items() if len(found) == 1
    }


def _resolves(reference):
    parts = reference.split('.')
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module('.'.join(parts[:cut]))
        except ImportError:
            continue
        for name in parts[cut:]:
            if not hasattr(found, name) and name not in getattr(found, '__annotations__', {}):
                return False
            found = getattr(found, name, None)
        return True
    return False


def references(page):
    """What a page names as code of this software: its modules, and what is in them."""
    short = _module_names()[1]
    for reference in _REFERENCE.findall(page.read_text(encoding='utf-8')):
        first, last = reference.split('.')[0], reference.rpartition('.')[2]
        if last in _FILES:
            continue
        if first in import_graph.package_folders():
            yield reference
        elif first in short:
            yield short[first] + reference[len(first) :]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_given_a_page_when_it_names_code_then_that_code_exists(page):
    assert [name for name in references(page) if not _resolves(name)] == []


def test_given_the_docstrings_when_their_equations_are_listed_then_the_index_is_that_list():
    tool = ROOT / 'tools' / 'equation_index.py'
    subprocess.run([sys.executable, str(tool), '--check'], check=True)


def test_given_the_index_when_read_then_every_equation_of_the_paper_is_in_it():
    listed = re.findall(r'^\| \((\d+)\) \|', (ROOT / 'docs' / 'equations.md').read_text(), re.MULTILINE)
    assert set(range(1, 71)) - {int(number) for number in listed} == WITHOUT_CODE


def test_given_the_pages_when_the_site_is_built_then_each_is_in_its_contents():
    contents = (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').split()
    missing = [p.stem for p in PAGES if p.parent.name == 'docs' and p.stem not in contents]
    assert missing == ['index']


def test_given_the_readme_when_its_lines_are_counted_then_it_is_short():
    assert len((ROOT / 'README.md').read_text(encoding='utf-8').splitlines()) <= 120
