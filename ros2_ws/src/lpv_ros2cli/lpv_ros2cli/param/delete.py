"""``ros2 param delete``."""

import sys
from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    completion.add_argument(parser, completion.parameters, 'parameter_name', help='parameter')


def run(arguments: Namespace) -> None:
    """Delete a parameter; a node that refuses is no error of the command, as upstream."""
    from rcl_interfaces.msg import ParameterValue

    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        (result,) = access.set({arguments.parameter_name: ParameterValue()}).values()
    reason = f': {result.reason}' if result.reason else ''
    if result.successful:
        print(f'Deleted parameter successfully{reason}')
    else:
        print(f'Deleting parameter failed{reason}', file=sys.stderr)
