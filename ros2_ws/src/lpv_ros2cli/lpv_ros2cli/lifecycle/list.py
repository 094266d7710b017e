"""``ros2 lifecycle list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.lifecycle.client import Lifecycle


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    parser.add_argument(
        '-a', '--all', action='store_true', help='also transitions that are not possible now'
    )


def run(arguments: Namespace) -> None:
    """Print the transitions of a node."""
    with discovery.command_node() as node:
        lifecycle = Lifecycle(node, arguments.node_name, arguments.spin_time)
        found = lifecycle.transition_graph() if arguments.all else lifecycle.transitions()
    for one in found:
        print(
            f'- {one.transition.label} [{one.transition.id}]\n'
            f'\tStart: {one.start_state.label}\n\tGoal: {one.goal_state.label}'
        )
