"""``ros2 param set``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.command_line.yaml_text import parse_yaml
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.param.client import ParameterAccess, fitted


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.nodes, 'node_name', help='node')
    completion.add_argument(parser, completion.parameters, 'parameter_name', help='parameter')
    parser.add_argument('value', help='value in YAML')
    parser.add_argument('--include-hidden-nodes', action='store_true')


def run(arguments: Namespace) -> None:
    """Set a parameter; the node may refuse, with a reason."""
    from rclpy.parameter import get_parameter_value

    parse_yaml(arguments.value, 'the value')
    value = get_parameter_value(arguments.value)
    name = arguments.parameter_name
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        value = fitted(value, access.value(name).type)
        result = access.set({name: value})[name]
    reason = f': {result.reason}' if result.reason else ''
    if not result.successful:
        raise CliError(f'Setting parameter failed{reason}')
    print(f'Set parameter successful{reason}')
