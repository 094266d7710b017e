"""``ros2 run``: run a program of a package."""

import argparse
import os

from lpv.core.support.resources import executable
from lpv_ros2cli.command_line import CliError, takes


@takes('package', help='package')
@takes('executable', help='its program')
@takes('argv', nargs=argparse.REMAINDER, metavar='...', help='passed on')
def run(arguments: argparse.Namespace) -> None:
    """Become the program, which then gets signals and returns its exit code itself."""
    program = str(executable(arguments.package, arguments.executable))
    try:
        os.execv(program, [program, *arguments.argv])
    except OSError as error:
        raise CliError(f'{program} cannot be started: {error}') from error
