"""``ros2 lifecycle set``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.lifecycle.client import Lifecycle


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    completion.add_argument(
        parser,
        lambda **_: ['configure', 'activate', 'deactivate', 'cleanup', 'shutdown'],
        'transition',
        help='name or number of the transition',
    )


def run(arguments: Namespace) -> None:
    """Trigger a transition."""
    with discovery.command_node() as node:
        lifecycle = Lifecycle(node, arguments.node_name, arguments.spin_time)
        available = [description.transition for description in lifecycle.transitions()]
        chosen = [t for t in available if arguments.transition in (t.label, str(t.id))]
        if not chosen:
            lines = (f'\n- {t.label} [{t.id}]' for t in available)
            raise CliError(f'Unknown transition requested, available ones are:{"".join(lines)}')
        if not lifecycle.change(chosen[0]):
            raise CliError('Transitioning failed')
    print('Transitioning successful')
