"""``lpv run``: what ``ros2 run`` does, for machines where ROS 2 comes from wheels without it."""

import argparse
import os

from lpv.cli.needs import require_ros
from lpv.core.support.discovery import stay_local
from lpv.core.support.resources import executable


def run(arguments: argparse.Namespace) -> None:
    """Become the program; returns only where it cannot be started."""
    stay_local()
    require_ros()
    path = executable(arguments.package, arguments.program)
    os.execv(path, [str(path), *arguments.rest])
