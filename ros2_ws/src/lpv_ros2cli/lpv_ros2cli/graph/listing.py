"""What the verbs about one node, and those that list nodes, topics and services, share."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery


def add_node_name(parser: ArgumentParser, **options: Any) -> None:
    """Declare the arguments of verbs about one node."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.nodes, 'node_name', **{'help': 'node', **options})
    parser.add_argument('--include-hidden-nodes', action='store_true')


def add_node_arguments(parser: ArgumentParser) -> None:
    """Declare the arguments of a list of nodes."""
    discovery.add_arguments(parser)
    parser.add_argument(
        '-a', '--all', action='store_true', help='also nodes whose name begins with an underscore'
    )
    parser.add_argument(
        '-c', '--count-nodes', action='store_true', help='only show the number of nodes'
    )


def add_name_arguments(parser: ArgumentParser, what: str) -> None:
    """Declare the arguments of a list of topics or services."""
    discovery.add_arguments(parser)
    parser.add_argument('-t', '--show-types', action='store_true', help='show the types')
    parser.add_argument(
        '-c', f'--count-{what}', action='store_true', help=f'only show the number of {what}'
    )
    parser.add_argument(
        f'--include-hidden-{what}',
        action='store_true',
        help='also names with a part that begins with an underscore',
    )


def print_names(entries: Sequence[tuple[str, Sequence[str]]], arguments: Namespace) -> None:
    """Print topics or services, given by name and types."""
    for name, types in entries:
        print(f'{name} [{", ".join(types)}]' if arguments.show_types else name)
