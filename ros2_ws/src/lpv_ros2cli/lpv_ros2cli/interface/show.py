"""``ros2 interface show``."""

import re
import sys
from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.message.types import definition, full_type, installed

_FIELD = re.compile(r'([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[a-zA-Z]\w*\s*(?![=\w])')
_DEEPEST = 20


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(
        parser, lambda **_: installed(), 'type', help='interface type, or - to read it from stdin'
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        '--all-comments', action='store_true', help='also the comments of nested types'
    )
    group.add_argument('--no-comments', action='store_true', help='no comments and blank lines')


def run(arguments: Namespace) -> None:
    """Print a definition, with nested types indented below the fields that have them."""
    name = arguments.type if arguments.type != '-' else sys.stdin.readline().strip()
    _show(name, arguments, 0)


def _show(name: str, arguments: Namespace, depth: int) -> None:
    comments = arguments.all_comments or (depth == 0 and not arguments.no_comments)
    for line in definition(name).splitlines():
        code = line.partition('#')[0] if '"' not in line and "'" not in line else line
        shown = line.rstrip() if comments else code.rstrip()
        if shown.strip() or comments:
            print('\t' * depth + shown if shown else '')
        nested = _nested_type(code.strip(), name)
        if nested is not None and depth < _DEEPEST:
            _show(nested, arguments, depth + 1)


def _nested_type(line: str, owner: str) -> str | None:
    """Message type of a field, None for built-in types, constants and separators."""
    found = _FIELD.match(line)
    if not found:
        return None
    kind = found.group(1)
    package = owner.split('/')[0]
    if kind == 'Header':
        kind = 'std_msgs/Header'
    if '/' not in kind:
        kind = f'{package}/{kind}'
        if kind.replace('/', '/msg/') not in installed([package]):
            return None
    return full_type(kind, 'msg')
