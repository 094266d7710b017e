"""``ros2 param get``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess, plain_value

_LABELS = (
    '',
    'Boolean value is:',
    'Integer value is:',
    'Double value is:',
    'String value is:',
    'Byte values are:',
    'Boolean values are:',
    'Integer values are:',
    'Double values are:',
    'String values are:',
)


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    completion.add_argument(parser, completion.parameters, 'parameter_name', help='parameter')
    parser.add_argument('--hide-type', action='store_true', help='only show the value')


def run(arguments: Namespace) -> int:
    """Print the value of a parameter."""
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        found = access.value(arguments.parameter_name)
    if not found.type:
        print('Parameter not set.')
        return 1
    value = plain_value(found)
    print(value if arguments.hide_type else f'{_LABELS[found.type]} {value}')
    return 0
