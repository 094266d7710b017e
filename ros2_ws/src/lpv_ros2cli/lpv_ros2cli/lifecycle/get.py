"""``ros2 lifecycle get``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.lifecycle.client import Lifecycle, managed_nodes


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser, nargs='?', help='node; otherwise all managed ones')


def run(arguments: Namespace) -> int:
    """Print the state of one node or of all managed ones."""
    with discovery.command_node() as node:
        if arguments.node_name:
            state = Lifecycle(node, arguments.node_name, arguments.spin_time).state()
            print(f'{state.label} [{state.id}]')
            return 0
        discovery.settle(node, arguments.spin_time)
        code = 0
        for name in managed_nodes(node, arguments.include_hidden_nodes):
            try:
                state = Lifecycle(node, name).state()
                print(f'{name}: {state.label} [{state.id}]')
            except CliError as error:  # a node that hangs must not hide the others
                print(f'{name}: {error}')
                code = 1
        return code
