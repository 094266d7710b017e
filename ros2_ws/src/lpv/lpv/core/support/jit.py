"""One switch for compiled numerics.

The recursions of plant, observer and tracker are written in the subset of Python that Numba
compiles.  The nodes, the offline replay and the design tools all call the same compiled functions,
so that their results agree bit for bit.  Where Numba is missing or told to do nothing by
``NUMBA_DISABLE_JIT=1``, or ``LPV_NO_JIT=1`` is set, the very same functions run as plain Python:
slower, same arithmetic.

Compiled code is kept between runs.  Numba's cache notices a change of the file that holds a
function, but not of the files that hold what it calls: each function is kept in a folder named by
the sources of its module and of all that the module imports.  A change of one module therefore
compiles again what depends on it, and nothing else; two checkouts of the same sources share.
Nodes that start together compile each function in one of them only (see `process_lock`), and
functions that Python never calls are linked into those that it calls (see `linking`).
"""

import gc
import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.support.process_lock import ProcessLock

_IMPORT = re.compile(r'^ *from (lpv[\w.]*) import (\([^)]*\)|.*)$|^ *import (lpv[\w.]*)', re.M)


def source_digest(folder: Path) -> str:
    """Hash of the Python files of a package, those of its sub-packages included."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob('*.py')):
        digest.update(source.relative_to(folder).as_posix().encode() + b'\0')
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _imports(source: Path) -> tuple[bytes, frozenset[str]]:
    """Digest of a file, and the names of this project's modules that it may import."""
    text = source.read_text(encoding='utf-8')
    names = set()
    for package, imported, module in _IMPORT.findall(text):
        names.add(package or module)
        # What is imported from a package may be a module of it.
        names.update(f'{package}.{name}' for name in re.findall(r'\w+', imported))
    return hashlib.sha256(text.encode()).digest(), frozenset(names)


@cache
def _source(module: str, above: Path) -> Path | None:
    """File of a module of this project, by its dotted name; None where a name is none.

    ``above`` is the folder that holds the package of the module that imports it.
    """
    package = module.partition('.')[0]
    top = getattr(sys.modules.get(package), '__file__', None)
    place = (Path(top).parents[1] if top else above).joinpath(*module.split('.'))
    for file in (place.with_suffix('.py'), place / '__init__.py'):
        if file.is_file():
            return file
    return None


@cache
def module_digest(source: Path, module: str) -> str:
    """Hash of a module and of all modules of this project that it imports, directly or not.

    The hash is the same wherever the sources lie.
    """
    above = source.parents[module.count('.')]
    digests, waiting = {module: _imports(source)[0]}, [source]
    while waiting:
        for name in _imports(waiting.pop())[1]:
            file = _source(name, above)
            if file is not None and name not in digests:
                digests[name] = _imports(file)[0]
                waiting.append(file)
    total = hashlib.sha256()
    for name in sorted(digests):
        total.update(name.encode() + b'\0' + digests[name])
    return total.hexdigest()[:16]


def _cache_home() -> Path | None:
    """Folder of all compiled code of this user; None where no safe one can be made."""
    home = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'lpv_arm_fdi'
    for folder in (home, Path(tempfile.gettempdir()) / f'lpv_arm_fdi-{os.getuid()}'):
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Machine code is run from here: a folder of somebody else's is not trusted.
            if folder.stat().st_uid == os.getuid() and os.access(folder, os.W_OK):
                return folder
        except OSError:
            continue
    return None


def _load_numba() -> Any:
    if os.environ.get('LPV_NO_JIT', '') == '1':
        return None
    try:
        import numba
    except ImportError:  # a machine without Numba runs the plain functions
        return None
    settings: Any = numba.config
    if settings.DISABLE_JIT:
        return None
    import lpv.core.support.references  # noqa: F401

    return numba


_numba = _load_numba()
_home = _cache_home() if _numba is not None and 'NUMBA_CACHE_DIR' not in os.environ else None
_compiling = ProcessLock(_home / 'compiling') if _home is not None else None

COMPILED = _numba is not None
_SETTINGS = ('CACHE_DIR', 'CACHE_LOCATOR_CLASSES')
"""Settings of Numba that differ from function to function here."""


