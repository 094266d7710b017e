"""``ros2 run``."""

import argparse
import os
import shlex

from lpv_ros2cli import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.packages import executable


def add_arguments(parser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('--prefix', help='command that starts the program, e.g. "gdb --args"')
    parser.add_argument('package', help='package').completer = completion.packages
    parser.add_argument('executable', help='its program').completer = completion.executables
    parser.add_argument('argv', nargs=argparse.REMAINDER, metavar='...', help='passed on')


def run(arguments) -> None:
    """Become the program, which then gets signals and returns its exit code itself."""
    path = executable(arguments.package, arguments.executable)
    command = [*shlex.split(arguments.prefix or ''), str(path), *arguments.argv]
    try:
        os.execvp(command[0], command)
    except OSError as error:
        raise CliError(f'{command[0]} cannot be started: {error}') from error
