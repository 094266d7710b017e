"""``lpv run``: what ``ros2 run`` does, for machines where ROS 2 comes from wheels without it."""

import argparse
import os

from lpv_cli.completion import packages, programs
from lpv_core.support.resources import executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument(
        'package', help='ROS package (lpv_arm_sim, lpv_uio, lpv_tracker, lpv_bag)'
    ).completer = packages
    parser.add_argument(
        'program', help='its program (simulator, uio, tracker, recorder)'
    ).completer = programs
    parser.add_argument(
        'rest',
        nargs=argparse.REMAINDER,
        metavar='...',
        help='passed on: --ros-args -p name:=value -r from:=to --params-file FILE',
    )


def run(arguments: argparse.Namespace) -> None:
    """Become the program; returns only where it cannot be started.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add_arguments`.

    Returns
    -------
    int
        Never.
    """
    # Nobody else's business: nodes are found on this machine only, unless asked otherwise.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    path = executable(arguments.package, arguments.program)
    os.execv(path, [str(path), *arguments.rest])
