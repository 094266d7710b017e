"""Functions that only compiled code calls are linked into it, and made into machine code there.

Numba makes machine code of every function together with all that it calls, so what lies six calls
deep is optimised and made six times.  A `LinkedLibrary` keeps its intermediate code and leaves both
to the function that is called from Python.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from typing import Any

from numba.core import config, environment
from numba.core.bytecode import FunctionIdentity
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.environment import Environment, lookup_environment
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys
from numba.core.targetconfig import TargetConfig

_EXPECTED = (
    '_optimize_functions',
    '_optimize_final_module',
    '_finalize_final_module',
    '_finalize_specific',
    '_finalize_dynamic_globals',
    '_verify_declare_only_symbols',
    'serialize_using_object_code',
    'serialize_using_bitcode',
    '_unserialize',
    '_set_compiled_object',
    'get_pointer_to_function',
)
"""What this file takes for granted of Numba's libraries."""
_ENVIRONMENT = '_ZN08NumbaEnv'


class LinkedLibrary(JITCodeLibrary):
    """Code of a function that Python never calls: there is no machine code of its own."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """In a third of the time: where it is linked, all is optimised again."""
        settings: Any = config
        before, settings.OPT = settings.OPT, min(settings.OPT, 1)
        try:
            super()._optimize_functions(ll_module)
        finally:
            settings.OPT = before

    def _optimize_final_module(self) -> None:
        """Left to the library that this one is linked into."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Null: no symbol has an address here."""
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self) -> Any:
        """Intermediate code, as there is no other."""
        return self.serialize_using_bitcode()


class EntryLibrary(JITCodeLibrary):
    """Code of a function that Python calls, with all that is linked into it."""

    _codegen: Any

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                constants = lookup_environment(variable.name)
                if constants is not None:
                    self._codegen.set_env(variable.name, constants)


class KeptLibrary(EntryLibrary):
    """As that; as nothing else links it, its intermediate code is not kept.

    To read that takes longer than to read all the rest.
    """

    def serialize_using_object_code(self) -> Any:
        """Machine code, and the names of what is in it."""
        names = {function.name for function in self.get_defined_functions()}
        return self.name, 'object', (self._get_compiled_object(), names)

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, _, (machine_code, names) = state
        library = cls(codegen, name)
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        codegen._engine._defined_symbols |= names
        return library


class _State(threading.local):
    library: Any = EntryLibrary


_state = _State()


class _Codegen(JITCPUCodegen):
    """Makes the libraries of this file."""

    def create_library(self, name: str, **options: Any) -> Any:
        """An empty library."""
        return _state.library(self, name, **options)

    def unserialize_library(self, serialized: Any) -> Any:
        """A library that was kept."""
        return _state.library._unserialize(self, serialized)

    def set_env(self, env_name: str, env: Any) -> None:
        """Set the constants of a function, if there is machine code that reads them."""
        if self._engine.get_global_value_address(env_name):
            super().set_env(env_name, env)


_rebuild_env = environment._rebuild_env


@wraps(_rebuild_env, assigned=('__module__', '__name__', '__qualname__'))  # by these it is kept
def _constants(module: str, values: list[Any], name: str) -> Any:
    """Constants of kept code; that of Numba's own reads nothing else of the modules it is from."""
    if lookup_environment(name) is not None or not module.startswith('numba.'):
        return _rebuild_env(module, values, name)
    constants = Environment({'__name__': module})
    constants.consts[:], constants.env_name = values, name
    Environment._memo[name] = constants
    return constants


_equal = TargetConfig.__eq__


def _hash_of_flags(flags: Any) -> int:
    return hash(type(flags))


def _equal_flags(one: Any, other: Any) -> bool:
    """As Numba's own, which looks up thirty options: that took a tenth of the time to compile."""
    return (type(one) is type(other) and one._values == other._values) or _equal(one, other)


def install() -> None:
    """Let Numba read constants this way, and make the libraries of this file, if as expected."""
    environment._rebuild_env = _constants
    if hasattr(TargetConfig, '_values'):
        TargetConfig.__eq__ = _equal_flags  # type: ignore[method-assign]
        TargetConfig.__hash__ = _hash_of_flags  # type: ignore[method-assign]
    # Numba's own functions are told apart by numbers that every process counts from 1.  Code that
    # processes kept is linked by names: of two functions of one number, one would stand for both.
    drawn = iter(lambda: int.from_bytes(os.urandom(6), 'big'), None)
    FunctionIdentity._unique_ids = drawn  # type: ignore[assignment]
    codegen = cpu_target.target_context.codegen()
    as_expected = (
        type(codegen) is JITCPUCodegen
        and hasattr(codegen._engine, '_defined_symbols')
        and all(hasattr(JITCodeLibrary, name) for name in _EXPECTED)
    )
    if as_expected:
        codegen.__class__ = _Codegen


@cache
def prepare_calls() -> None:
    """Let kept code find what it calls of Numba: memory of arrays, and secrets of hashes."""
    with libraries(EntryLibrary):
        rtsys.initialize(cpu_target.target_context)
        import_module('numba.cpython.hashing')


@cache
def prepare_compiler() -> None:
    """Let Numba get ready to compile, with what it compiles for itself, which C code calls."""
    with libraries(EntryLibrary):
        cpu_target.target_context.refresh()


@contextmanager
def libraries(kind: type[JITCodeLibrary]) -> Iterator[None]:
    """Functions compiled or read meanwhile are libraries of this kind."""
    before, _state.library = _state.library, kind
    try:
        yield
    finally:
        _state.library = before
