"""Texts with substitutions: ``$(name argument ...)``, nested and quoted."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from lpv_ros2cli.errors import CliError

Parts = tuple['str | Substitution', ...]
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_-]*')


@dataclass(frozen=True)
class Substitution:
    """A substitution that has not been performed."""

    name: str  # for instance ``var``
    arguments: tuple['Parts', ...]


def parse(text: str) -> Parts:
    """Split a text into plain parts and substitutions."""
    parts, position = _parts(text, 0, lambda rest: False)
    assert position == len(text)
    return parts


def _parts(text: str, position: int, ends: Callable[[str], bool]) -> tuple[Parts, int]:
    """Parts up to where ``ends`` is true of the next character."""
    parts: list[str | Substitution] = []
    plain = ''
    while position < len(text) and not ends(text[position]):
        if text[position] == '\\' and position + 1 < len(text) and text[position + 1] in '\\$"\'()':
            plain += text[position + 1]
            position += 2
        elif text.startswith('$(', position):
            substitution, position = _substitution(text, position)
            parts += [plain, substitution]
            plain = ''
        else:
            plain += text[position]
            position += 1
    return tuple(part for part in [*parts, plain] if part != ''), position


def _substitution(text: str, start: int) -> tuple[Substitution, int]:
    found = _NAME.match(text, start + 2)
    if not found:
        raise CliError(f"{text!r}: a name must follow '$('")
    position, arguments = found.end(), list[Parts]()
    while True:
        while text[position : position + 1] == ' ':
            position += 1
        if position >= len(text):
            raise CliError(f"{text!r}: '$(' is not closed")
        if text[position] == ')':
            return Substitution(found.group(), tuple(arguments)), position + 1
        argument, position = _argument(text, position)
        arguments.append(argument)


def _argument(text: str, position: int) -> tuple[Parts, int]:
    quote = text[position]
    if quote not in '\'"':
        return _parts(text, position, lambda c: c in ' )')
    parts, end = _parts(text, position + 1, lambda c: c == quote)
    if end >= len(text):
        raise CliError(f'{text!r}: a quote is not closed')
    return parts, end + 1


_DESCRIPTIONS = {
    'var': 'LaunchConfig',
    'env': 'EnvVar',
    'find-pkg-share': 'FindPackageShare',
    'find-pkg-prefix': 'FindPackagePrefix',
    'eval': 'PythonExpr',
    'dirname': 'ThisLaunchFileDir',
    'filename': 'ThisLaunchFile',
}


def describe(parts: Parts) -> str:
    """A text with substitutions for people, as --show-args shows it."""
    if not parts:
        return "''"
    return ' + '.join(f"'{part}'" if isinstance(part, str) else _describe(part) for part in parts)


def _describe(substitution: Substitution) -> str:
    arguments = [describe(argument) for argument in substitution.arguments]
    if substitution.name.startswith('find-pkg') and arguments:
        arguments[0] = f'pkg={arguments[0]}'
    name = _DESCRIPTIONS.get(substitution.name, substitution.name)
    return f'{name}({", ".join(arguments)})'
