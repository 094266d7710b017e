"""``lpv run``: what ``ros2 run`` does, for machines where ROS 2 comes from wheels without it."""

import argparse
import os

from lpv_cli.completion import completed, packages, programs
from lpv_cli.needs import require_ros
from lpv_core.support.discovery import stay_local
from lpv_core.support.resources import executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    completed(
        parser.add_argument(
            'package', help='ROS package (lpv_arm_sim, lpv_uio, lpv_tracker, lpv_bag)'
        ),
        packages,
    )
    completed(
        parser.add_argument('program', help='its program (simulator, uio, tracker, recorder)'),
        programs,
    )
    parser.add_argument(
        'rest',
        nargs=argparse.REMAINDER,
        metavar='...',
        help='passed on: --ros-args -p name:=value -r from:=to --params-file FILE',
    )


def run(arguments: argparse.Namespace) -> None:
    """Become the program; returns only where it cannot be started."""
    stay_local()
    require_ros()
    path = executable(arguments.package, arguments.program)
    os.execv(path, [str(path), *arguments.rest])
