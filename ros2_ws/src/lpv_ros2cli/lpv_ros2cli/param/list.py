"""``ros2 param list``."""

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.graph.names import node_names
from lpv_ros2cli.param.client import ParameterAccess, type_name

if TYPE_CHECKING:
    from rclpy.node import Node


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser, nargs='?', help='node; otherwise all')
    parser.add_argument(
        '--param-prefixes',
        nargs='+',
        default=[],
        metavar='PREFIX',
        help='only parameters below these prefixes',
    )
    parser.add_argument('--param-type', action='store_true', help='show the types')


def run(arguments: Namespace) -> int:
    """Print the parameters of one node or of all."""
    with discovery.command_node() as node:
        if arguments.node_name:
            _print(node, arguments, arguments.node_name)
            return 0
        discovery.settle(node, arguments.spin_time)
        code = 0
        for name in dict.fromkeys(node_names(node, arguments.include_hidden_nodes)):
            print(f'{name}:')
            try:
                _print(node, arguments, name)
            except CliError as error:  # a node that hangs must not hide the others
                print(f'  ({error})')
                code = 1
        return code


def _print(node: 'Node', arguments: Namespace, name: str) -> None:
    access = ParameterAccess(node, name, arguments.spin_time)
    names = [
        parameter
        for parameter in access.names()
        if not arguments.param_prefixes
        or any(
            f'{parameter}.'.startswith(f'{prefix.rstrip(".")}.')
            for prefix in arguments.param_prefixes
        )
    ]
    types = {d.name: d.type for d in access.describe(names)} if arguments.param_type else {}
    for parameter in names:
        kind = f' (type: {type_name(types[parameter])})' if parameter in types else ''
        print(f'  {parameter}{kind}')
