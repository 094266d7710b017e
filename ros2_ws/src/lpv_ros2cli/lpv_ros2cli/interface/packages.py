"""``ros2 interface packages``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.message.types import add_kind_arguments, chosen_kinds, installed


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_kind_arguments(parser)


def run(arguments: Namespace) -> None:
    """Print the packages that have interfaces."""
    parts = [name.split('/') for name in installed()]
    for package in sorted({part[0] for part in parts if part[1] in chosen_kinds(arguments)}):
        print(package)