if _numba is not None:
    from numba.core.compiler_lock import global_compiler_lock as _one_thread

    from lpv.core.support import linking as _linking

    _linking.install()

if _home is not None:
    from numba.core import caching as _caching

    # Older versions of Numba know no such setting: there, each checkout has a cache of its own.
    class SourceLocator(getattr(_caching, 'UserProvidedCacheLocator', object)):  # type: ignore[misc]
        """Cached code of a function lies below its digest, wherever its sources are."""

        @classmethod
        def get_suitable_cache_subpath(cls, py_file: str) -> str:
            """Nothing below the folder of the digest."""
            return ''


def _place_cache(function: Callable[..., Any], kind: str) -> None:
    """Let Numba keep the function where the sources that it depends on say."""
    if _home is not None:
        source = Path(function.__code__.co_filename)
        digest = module_digest(source, function.__module__)
        _numba.config.CACHE_DIR = str(_home / f'{function.__module__}-{digest}' / kind)
        _numba.config.CACHE_LOCATOR_CLASSES = f'{__name__}.SourceLocator'


def _dispatcher(function: Callable[..., Any], kind: str, **options: bool) -> Any:
    """Function as Numba compiles it, kept apart from those of another kind."""
    options.setdefault('no_cfunc_wrapper', True)
    before = {name: getattr(_numba.config, name, '') for name in _SETTINGS}
    try:
        _place_cache(function, kind)
        kept = bool(_numba.config.CACHE_DIR)
        # fastmath stays off: results must not depend on how a loop is vectorised.  Without the
        # interpreter's lock, a replay reads and writes while the recursion runs.
        dispatcher = _numba.njit(
            cache=kept, fastmath=False, error_model='numpy', nogil=True, **options
        )(function)
        if kept:
            _read_kept(dispatcher._cache)
        else:
            _linking.prepare_compiler()
        dispatcher.compile = _compile_once(dispatcher, kind)
        return dispatcher
    finally:
        for name, value in before.items():
            setattr(_numba.config, name, value)


def _read_kept(functions: Any) -> None:
    """Let functions be read from a cache of Numba before Numba gets ready to compile.

    That takes longer than to read them, and few programs compile.
    """

    def load(types: Any, context: Any) -> Any:
        _linking.prepare_calls()
        kept = None
        with functions._guard_against_spurious_io_errors():
            kept = functions._load_overload(types, context)
        if kept is None:
            _linking.prepare_compiler()
        return kept

    functions.load_overload = load


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Look for garbage less often: a compiler makes much, and keeps most of it for long."""
    before = gc.get_threshold()
    gc.set_threshold(max(before[0], 200_000), 50, 1000)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _compile_once(dispatcher: Any, kind: str) -> Callable[..., Any]:
    """Numba's way to compile a function for some types, as this project's processes share it."""

    def compile_for(types: Any) -> Any:
        with _one_thread, _seldom_collected(), _linking.libraries(library):
            if _compiling is None or types in dispatcher.overloads:
                return compile_here(types)
            with _compiling.held(f'{kind} {function} {types}'):
                return compile_here(types)

    called = _linking.EntryLibrary if _home is None else _linking.KeptLibrary
    library = _linking.LinkedLibrary if kind == 'compiled' else called
    compile_here = dispatcher.compile
    function = f'{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}'
    return compile_for


def njit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``function`` without reordering of floating-point operations.

    Called by compiled code, it is compiled without the wrapper that unpacks Python's arguments:
    for nested records these are a third of the code, and few functions are called from Python.
    """
    return _compiled(function)


