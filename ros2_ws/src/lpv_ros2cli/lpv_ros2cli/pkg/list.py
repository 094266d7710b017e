"""``ros2 pkg list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.packages import names


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments: there are none."""


def run(_arguments: Namespace) -> None:
    """Print the names of the packages."""
    for name in names():
        print(name)
