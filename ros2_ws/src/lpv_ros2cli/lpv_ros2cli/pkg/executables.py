"""``ros2 pkg executables``."""

from lpv_ros2cli import completion, packages


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        'package_name', nargs='?', help='package; otherwise all'
    ).completer = completion.packages
    parser.add_argument('--full-path', action='store_true', help='show the paths')


def run(arguments) -> None:
    """Print the programs of one package or of all."""
    chosen = [arguments.package_name] if arguments.package_name else packages.names()
    for package in chosen:
        for path in packages.executables(package):
            print(path if arguments.full_path else f'{package} {path.name}')
