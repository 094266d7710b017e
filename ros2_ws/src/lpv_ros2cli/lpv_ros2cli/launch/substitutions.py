"""Texts with substitutions: ``$(name argument ...)``, nested and quoted."""

import re
from dataclasses import dataclass
from typing import Any

from lpv_ros2cli.errors import CliError

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_-]*')


@dataclass(frozen=True)
class Substitution:
    """A substitution that has not been performed.

    Attributes
    ----------
    name : str
        For instance ``var``.
    arguments : tuple of tuple
        Each a sequence of texts and substitutions.
    """

    name: str
    arguments: tuple


def parse(text: str):
    """Split a text into plain parts and substitutions.

    Parameters
    ----------
    text : str
        As in the launch file; a backslash takes the meaning from the character that follows.

    Returns
    -------
    tuple of str or Substitution
        Parts.

    Raises
    ------
    CliError
        If a substitution is not closed or has no name.
    """
    parts, position = _parts(text, 0, lambda rest: False)
    assert position == len(text)
    return parts


def _parts(text, position, ends):
    """Parts up to where ``ends`` is true of the next character."""
    parts, plain = [], ''
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
    return tuple(part for part in (*parts, plain) if part != ''), position


def _substitution(text, start):
    found = _NAME.match(text, start + 2)
    if not found:
        raise CliError(f"{text!r}: a name must follow '$('")
    position, arguments = found.end(), []
    while True:
        while text[position : position + 1] == ' ':
            position += 1
        if position >= len(text):
            raise CliError(f"{text!r}: '$(' is not closed")
        if text[position] == ')':
            return Substitution(found.group(), tuple(arguments)), position + 1
        argument, position = _argument(text, position)
        arguments.append(argument)


def _argument(text, position):
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


def describe(parts: tuple[Any, ...]) -> str:
    """A text with substitutions for people, as --show-args shows it.

    Parameters
    ----------
    parts : tuple
        Of `parse`.

    Returns
    -------
    str
        One line.
    """
    if not parts:
        return "''"
    return ' + '.join(f"'{part}'" if isinstance(part, str) else _describe(part) for part in parts)


def _describe(substitution):
    arguments = [describe(argument) for argument in substitution.arguments]
    if substitution.name.startswith('find-pkg') and arguments:
        arguments[0] = f'pkg={arguments[0]}'
    name = _DESCRIPTIONS.get(substitution.name, substitution.name)
    return f'{name}({", ".join(arguments)})'
