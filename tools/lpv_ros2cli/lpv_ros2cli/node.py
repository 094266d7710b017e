"""``ros2 node``: list."""

import argparse

from lpv_ros2cli import graph
from lpv_ros2cli.command_line import takes


@takes('-a', '--all', action='store_true', help='also hidden nodes')
def run_list(arguments: argparse.Namespace) -> None:
    """Print the nodes of the graph."""
    with graph.command_node() as node:
        graph.settle(node)
        print(''.join(f'{name}\n' for name in graph.node_names(node, arguments.all)), end='')
