"""``ros2 pkg prefix``."""

from lpv_ros2cli import completion, packages


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('package_name', help='package').completer = completion.packages
    parser.add_argument('--share', action='store_true', help='show the share folder')


def run(arguments) -> None:
    """Print the prefix of a package."""
    find = packages.share_of if arguments.share else packages.prefix_of
    print(find(arguments.package_name))
