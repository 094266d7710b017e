"""``ros2 launch``."""

import argparse
from argparse import ArgumentParser, Namespace
from pathlib import Path

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.actions import evaluate_file
from lpv_ros2cli.launch.arguments import declared, describe_arguments, parse_arguments
from lpv_ros2cli.launch.context import Context
from lpv_ros2cli.launch.files import find_launch_file
from lpv_ros2cli.launch.log import LaunchLog
from lpv_ros2cli.launch.runner import Runner

_FLAGS = (
    (('-n', '--noninteractive'), 'ignored', 'accepted for compatibility: nothing is asked here'),
    (('-d', '--debug'), 'debug', 'show command lines'),
    (
        ('-a', '--show-all-subprocesses-output'),
        'show_all_subprocesses_output',
        'show all that the processes print',
    ),
)
_MODES = (
    (('-p', '--print', '--print-description'), 'outline', 'print what would be done'),
    (
        ('-s', '--show-args', '--show-arguments'),
        'show_args',
        'show the arguments that the file takes',
    ),
)
"""Options: names, attribute, help; of the modes only one is taken."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the command's arguments."""
    modes = parser.add_mutually_exclusive_group()
    for group, flags in ((parser, _FLAGS), (modes, _MODES)):
        for names, name, text in flags:
            group.add_argument(*names, action='store_true', dest=name, help=text)
    completion.add_argument(
        parser, completion.packages, 'package_or_file', help='package, or path of a launch file'
    )
    completion.add_argument(
        parser,
        completion.launch_words,
        'rest',
        nargs=argparse.REMAINDER,
        metavar='[file] name:=value ...',
        help='launch file of the package, and launch arguments',
    )


def run(arguments: Namespace) -> int:
    """Run a launch file; 1 if a process ended with an error before everything was stopped."""
    options, words = _leading_options(arguments)
    path, words = _file(arguments.package_or_file, words)
    given = parse_arguments(words)
    if options.show_args:
        print(describe_arguments(declared(path, Context(given))))
        return 0
    plan = evaluate_file(Context(given), path)
    if options.outline:
        for depth, line in plan.outline:
            print(f'{"    " * (depth - 1)}{line}')
        return 0
    log = LaunchLog(options.debug, options.show_all_subprocesses_output)
    try:
        log.note('INFO', 'launch', f'All log files can be found below {log.folder}')
        log.note(
            'INFO',
            'launch',
            f'Default logging verbosity is set to {"DEBUG" if options.debug else "INFO"}',
        )
        for message in plan.messages:
            log.note('INFO', 'launch.user', message)
        return Runner(plan.processes, log).run()
    finally:
        log.close()


def _leading_options(arguments: Namespace) -> tuple[Namespace, list[str]]:
    """Options may also follow the file, where argparse passes everything on."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for names, name, _ in (*_FLAGS, *_MODES):
        parser.add_argument(
            *names, action='store_true', dest=name, default=getattr(arguments, name)
        )
    options, words = parser.parse_known_args(arguments.rest)
    unknown = [word for word in words if word.startswith('-') and ':=' not in word]
    if unknown:
        raise CliError(
            f'option {unknown[0]!r} is not covered by this ros2; see ros2 launch --help', 2
        )
    return options, words


def _file(package_or_file: str, words: list[str]) -> tuple[Path, list[str]]:
    path = Path(package_or_file)
    if path.is_file():
        return path, words
    if path.suffix in ('.xml', '.yaml', '.yml', '.py') or '/' in package_or_file:
        raise CliError(f"launch file '{package_or_file}' does not exist")
    if not words or ':=' in words[0]:
        raise CliError(f"a launch file of package '{package_or_file}' must be named")
    return find_launch_file(package_or_file, words[0]), words[1:]
