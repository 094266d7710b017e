"""``ros2 param set``."""

import sys
from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess, fitted, value_from_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    completion.add_argument(parser, completion.parameters, 'parameter_name', help='parameter')
    parser.add_argument('value', help='value in YAML')


def run(arguments: Namespace) -> None:
    """Set a parameter; a node that refuses is no error of the command, as upstream."""
    name = arguments.parameter_name
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        value = fitted(value_from_text(arguments.value), access.lookup(name).type)
        result = access.set({name: value})[name]
    reason = f': {result.reason}' if result.reason else ''
    if result.successful:
        print(f'Set parameter successful{reason}')
    else:
        print(f'Setting parameter failed{reason}', file=sys.stderr)
