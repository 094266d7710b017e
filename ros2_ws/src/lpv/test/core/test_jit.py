"""Compiled code is kept per state of the sources: no stale machine code may run."""

import pytest

from lpv.core.support import jit
from lpv.core.support.jit import module_digest, source_digest

SOURCES = {'a.py': 'from lpv_here.sub import (\n    b,\n)\n', 'sub/b.py': 'x = 1\n'}
SOURCES |= {'c.py': 'y = 1\n', '__init__.py': '', 'sub/__init__.py': ''}


def digests(package, files, moved='sub'):
    """Digests of a package, and of its modules a and c, that has some other files."""
    for file, content in {**SOURCES, **files}.items():
        (package / file).parent.mkdir(parents=True, exist_ok=True)
        (package / file).write_text(content)
    (package / 'sub').rename(package / moved)
    jit._source.cache_clear()  # sources of a test are at places of their own
    own = [module_digest(package / f'{m}.py', f'lpv_here.{m}') for m in 'ac']
    jit._source.cache_clear()
    return source_digest(package), *own


@pytest.mark.parametrize(('files', 'moved', 'same'), [
    ({}, 'sub', (True, True, True)),  # the same sources elsewhere
    ({'sub/b.py': 'x = 2\n'}, 'sub', (False, False, True)),  # what a imports
    ({'c.py': 'y = 2\n'}, 'sub', (False, True, False)),  # what a does not import
    ({}, 'other', (False, False, True)),
])  # fmt: skip
def test_given_sources_when_changed_or_moved_then_digests_follow(tmp_path, files, moved, same):
    before = digests(tmp_path / 'before' / 'lpv_here', {})
    after = digests(tmp_path / 'after' / 'lpv_here', files, moved)
    assert tuple(one == other for one, other in zip(before, after)) == same
