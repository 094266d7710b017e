"""The documentation fits the code: references and links resolve, equations are listed."""

import functools
import importlib
import inspect
import re
import shlex
import subprocess
import sys

import import_graph
import pytest
from places import ROOT

from lpv.cli.main import build_parser

PAGES = sorted((ROOT / 'docs').glob('*.md')) + [
    ROOT / name for name in ('README.md', 'CONTRIBUTING.md')
]
WITHOUT_CODE = {69}
"""Equations that nothing implements: the paper's remark on a choice of alpha."""

_REFERENCE = re.compile(r'`([A-Za-z]\w*(?:\.[A-Za-z_]\w*)+)(?:\(\))?`')
_FILES = ('yaml', 'yml', 'md', 'py', 'png', 'html', 'csv', 'mcap', 'json', 'xml', 'txt', 'db3',
          'parquet')  # fmt: skip
_LINK = re.compile(r'\[[^\]]*\]\(\s*([^)\s]+)\s*\)')
_CLASS = re.compile(r'^class (\w+)', re.MULTILINE)


@functools.cache
def _classes():
    """Module of every class of this software."""
    return {
        name: import_graph.module_name(file, folder)
        for folder in import_graph.package_folders().values()
        for file in folder.rglob('*.py')
        for name in _CLASS.findall(file.read_text(encoding='utf-8'))
    }


def _has(owner, name):
    """Whether a module or class has a name, one that its instances get included."""
    if hasattr(owner, name) or name in getattr(owner, '__annotations__', {}):
        return True
    return inspect.isclass(owner) and f'self.{name}' in inspect.getsource(owner)


def _resolves(reference):
    parts = reference.split('.')
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module('.'.join(parts[:cut]))
        except ImportError:
            continue
        for name in parts[cut:]:
            if not _has(found, name):
                return False
            found = getattr(found, name, None)
        return True
    return False


def references(page):
    """What a page names as code of this software: by its package, or by its class."""
    for reference in _REFERENCE.findall(page.read_text(encoding='utf-8')):
        first = reference.split('.')[0]
        if reference.rpartition('.')[2] in _FILES:
            continue
        if first in import_graph.package_folders():
            yield reference
        elif first[0].isupper() and first in _classes():
            yield f'{_classes()[first]}.{reference}'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_given_a_page_when_it_names_code_then_that_code_exists(page):
    assert [name for name in references(page) if not _resolves(name)] == []


def test_given_the_docstrings_when_their_equations_are_listed_then_the_index_is_that_list():
    tool = ROOT / 'tools' / 'equation_index.py'
    subprocess.run([sys.executable, str(tool), '--check'], check=True)


def test_given_the_index_when_read_then_every_equation_of_the_paper_is_in_it():
    listed = re.findall(
        r'^\| \((\d+)\) \|', (ROOT / 'docs' / 'equations.md').read_text(), re.MULTILINE
    )
    assert set(range(1, 71)) - {int(number) for number in listed} == WITHOUT_CODE


def test_given_the_pages_when_the_site_is_built_then_each_is_in_its_contents():
    contents = (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').split()
    missing = [p.stem for p in PAGES if p.parent == ROOT / 'docs' and p.stem not in contents]
    assert missing == ['index']


def test_given_everything_that_stops_or_alarms_when_looked_up_then_the_page_of_alarms_has_it():
    from lpv.core.control.watchdog import BRAKE_TEXT, STOP_TEXT
    from lpv.core.serial_arm.diagnosis.alarms import KINDS, SensorState

    page = (ROOT / 'docs' / 'alarms.md').read_text(encoding='utf-8')
    stops = [text.split(':')[0] for text in (*STOP_TEXT.values(), *BRAKE_TEXT.values())]
    rows = [f'`{kind}`' for kind in KINDS] + [state.name for state in SensorState] + stops
    assert [row for row in rows if row and f'| {row}' not in page] == []


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_given_a_page_when_its_relative_links_are_followed_then_files_and_headings_exist(page):
    blocks = re.compile(r'^```.*?^```$', re.MULTILINE | re.DOTALL)
    text = blocks.sub('', page.read_text(encoding='utf-8'))
    for link in _LINK.findall(text):
        if re.match(r'[a-z]+:', link):
            continue
        name, _, heading = link.partition('#')
        target = page.parent / name if name else page
        assert target.is_file(), link
        if heading:
            assert heading in headings(target), link


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_given_a_page_when_its_lpv_commands_are_parsed_then_each_has_these_options(page):
    text = page.read_text(encoding='utf-8').replace('\\\n', '')
    for line in re.findall(r'^(?:\$ |my_env/bin/)?lpv (.+)$', text, re.MULTILINE):
        argv = shlex.split(line, comments=True)
        build_parser(argv[0]).parse_args(argv)


def headings(path):
    """Anchors of a page's headings."""
    titles = re.findall(r'^#+ (.+)$', path.read_text(encoding='utf-8'), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-') for title in titles}
