import inspect
import pkgutil
import re
import shlex
import subprocess
import sys

import import_graph
import numpy as np
import pytest
from places import ROOT

from lpv import AlarmEvent
from lpv.cli.main import build_parser, main
from lpv.core.control.watchdog import BrakeReason, StopReason
from lpv.core.monitoring.alarm_text import UNUSABLE
from lpv.core.serial_arm.diagnosis.alarms import KINDS, SensorState

DOCS = ROOT / 'docs'
PAGES = {
    path.name: path.read_text(encoding='utf-8')
    for path in (*sorted(DOCS.glob('*.md')), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md')
}
WITHOUT_CODE = {69}
"""Equations that nothing implements: the paper's remark on a choice of alpha."""
_REFERENCE = re.compile(r'`([A-Za-z]\w*(?:\.[A-Za-z_]\w*)+)(?:\(\))?`')
_FILES = ('yaml', 'yml', 'md', 'py', 'png', 'html', 'csv', 'mcap', 'json', 'xml', 'txt', 'db3',
          'parquet')  # fmt: skip
_LINK = re.compile(r'\[[^\]]*\]\(\s*([^)\s]+)\s*\)')
CLASSES = {
    name: module
    for module, file in import_graph.module_files().items()
    for name in re.findall(r'^class (\w+)', file.read_text(encoding='utf-8'), re.MULTILINE)
}
"""Module of every class of this software."""


def _resolves(reference):
    """Whether a module or class has a name, one that its instances get included."""
    owner, _, name = reference.rpartition('.')
    try:
        pkgutil.resolve_name(reference)
    except (ImportError, AttributeError):
        found = pkgutil.resolve_name(owner)
        return inspect.isclass(found) and (
            name in found.__annotations__ or f'self.{name}' in inspect.getsource(found)
        )
    return True


def references(text):
    """What a page names as code of this software: by its package, or by its class."""
    for reference in _REFERENCE.findall(text):
        first, last = reference.split('.')[0], reference.rpartition('.')[2]
        if first in import_graph.package_folders() and last not in _FILES:
            yield reference
        elif first in CLASSES and last not in _FILES:
            yield f'{CLASSES[first]}.{reference}'


def headings(text):
    """Anchors of a page's headings."""
    titles = re.findall(r'^#+ (.+)$', text, re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-') for title in titles}


@pytest.mark.parametrize('page', PAGES)
def test_given_a_page_then_the_code_links_and_commands_in_it_are_there(page):
    assert [name for name in references(PAGES[page]) if not _resolves(name)] == []
    folder = DOCS if (DOCS / page).is_file() else ROOT
    links = _LINK.findall(re.sub(r'(?ms)^```.*?^```$', '', PAGES[page]))
    for link in (one for one in links if not re.match(r'[a-z]+:', one)):
        name, _, heading = link.partition('#')
        target = folder / (name or page)
        assert target.is_file(), link
        assert not heading or heading in headings(target.read_text(encoding='utf-8')), link
    text = PAGES[page].replace('\\\n', '')
    for line in re.findall(r'^(?:\$ |my_env/bin/)?lpv (.+)$', text, re.MULTILINE):
        argv = shlex.split(line, comments=True)
        build_parser(argv[0]).parse_args(argv)


def test_given_equations_pages_and_alarms_when_looked_up_then_the_site_has_each():
    tool = ROOT / 'tools' / 'equation_index.py'
    subprocess.run([sys.executable, str(tool), '--check'], check=True)
    rows = re.findall(r'^- (\(\d+\).*?):', PAGES['paper-notes.md'], re.MULTILINE)
    ranges = re.findall(r'\((\d+)\)(?:-\((\d+)\))?', ' '.join(rows))
    listed = [number for a, b in ranges for number in range(int(a), int(b or a) + 1)]
    assert len(listed) == len(set(listed)) and set(range(1, 71)) - set(listed) == WITHOUT_CODE
    contents = PAGES['index.md'].split()
    assert [p.stem for p in DOCS.glob('*.md') if p.stem not in contents] == ['index']
    stops = [reason.text.split(':')[0] for reason in (*StopReason, *BrakeReason)]
    rows = [f'`{kind}`' for kind in KINDS] + [state.name for state in SensorState] + stops
    rows.append(UNUSABLE)
    assert [row for row in rows if row and f'| {row}' not in PAGES['alarms.md']] == []


BLOCKS = re.findall(r'(?ms)^```(\w+)\n(.*?)^```$', PAGES['tracking.md'])
"""Kind and text of every fenced block of the tutorial, in order."""


@pytest.mark.slow
def test_given_the_tutorial_when_run_then_figures_and_alarm_are_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for kind, text in BLOCKS:
        if kind == 'yaml':
            (tmp_path / text.splitlines()[0].removeprefix('# ')).write_text(text, encoding='utf-8')
        elif kind == 'python':
            exec(compile(text, 'tracking.md', 'exec'), namespace)
        elif kind == 'sh':
            lines = [line for line in text.splitlines() if line.startswith('lpv ')]
            assert [main(shlex.split(line)[1:]) for line in lines] == [0] * len(lines)
    texts = '\n'.join(text for kind, text in BLOCKS if kind == 'text')
    shown = re.findall(r'^holds \(.*?\): (.*)$', texts, re.MULTILINE)
    header = (tmp_path / 'gains.yaml').read_text(encoding='utf-8')
    printed = re.findall(r'^# holds \(.*?\): (.*)$', header, re.MULTILINE)
    assert len(shown) == 4 and shown == printed[:4]
    share = namespace['friction'] / namespace['gravity']
    np.testing.assert_allclose(namespace['gravity'], [18.9, 4.2], atol=0.05)
    np.testing.assert_allclose(share, [0.021, 0.024], atol=5e-4)
    np.testing.assert_allclose(namespace['upright'], [0.040, 0.098], atol=2e-3)
    np.testing.assert_allclose(namespace['leaning'], [0.149, 0.482], atol=5e-3)
    assert namespace['quiet']
    (alarm,) = namespace['run'].alarms
    assert (alarm.event, alarm.sensor, alarm.kind) == (AlarmEvent.RAISED, 'elbow_encoder', 'bias')
    assert alarm.detected == 4_002_000_000 and alarm.size == pytest.approx(0.25, abs=0.005)
    assert alarm.bound == pytest.approx(0.003, abs=0.001)
    # Compensated, the arm is off by the estimate's error.
    assert namespace['largest']['confirmed'] == pytest.approx(0.001, abs=0.001)
    assert namespace['largest']['off'] == pytest.approx(0.25, abs=0.01)
