"""``ros2 pkg executables``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli import packages
from lpv_ros2cli.command_line import completion


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(
        parser, completion.packages, 'package_name', nargs='?', help='package; otherwise all'
    )
    parser.add_argument('--full-path', action='store_true', help='show the paths')


def run(arguments: Namespace) -> None:
    """Print the programs of one package or of all."""
    chosen = [arguments.package_name] if arguments.package_name else packages.names()
    for package in chosen:
        for path in packages.executables(package):
            print(path if arguments.full_path else f'{package} {path.name}')
