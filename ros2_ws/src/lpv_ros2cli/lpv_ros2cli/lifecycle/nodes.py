"""``ros2 lifecycle nodes``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery
from lpv_ros2cli.lifecycle.client import managed_nodes


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    parser.add_argument(
        '-a', '--all', action='store_true', help='also nodes whose name begins with an underscore'
    )
    parser.add_argument(
        '-c', '--count-nodes', action='store_true', help='only show the number of nodes'
    )


def run(arguments: Namespace) -> None:
    """Print the nodes that have a lifecycle."""
    with discovery.command_node() as node:
        discovery.settle(node, arguments.spin_time)
        names = managed_nodes(node, arguments.all)
    if arguments.count_nodes:
        print(len(names))
        return
    for name in names:
        print(name)
