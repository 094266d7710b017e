"""Compiled code is kept per state of the sources: no stale machine code may run."""

import pytest

from lpv_core.support import jit
from lpv_core.support.jit import module_digest, source_digest


def _package(folder, text, other='y = 1\n'):
    """A package whose module ``a`` imports ``sub.b``, and ``c`` nothing."""
    (folder / 'sub').mkdir(parents=True)
    for file, content in {
        '__init__.py': '',
        'sub/__init__.py': '',
        'a.py': 'from lpv_here.sub import (\n    b,\n)\n',
        'sub/b.py': text,
        'c.py': other,
    }.items():
        (folder / file).write_text(content)
    return folder


@pytest.fixture(autouse=True)
def forgotten_sources():
    """Sources of a test are at places of their own; those of another test are not remembered."""
    jit._source.cache_clear()
    yield
    jit._source.cache_clear()


def _digest(package, module):
    jit._source.cache_clear()
    return module_digest(package / f'{module}.py', f'lpv_here.{module}')


def test_change_in_a_sub_package_gives_another_digest(tmp_path):
    before = _package(tmp_path / 'a', 'x = 1\n')
    after = _package(tmp_path / 'b', 'x = 2\n')
    assert source_digest(before) != source_digest(after)


def test_moved_module_gives_another_digest(tmp_path):
    before = _package(tmp_path / 'a', 'x = 1\n')
    after = _package(tmp_path / 'b', 'x = 1\n')
    (after / 'sub').rename(after / 'other')
    assert source_digest(before) != source_digest(after)


def test_same_sources_elsewhere_give_the_same_digest(tmp_path):
    first = _package(tmp_path / 'a' / 'lpv_here', 'x = 1\n')
    second = _package(tmp_path / 'b' / 'lpv_here', 'x = 1\n')
    assert source_digest(first) == source_digest(second)
    assert _digest(first, 'a') == _digest(second, 'a')


def test_given_a_change_of_what_a_module_imports_when_hashed_then_the_digest_is_another(tmp_path):
    before = _package(tmp_path / 'a' / 'lpv_here', 'x = 1\n')
    after = _package(tmp_path / 'b' / 'lpv_here', 'x = 2\n')
    assert _digest(before, 'a') != _digest(after, 'a')


def test_given_a_change_elsewhere_when_hashed_then_the_digest_of_a_module_stays(tmp_path):
    before = _package(tmp_path / 'a' / 'lpv_here', 'x = 1\n', other='y = 1\n')
    after = _package(tmp_path / 'b' / 'lpv_here', 'x = 1\n', other='y = 2\n')
    assert _digest(before, 'a') == _digest(after, 'a')
    assert _digest(before, 'c') != _digest(after, 'c')
