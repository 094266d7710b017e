"""The command line's parser, which says plainly what this ``ros2`` does not cover."""

import argparse
import importlib
from argparse import ArgumentParser
from typing import Any

from lpv_ros2cli.command_line.registry import COMMANDS, VERBS, canonical, module_of
from lpv_ros2cli.errors import CliError

NOT_COVERED = 'is not covered by this ros2, a small stand-in for machines without ros2cli; '
USAGE_ERROR = 2
"""Exit code of a wrong command line, as of argparse."""


class _Parser(argparse.ArgumentParser):
    """Refuses abbreviated options: they would change their meaning with the next option."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)


def parse(argv: list[str]) -> argparse.Namespace:
    """Parse a command line."""
    parser = build_parser(*chosen(argv))
    arguments, unknown = parser.parse_known_args(argv)
    options = [argument for argument in unknown if argument.startswith('-')]
    if options:
        raise CliError(
            f'option {options[0]!r} {NOT_COVERED}see {arguments.parser.prog} --help', USAGE_ERROR
        )
    if unknown:
        arguments.parser.error(f'unexpected arguments: {" ".join(unknown)}')
    return arguments


def chosen(argv: list[str]) -> tuple[str | None, str | None]:
    """Command and verb of a command line."""
    if not argv or argv[0].startswith('-'):
        return None, None
    command = canonical(argv[0])
    if command not in VERBS and command not in COMMANDS:
        raise CliError(
            f'{argv[0]!r} {NOT_COVERED}covered here: ' + ', '.join(sorted((*VERBS, *COMMANDS))),
            USAGE_ERROR,
        )
    if command in COMMANDS or len(argv) < 2 or argv[1].startswith('-'):
        return command, None
    verbs = VERBS[command][1]
    if argv[1] not in verbs:
        raise CliError(
            f'{command} {argv[1]!r} {NOT_COVERED}covered here: {", ".join(verbs)}', USAGE_ERROR
        )
    return command, argv[1]


def build_parser(command: str | None = None, verb: str | None = None) -> argparse.ArgumentParser:
    """Parser in which only the chosen verb's module is imported."""
    parser = _Parser(
        prog='ros2',
        description='The everyday part of the ros2 command, for '
        'machines where ROS 2 comes from wheels without ros2cli.',
    )
    parser.set_defaults(run=None, parser=parser)
    commands = parser.add_subparsers(metavar='COMMAND', parser_class=_Parser)
    for name, text in sorted({**{k: v[0] for k, v in VERBS.items()}, **COMMANDS}.items()):
        sub = commands.add_parser(
            name,
            help=text,
            description=_sentence(text),
            aliases=['wtf'] if name == 'doctor' else [],
        )
        sub.set_defaults(parser=sub)
        if name == command and name in COMMANDS:
            _implement(sub, module_of(name))
        elif name in VERBS:
            _add_verbs(sub, name, verb if name == command else None)
    return parser


def _add_verbs(parser: ArgumentParser, command: str, chosen_verb: str | None) -> None:
    verbs = parser.add_subparsers(metavar='VERB', parser_class=_Parser)
    for name, text in VERBS[command][1].items():
        sub = verbs.add_parser(name, help=text, description=_sentence(text))
        sub.set_defaults(parser=sub)
        if name == chosen_verb:
            _implement(sub, module_of(command, name))


def _implement(parser: ArgumentParser, module: str) -> None:
    implementation = importlib.import_module(module)
    implementation.add_arguments(parser)
    parser.set_defaults(run=implementation.run)


def _sentence(text: str) -> str:
    return f'{text[0].upper()}{text[1:]}.'
