import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from lpv.core.simulation.arm_simulator import Chances
from lpv.core.support import jit, process_lock
from lpv.core.support.jit import module_digest, source_digest
from lpv.core.support.process_lock import ProcessLock

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


def printed(code, *folders, **environment):
    """What a new process prints that runs some code, with folders to import from."""
    python_path = os.pathsep.join([*map(str, folders), *filter(None, sys.path)])
    environment = {**os.environ, 'PYTHONPATH': python_path, **environment}
    command = [sys.executable, '-c', code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.parametrize('name', ['LPV_NO_JIT', 'NUMBA_DISABLE_JIT'])
def test_given_no_compiler_is_wanted_when_a_function_is_called_then_it_is_plain_python(name):
    code = 'from lpv.core.support.jit import njit; print(njit(float)("2"), njit(float) is float)'
    assert printed(code, **{name: '1'}) == '2.0 True\n'


linked = pytest.mark.skipif(not jit.COMPILED, reason='without Numba nothing is linked')


@linked
@pytest.mark.parametrize('options', [{}, {'_nrt': False}], ids=['counted', 'in place'])
def test_given_what_python_hands_over_when_called_then_nothing_holds_it_afterwards(options):
    import numba

    import lpv.core.support.references  # noqa: F401  # how named tuples are handed over

    together = Chances(*map(np.random.default_rng, range(3)))
    called, alone = (numba.njit(lambda one: 0.0, **options) for _ in range(2))
    held = []
    for _ in range(3):
        called(together)
        alone(together.noise)
        held.append(sys.getrefcount(together.noise))
    assert held == held[:1] * 3


LINKED = """
import sys
import numba
import numpy as np
from lpv.core.support.jit import compile_ahead, njit, njit_in_one_place, on_compile, pointer

@njit
def innermost(x, y):
    if x[0] < 0.0:
        raise ValueError('negative', x[0])
    return np.dot(x, y)

@njit
def inner(x, y):
    return 2.0 * innermost(x, y)

@njit
def entry(x, y):
    return 1.0 + inner(x, y)

@njit
def place(x, k):
    return x[k]

@njit
def places(x):
    return place(x, 0) + place(x, 1)

@njit
def made(size, name):
    return np.arange(size), hash(name)

@njit_in_one_place
def apart(x):
    return 3.0 * x

@njit
def through(function, x):
    return function(x) + function(1.0)

compile_ahead(inner, np.ones(2), np.ones(2))
compiled = []
with on_compile(lambda name: compiled.append(name.rpartition('.')[2])):
    print(entry(np.ones(2), np.ones(2)), places(np.ones(2)))
print('compiled:', *compiled)
for x in -np.ones(2), np.ones(3):
    try:
        entry(x, np.ones(2))
    except ValueError as error:
        print(type(error).__name__, *error.args)
print(inner(np.ones(2), np.ones(2)))  # called by Python, too
array, number = made(3, 'name')
print(array, number == hash('name'))
print(through(pointer(apart, 1.0), 2.0), pointer(apart, 1.0) is pointer(apart, 2.0))
has_compiler = 'numba.np.arraymath' in sys.modules
print(numba.njit(lambda x: inner(x, x) + 1.0)(np.ones(2)))  # links what may have been kept
print(has_compiler)
"""


@linked
@pytest.mark.slow
def test_given_functions_that_only_compiled_code_calls_then_errors_in_them_arrive(tmp_path):
    (tmp_path / 'lpv_linked.py').write_text(LINKED)
    cache = {'XDG_CACHE_HOME': str(tmp_path)}
    outputs = [printed('import lpv_linked', tmp_path, **cache) for _ in ('compiled', 'kept')]
    expected = [
        '5.0 2.0', 'ValueError negative -1.0',
        'ValueError incompatible array sizes for np.dot(a, b) (vector * vector)', '4.0',
        '[0 1 2] True', '9.0 True', '5.0',
    ]  # fmt: skip
    # What was compiled ahead is not compiled again, and what is kept does without the compiler.
    # Constants are no types of their own: a function that takes several is compiled once.
    told = ('compiled: entry places place', 'True'), ('compiled:', 'False')
    for output, (compiled, has_compiler) in zip(outputs, told):
        lines = output.splitlines()
        assert (lines.pop(), lines.pop(1), lines) == (has_compiler, compiled, expected)


DRAWN = """
import os
import numba
import numpy as np
from lpv.core.support.jit import compile_ahead, njit

@njit
def normal(generator):
    return generator.standard_normal()

{shares}
for k, function in enumerate((normal, {names})):
    child = os.fork()
    if not child:
        for _ in range(k):  # functions are numbered in the order in which they are compiled
            numba.njit(lambda: 0)()
        compile_ahead(function, np.random.default_rng(0))
        os._exit(0)
    os.waitpid(child, 0)
for both in ({boths}):
    print(both(np.random.default_rng(0)))
expected = np.random.default_rng(0)
expected.standard_normal()
print(expected.random())
"""
_SHARE = """
@njit
def share_{k}(generator):
    return generator.random()

@njit
def both_{k}(generator):
    normal(generator)
    return share_{k}(generator)
"""


@linked
@pytest.mark.slow
def test_given_functions_kept_by_several_processes_when_linked_then_each_draws_its_own(tmp_path):
    names, boths = (', '.join(f'{name}_{k}' for k in range(3)) for name in ('share', 'both'))
    shares = ''.join(_SHARE.format(k=k) for k in range(3))
    (tmp_path / 'lpv_drawn.py').write_text(DRAWN.format(shares=shares, names=names, boths=boths))
    drawn = printed('import lpv_drawn', tmp_path, XDG_CACHE_HOME=str(tmp_path)).splitlines()
    assert len(drawn) == 4 and len(set(drawn)) == 1, drawn


HOLD = """
import sys, time
from pathlib import Path
from lpv.core.support.process_lock import ProcessLock
with ProcessLock(Path(sys.argv[1])).held('one'):
    print('held', flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path):
    """A process that holds the lock named one."""
    command = [sys.executable, '-c', HOLD, str(tmp_path / 'locks')]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'held\n'
        yield process
        process.kill()


def test_given_a_process_that_holds_a_name_then_others_wait_until_it_ends(tmp_path, other):
    lock = ProcessLock(tmp_path / 'locks')
    pauses = []

    def pause(seconds):  # it is seen to wait, then the other process dies
        pauses.append(seconds)
        if len(pauses) == 3:
            other.send_signal(signal.SIGKILL)
            other.wait()

    with pytest.MonkeyPatch.context() as patch, lock.held('another name'):
        patch.setattr(process_lock.time, 'sleep', pause)
        with lock.held('one'), lock.held('one'):  # twice by the same process
            pass
    assert len(pauses) == 3


def test_given_a_process_that_hangs_when_waited_for_then_not_for_ever(tmp_path, other, monkeypatch):
    monkeypatch.setattr(process_lock, '_PATIENCE', 0.05)
    with ProcessLock(tmp_path / 'locks').held('one'):
        assert other.poll() is None


@pytest.mark.parametrize('error', [FileNotFoundError, PermissionError])
def test_given_no_place_for_locks_then_nobody_waits(tmp_path, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr(process_lock.os, 'open', fail)
    monkeypatch.setattr(process_lock.time, 'sleep', lambda _: pytest.fail('it waits'))
    with ProcessLock(tmp_path / 'locks').held('one'):
        pass
