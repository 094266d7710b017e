"""``ros2 run``."""

import argparse
import os
import shlex
from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.packages import executable


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('--prefix', help='command that starts the program, e.g. "gdb --args"')
    completion.add_argument(parser, completion.packages, 'package', help='package')
    completion.add_argument(parser, completion.executables, 'executable', help='its program')
    parser.add_argument('argv', nargs=argparse.REMAINDER, metavar='...', help='passed on')


def run(arguments: Namespace) -> None:
    """Become the program, which then gets signals and returns its exit code itself."""
    path = executable(arguments.package, arguments.executable)
    command = [*shlex.split(arguments.prefix or ''), str(path), *arguments.argv]
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise CliError(f'{command[0]} cannot be started: {error}') from error
