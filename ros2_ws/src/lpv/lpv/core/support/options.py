"""Options of commands, declared as their help shows them."""

import argparse
import re
from functools import partial
from typing import Any

from lpv.core.support.errors import ConfigError

_RANGE = r'(?:\[([^\s:\]]+):([^\s:\]]+)\])?'
_ENTRY = re.compile(
    r'(\| )?([\w-]+(?:, [\w-]+)*)(?:=(\S+?)| (.+?)(?::(int|float))?)?' + _RANGE + r'([!?+*]?|\.{3})'
)
_TYPES = {'int': int, 'float': float}


def declare(parser: argparse._ActionsContainer, table: str) -> None:
    """Declare the arguments of a table: what is written, two spaces, its help.

    ``--flag``, ``--name VALUE``, ``--name VALUE:float``, ``--name=DEFAULT`` of the default's type,
    ``--name {first,second}`` with the first as default, several metavars for several values; then
    ``[LOW:HIGH]`` for the range of a number; then ``!`` if it must be given, ``*`` if it may be
    repeated, and ``?``, ``+``, ``...`` as `argparse` has them.  An entry that begins with ``|``
    excludes the one before, ``# title`` begins a group; lines that are indented go on.
    """
    entries = re.split(r'\n+(?! )', table.strip())
    target = parser
    for entry, following in zip(entries, [*entries[1:], '']):
        if entry.startswith('# '):
            parser = target = parser.add_argument_group(entry[2:])
            continue
        written, _, text = entry.partition('  ')
        found = _ENTRY.fullmatch(written)
        if found is None:
            raise ValueError(f'{written!r} is no option')
        either, names, default, shown, kind, low, high, mark = found.groups()
        if following.startswith('| ') and not either:
            target = parser.add_mutually_exclusive_group(required=mark == '!')
        options: dict[str, Any] = {}
        if shown and shown.startswith('{'):
            options['choices'] = shown[1:-1].split(',')
            default = options['choices'][0]
        elif shown:
            words = tuple(shown.split())
            options |= {'metavar': words, 'nargs': len(words)} if words[1:] else {'metavar': shown}
        elif default is None and names.startswith('-'):
            options['action'] = 'store_true'
        if default is not None:
            number = re.fullmatch(r'-?\d+(\.\d*)?', default)
            kind = 'float' if number and number[1] else 'int' if number else None
            options['default'] = _TYPES[kind](default) if kind else default
            text += f' ({default})'
        if kind:
            options['type'] = _TYPES[kind]
        if low:
            options['action'] = partial(_Within, low, high)
        if mark == '*':
            options |= {'action': 'append', 'default': []}
        elif mark == '!' and target is parser:
            options['required'] = True
        elif mark in ('?', '+', '...'):
            options['nargs'] = mark
        target.add_argument(*names.split(', '), help=' '.join(text.split()), **options)
        if not following.startswith('| '):
            target = parser


class _Within(argparse.Action):
    """Takes a number within a range; ConfigError for others."""

    def __init__(self, low: str, high: str, **options: Any) -> None:
        super().__init__(**options)
        self._range = float(low), float(high)

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        low, high = self._range
        if not low <= values <= high:
            reason = f'must lie within {low:g} and {high:g}, got {values:g}'
            raise ConfigError(option or self.dest, reason)
        setattr(namespace, self.dest, values)
