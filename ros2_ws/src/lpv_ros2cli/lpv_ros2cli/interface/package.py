"""``ros2 interface package``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli import packages
from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.message.types import add_kind_arguments, chosen_kinds, installed


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_kind_arguments(parser)
    completion.add_argument(parser, completion.packages, 'package_name', help='package')


def run(arguments: Namespace) -> None:
    """Print the interface types of a package."""
    package = arguments.package_name
    if package not in packages.names():
        raise CliError(f"Unknown package '{package}'")
    for name in installed([package]):
        if name.split('/')[1] in chosen_kinds(arguments):
            print(name)
