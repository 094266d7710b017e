"""``ros2 param get``."""

from lpv_ros2cli import completion, discovery
from lpv_ros2cli.param.client import ParameterAccess

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


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    parser.add_argument('node_name', help='node').completer = completion.nodes
    parser.add_argument('parameter_name', help='parameter').completer = completion.parameters
    parser.add_argument('--include-hidden-nodes', action='store_true')
    parser.add_argument('--hide-type', action='store_true', help='only show the value')


def run(arguments):
    """Print the value of a parameter."""
    from rclpy.parameter import parameter_value_to_python

    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        found = access.value(arguments.parameter_name)
    if not found.type:
        print('Parameter not set.')
        return 1
    value = parameter_value_to_python(found)
    value = value.tolist() if hasattr(value, 'tolist') else value
    print(value if arguments.hide_type else f'{_LABELS[found.type]} {value}')
    return 0