def njit_in_place(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `njit`, for functions that make no arrays: all memory is the caller's.

    References are not counted, which takes as long as the arithmetic does where small functions
    hand large tuples of arrays on.
    """
    return _compiled(function, _nrt=False)


def njit_in_one_place(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `njit_in_place`, for a large function: compiled code calls the machine code by `pointer`.

    Otherwise it is linked, optimised and made again in each function that calls it.
    """
    return _compiled(function, _nrt=False, no_cfunc_wrapper=False)


def _compiled(function: Callable[..., Any], **options: bool) -> Callable[..., Any]:
    if _numba is None:
        return function
    compiled: Callable[..., Any] = update_wrapper(_LazyDispatcher(function, options), function)
    return compiled


class _LazyDispatcher:
    """A function whose dispatchers are made once it is called, or compiled for another one.

    To make all of them takes a third of a node's imports, and a node calls forty of hundreds.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, bool]) -> None:
        self._function, self._options = function, options
        self._made: Any = None

    def __call__(self, *arguments: Any) -> Any:
        return self._called()(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._called(), name)

    def __reduce__(self) -> str:
        return self._function.__qualname__

    def _called(self) -> Any:
        """Dispatcher of calls from Python; those from compiled code have another one."""
        if self._made is None:
            with _one_thread:  # settings are those of the process
                self._made = self._made or self._make()
        return self._made

    def _make(self) -> Any:
        function, options = self._function, self._options
        called = _dispatcher(function, 'python', **options)
        if not _numba.config.CACHE_DIR:  # a cache that is given has no room for two kinds

            @cache
            def inner() -> Any:  # kept code of a caller holds it already
                return _dispatcher(function, 'compiled', no_cpython_wrapper=True, **options)

            def get_call_template(args: Any, kws: dict[str, Any]) -> Any:
                # One function for all constants; where it is linked, they are known again.
                constant = _numba.types.unliteral
                named = {name: constant(kind) for name, kind in kws.items()}
                return inner().get_call_template(tuple(map(constant, args)), named)

            called.get_call_template = get_call_template
            called.get_overload = lambda types: inner().get_overload(types)
            called.compile_linked = lambda types: inner().compile(types)
        return called


def compile_ahead(function: Any, *arguments: Any) -> None:
    """Compile what compiled code that calls the function with such arguments needs, and keep it."""
    compile_linked = getattr(function, 'compile_linked', None)
    if compile_linked is not None:
        compile_linked(tuple(map(function.typeof_pyval, arguments)))


_entries: dict[Any, Callable[..., Any]] = {}
"""What `entry` has found: to find the types of a monitor takes longer than a second of its run."""


def entry(function: Any, *arguments: Any) -> Callable[..., Any]:
    """A compiled function for arguments of these types, which it does not look at at every call.

    There may be a hundred arrays among them.  Their places in memory may differ later on, and they
    may be contiguous where these are not.
    """
    if not COMPILED:
        return function
    key = function, tuple(map(_signature, arguments))
    if key not in _entries:
        types = tuple(map(function.typeof_pyval, arguments))
        function.compile(types)
        _entries[key] = function.overloads[types].entry_point
    return _entries[key]


_pointers: dict[Callable[..., Any], Any] = {}


def pointer(function: Any, *arguments: Any) -> Any:
    """The `entry` of an `njit_in_one_place` function as an argument of compiled functions."""
    called = entry(function, *arguments)
    if COMPILED and called not in _pointers:
        import numba.experimental.function_type  # noqa: F401  # Numba does before it compiles

        (kept,) = (one for one in function.overloads.values() if one.entry_point is called)
        _pointers[called] = _numba.types.CompileResultWAP(kept)
    return _pointers.get(called, called)


def _signature(value: Any) -> Any:
    """What the type of an argument depends on."""
    if isinstance(value, tuple):
        return type(value), *map(_signature, value)
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    return getattr(value, 'dtype', value if callable(value) else type(value))


class Entries:
    """Calls compiled functions, each of them always with arguments of the same types."""

    def __init__(self) -> None:
        self._found: dict[Callable[..., Any], Callable[..., Any]] = {}

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns, by its `entry`."""
        if function not in self._found:
            self._found[function] = entry(function, *arguments)
        return self._found[function](*arguments)


@contextmanager
def on_compile(tell: Callable[[str], None]) -> Iterator[None]:
    """Call ``tell`` with the name of each function of this project that is compiled meanwhile.

    Functions that are kept from an earlier run are not compiled.
    """
    if _numba is None:
        yield
        return
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            function = event.data['dispatcher'].py_func
            if function.__module__.startswith('lpv'):
                tell(f'{function.__module__}.{function.__name__}')

        def on_end(self, event: Any) -> None:
            pass

    listener = Listener()
    event.register('numba:compile', listener)
    try:
        yield
    finally:
        event.unregister('numba:compile', listener)
