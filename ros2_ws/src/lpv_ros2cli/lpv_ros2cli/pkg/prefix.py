"""``ros2 pkg prefix``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli import packages
from lpv_ros2cli.command_line import completion


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(parser, completion.packages, 'package_name', help='package')
    parser.add_argument('--share', action='store_true', help='show the share folder')


def run(arguments: Namespace) -> None:
    """Print the prefix of a package."""
    find = packages.share_of if arguments.share else packages.prefix_of
    print(find(arguments.package_name))
