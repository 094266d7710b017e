"""Options of commands and parameters of nodes, declared as their help shows them.

An entry of a table is what is written, two spaces, its help; lines that are indented go on.
``--flag``, ``--name VALUE``, ``--name VALUE:float``, ``--name=DEFAULT`` of the default's type,
``--name {first,second}`` with the first as default, several metavars for several values; then
``[LOW:HIGH]`` for the range of a number; then ``!`` if it must be given, ``*`` if it may be
repeated, and ``?``, ``+``, ``...`` as `argparse` has them.  An entry that begins with ``|``
excludes the one before, ``# title`` begins a group.
"""

import argparse
import re
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

from lpv.core.support.errors import ConfigError

_RANGE = r'(?:\[([^\s:\]]+):([^\s:\]]+)\])?'
_ENTRY = re.compile(
    r'(\| )?([\w-]+(?:\.[\w-]+)*)(?:=(\S+?)| (.+?)(?::(int|float))?)?' + _RANGE + r'([!?+*]?|\.{3})'
)
_TYPES = {'int': int, 'float': float}


class Entry(NamedTuple):
    """An entry of a table."""

    name: str  # '' for the title of a group
    text: str  # help, or the title
    default: Any = None  # a number, true or a text; None where there is none
    shown: str = ''  # metavars
    choices: tuple[str, ...] = ()
    kind: type | None = None  # of a number
    limits: tuple[float, float] | None = None  # of a number
    mark: str = ''
    excludes: bool = False  # itself and the entry before


def entries(table: str) -> Iterator[Entry]:
    """Entries of a table; ValueError where one cannot be read."""
    for lines in re.split(r'\n+(?! )', table.strip()):
        written, _, text = lines.partition('  ')
        text = ' '.join(text.split())
        if written.startswith('# '):
            yield Entry('', lines[2:])
            continue
        found = _ENTRY.fullmatch(written)
        if found is None:
            raise ValueError(f'{written!r} is no option')
        either, name, default, shown, kind, low, high, mark = found.groups()
        choices: tuple[str, ...] = ()
        if shown and shown.startswith('{'):
            choices, shown = tuple(shown[1:-1].split(',')), ''
            default = choices[0]
        elif default is not None:
            number = re.fullmatch(r'-?\d+(\.\d*)?', default)
            kind = 'float' if number and number[1] else 'int' if number else None
        value = _TYPES[kind](default) if kind and default else default == 'true' or default
        limits = (float(low), float(high)) if low else None
        of_kind = _TYPES.get(kind)
        yield Entry(name, text, value, shown or '', choices, of_kind, limits, mark, bool(either))


def declare(parser: argparse._ActionsContainer, table: str) -> None:
    """Declare the arguments of a table."""
    found = list(entries(table))
    target = parser
    for entry, following in zip(found, [*found[1:], Entry('', '')]):
        if not entry.name:
            parser = target = parser.add_argument_group(entry.text)
            continue
        if following.excludes and not entry.excludes:
            target = parser.add_mutually_exclusive_group(required=entry.mark == '!')
        options: dict[str, Any] = {'help': entry.text}
        words = tuple(entry.shown.split())
        if words:
            options |= (
                {'metavar': words, 'nargs': len(words)} if words[1:] else {'metavar': words[0]}
            )
        elif entry.default is None and entry.name.startswith('-'):
            options['action'] = 'store_true'
        if entry.choices:
            options['choices'] = list(entry.choices)
        if entry.default is not None:
            options |= {'default': entry.default, 'help': f'{entry.text} ({entry.default})'}
        if entry.kind:
            options['type'] = entry.kind
        if entry.limits:
            options['action'] = partial(_Within, *entry.limits)
        if entry.mark == '*':
            options |= {'action': 'append', 'default': []}
        elif entry.mark == '!' and target is parser:
            options['required'] = True
        elif entry.mark in ('?', '+', '...'):
            options['nargs'] = entry.mark
        target.add_argument(entry.name, **options)
        if not following.excludes:
            target = parser


class _Within(argparse.Action):
    """Takes numbers within a range; ConfigError for others."""

    def __init__(self, low: float, high: float, **options: Any) -> None:
        super().__init__(**options)
        self._range = low, high

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        low, high = self._range
        for value in values if isinstance(values, list) else [values]:
            if not low <= value <= high:
                reason = f'must lie within {low:g} and {high:g}, got {value:g}'
                raise ConfigError(option or self.dest, reason)
        setattr(namespace, self.dest, values)
