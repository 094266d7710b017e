"""``ros2 lifecycle nodes``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.lifecycle.client import managed_nodes


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_arguments(parser)


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
