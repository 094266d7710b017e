"""Compiled code is kept per state of the sources: no stale machine code may run."""

import pytest

from lpv.core.support import jit
from lpv.core.support.jit import module_digest, source_digest

SOURCES = {
    '__init__.py': '',
    'sub/__init__.py': '',
    'a.py': 'from lpv_here.sub import (\n    b,\n)\n',
    'sub/b.py': 'x = 1\n',
    'c.py': 'y = 1\n',
}


@pytest.fixture
def digests(tmp_path):
    """Digests of a package, and of its modules a and c, that has some other files."""

    def make(name, **changes):
        package = tmp_path / name / 'lpv_here'
        for file, content in {**SOURCES, **changes.get('files', {})}.items():
            (package / file).parent.mkdir(parents=True, exist_ok=True)
            (package / file).write_text(content)
        if 'moved' in changes:
            (package / 'sub').rename(package / changes['moved'])
        jit._source.cache_clear()  # sources of a test are at places of their own
        own = [module_digest(package / f'{m}.py', f'lpv_here.{m}') for m in 'ac']
        jit._source.cache_clear()
        return source_digest(package), *own

    return make


@pytest.mark.parametrize(
    ('changes', 'same'),
    [
        ({}, (True, True, True)),  # the same sources elsewhere
        ({'files': {'sub/b.py': 'x = 2\n'}}, (False, False, True)),  # what a imports
        ({'files': {'c.py': 'y = 2\n'}}, (False, True, False)),  # what a does not import
    ],
)
def test_given_sources_when_changed_then_digests_of_what_depends_on_them_change(
    digests, changes, same
):
    before, after = digests('before'), digests('after', **changes)
    assert tuple(one == other for one, other in zip(before, after)) == same


def test_given_a_module_that_is_moved_when_hashed_then_the_digest_is_another(digests):
    assert digests('before')[0] != digests('after', moved='other')[0]
