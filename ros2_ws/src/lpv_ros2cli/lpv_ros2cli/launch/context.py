"""State of a launch while its files are evaluated."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from lpv_ros2cli.command_line.expressions import evaluate
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.substitutions import Parts, Substitution, parse
from lpv_ros2cli.packages import executable, prefix_of, share_of


@dataclass
class Scope:
    """What is local to a group."""

    configurations: dict[str, str] = field(default_factory=dict)  # arguments and ``let``
    environment: dict[str, str] = field(default_factory=dict)  # of the processes
    namespace: str = ''  # of the nodes, absolute
    parameters: list[tuple[str, str]] = field(default_factory=list)  # ``set_parameter``
    remaps: list[tuple[str, str]] = field(default_factory=list)  # ``set_remap``

    def copy(self) -> 'Scope':
        """An independent scope with the same content."""
        return Scope(
            dict(self.configurations),
            dict(self.environment),
            self.namespace,
            list(self.parameters),
            list(self.remaps),
        )


class Context:
    """Scopes, the file that is being read, and substitutions."""

    def __init__(
        self, arguments: dict[str, str], environment: dict[str, str] | None = None
    ) -> None:
        self.scope = Scope(
            dict(arguments), dict(os.environ if environment is None else environment)
        )
        self.file: Path | None = None
        self.depth = 0
        self._anonymous: dict[str, str] = {}

    @contextmanager
    def group(self) -> Iterator[None]:
        """Context whose scope ends with it."""
        outer, self.scope = self.scope, self.scope.copy()
        try:
            yield
        finally:
            self.scope = outer

    @contextmanager
    def inside(self, file: str | Path) -> Iterator[None]:
        """Context in which another file is read."""
        if self.depth >= 50:
            raise CliError(f'{file}: included by itself, or nested too deeply')
        outer, self.file = self.file, Path(file)
        self.depth += 1
        try:
            yield
        finally:
            self.file = outer
            self.depth -= 1

    def perform(self, text: str) -> str:
        """A text with its substitutions performed."""
        return self._join(parse(text))

    def _join(self, parts: Parts) -> str:
        return ''.join(part if isinstance(part, str) else self.perform_one(part) for part in parts)

    def perform_one(self, substitution: Substitution) -> str:
        """The text that one substitution stands for."""
        function = _FUNCTIONS.get(substitution.name)
        if function is None:
            raise CliError(
                f"substitution '$({substitution.name} ...)' is not covered by this "
                f'ros2; covered here: {", ".join(_FUNCTIONS)}'
            )
        action, least, most = function
        arguments = [self._join(argument) for argument in substitution.arguments]
        if not least <= len(arguments) <= most:
            raise CliError(
                f"substitution '$({substitution.name} ...)' takes "
                f'{least if least == most else f"{least} to {most}"} arguments, got '
                f'{len(arguments)}'
            )
        return action(self, *arguments)

    def _var(self, name: str, default: str | None = None) -> str:
        value = self.scope.configurations.get(name, default)
        if value is None:
            raise CliError(f"launch configuration '{name}' does not exist")
        return value

    def _env(self, name: str, default: str | None = None) -> str:
        value = self.scope.environment.get(name, default)
        if value is None:
            raise CliError(f"environment variable '{name}' does not exist")
        return value

    def _anon(self, name: str) -> str:
        return self._anonymous.setdefault(name, f'{name}_{os.getpid()}_{len(self._anonymous)}')

    def _find_exec(self, name: str) -> str:
        path = shutil.which(name, path=self.scope.environment.get('PATH'))
        if path is None:
            raise CliError(f"program '{name}' is not on the PATH")
        return path

    def _eval(self, *words: str) -> str:
        return str(evaluate(' '.join(words)))


def _truth(text: str) -> bool:
    if text.strip().lower() not in ('true', 'false', '1', '0'):
        raise CliError(f'{text!r} is neither true nor false')
    return text.strip().lower() in ('true', '1')


def _equal(left: str, right: str) -> bool:
    try:
        return float(left) == float(right)
    except ValueError:
        return left == right


def _text(value: bool) -> str:
    return str(value).lower()


# Name: (function, least number of arguments, most).
_FUNCTIONS: dict[str, tuple[Callable[..., str], int, int]] = {
    'var': (Context._var, 1, 2),
    'env': (Context._env, 1, 2),
    'find-pkg-share': (lambda _, package: str(share_of(package)), 1, 1),
    'find-pkg-prefix': (lambda _, package: str(prefix_of(package)), 1, 1),
    'exec-in-pkg': (lambda _, name, package: str(executable(package, name)), 2, 2),
    'find-exec': (Context._find_exec, 1, 1),
    'dirname': (lambda self: str(self.file.parent), 0, 0),
    'filename': (lambda self: str(self.file), 0, 0),
    'anon': (Context._anon, 1, 1),
    'eval': (Context._eval, 1, 1000),
    'not': (lambda _, value: _text(not _truth(value)), 1, 1),
    'and': (lambda _, a, b: _text(_truth(a) and _truth(b)), 2, 2),
    'or': (lambda _, a, b: _text(_truth(a) or _truth(b)), 2, 2),
    'equals': (lambda _, a, b: _text(_equal(a, b)), 2, 2),
    'not-equals': (lambda _, a, b: _text(not _equal(a, b)), 2, 2),
}
