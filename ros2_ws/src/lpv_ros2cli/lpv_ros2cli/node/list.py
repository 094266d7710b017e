"""``ros2 node list``."""

import sys
from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.graph.names import node_names


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_arguments(parser)


def run(arguments: Namespace) -> None:
    """Print the nodes of the graph."""
    with discovery.command_node() as node:
        discovery.settle(node, arguments.spin_time)
        names = node_names(node, arguments.all)
    if arguments.count_nodes:
        print(len(names))
        return
    if len(set(names)) < len(names):
        print(
            'WARNING: Be aware that there are nodes in the graph that share an exact name, '
            'which can have unintended side effects.',
            file=sys.stderr,
        )
    for name in names:
        print(name)
