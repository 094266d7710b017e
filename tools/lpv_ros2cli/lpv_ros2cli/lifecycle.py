"""``ros2 lifecycle``: get, set."""

import argparse
import math

from lpv_ros2cli import graph
from lpv_ros2cli.command_line import CliError, takes


@takes('node_name')
def run_get(arguments: argparse.Namespace) -> None:
    """Print the lifecycle state of a node."""
    from lifecycle_msgs.srv import GetState

    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        state = graph.call(node, GetState, f'{name}/get_state').current_state
    print(f'{state.label} [{state.id}]')


@takes('node_name', 'transition')
def run_set(arguments: argparse.Namespace) -> None:
    """Trigger a lifecycle transition by its name or number."""
    from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions

    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        found = graph.call(node, GetAvailableTransitions, f'{name}/get_available_transitions')
        available = [item.transition for item in found.available_transitions]
        chosen = [t for t in available if arguments.transition in (t.label, str(t.id))]
        if not chosen:
            lines = ''.join(f'\n- {t.label} [{t.id}]' for t in available)
            raise CliError(f'Unknown transition requested, available ones are:{lines}')
        request = ChangeState.Request(transition=chosen[0])
        done = graph.call(node, ChangeState, f'{name}/change_state', request, math.inf)
        if not done.success:
            raise CliError('Transitioning failed')
        print('Transitioning successful', flush=True)  # leaving the graph may take its time
