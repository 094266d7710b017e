"""``ros2 param``: list, describe, get, set."""

import argparse
import array
import sys
from typing import Any

from lpv_ros2cli import graph, messages
from lpv_ros2cli.command_line import CliError, takes

_KINDS = ('Boolean', 'Integer', 'Double', 'String')
"""Of values by rcl_interfaces/ParameterType from 1; byte arrays are 5, arrays of these follow."""


@takes('node_name')
def run_list(arguments: argparse.Namespace) -> None:
    """Print the parameters of a node."""
    from rcl_interfaces.srv import ListParameters

    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        found = graph.call(node, ListParameters, f'{name}/list_parameters')
    for parameter in sorted(found.result.names):
        print(f'  {parameter}')


@takes('node_name', 'parameter_name')
def run_describe(arguments: argparse.Namespace) -> None:
    """Print type, meaning and range of a parameter."""
    from rcl_interfaces.srv import DescribeParameters

    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        request = DescribeParameters.Request(names=[arguments.parameter_name])
        found = graph.call(node, DescribeParameters, f'{name}/describe_parameters', request)
    # Of an unknown one, nodes answer nothing, or a description without a type.
    if not found.descriptors or not found.descriptors[0].type:
        raise CliError(f"Parameter not set: {name} has no '{arguments.parameter_name}'")
    one = found.descriptors[0]
    print(f'Parameter name: {one.name}\n  Type: {_kind(one.type).lower()}')
    print(f'  Description: {one.description}\n  Constraints:')
    if one.read_only:
        print('    Read only: true')
    for limits in (*one.integer_range, *one.floating_point_range):
        print(f'    Min value: {limits.from_value}\n    Max value: {limits.to_value}')
    if one.additional_constraints:
        print(f'    Additional constraints: {one.additional_constraints}')


@takes('node_name', 'parameter_name')
def run_get(arguments: argparse.Namespace) -> None:
    """Print the value of a parameter."""
    from rclpy.parameter import parameter_value_to_python

    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        found = _value(node, name, arguments.parameter_name)
    if found is None or not found.type:
        raise CliError(f"Parameter not set: {name} has no value of '{arguments.parameter_name}'")
    value: Any = parameter_value_to_python(found)
    value = list(value) if isinstance(value, (tuple, array.array)) else value
    print(_kind(found.type), 'values are:' if found.type > len(_KINDS) else 'value is:', value)


@takes('node_name', 'parameter_name', 'value')
def run_set(arguments: argparse.Namespace) -> None:
    """Set a parameter."""
    from rcl_interfaces.msg import Parameter, ParameterType
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import get_parameter_value

    messages.parse_yaml(arguments.value, 'the value')
    value = get_parameter_value(arguments.value)
    with graph.command_node() as node:
        name = graph.find_node(node, arguments.node_name)
        present = _value(node, name, arguments.parameter_name)
        # 1 is as good as 1.0.
        double, integer = ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER
        if present is not None and (present.type, value.type) == (double, integer):
            value.type, value.double_value = double, float(value.integer_value)
        wanted = Parameter(name=arguments.parameter_name, value=value)
        request = SetParameters.Request(parameters=[wanted])
        answer = graph.call(node, SetParameters, f'{name}/set_parameters', request)
    for result in answer.results:  # a node that refuses is no error here, as in ros2cli
        text = 'Set parameter successful' if result.successful else 'Setting parameter failed'
        reason = f': {result.reason}' if result.reason else ''
        print(f'{text}{reason}', file=sys.stdout if result.successful else sys.stderr)


def _kind(number: int) -> str:
    """Name of a rcl_interfaces/ParameterType, of arrays that of their values."""
    return (*_KINDS, 'Byte', *_KINDS)[number - 1]


def _value(node: Any, name: str, parameter: str) -> Any:
    from rcl_interfaces.srv import GetParameters

    request = GetParameters.Request(names=[parameter])
    found = graph.call(node, GetParameters, f'{name}/get_parameters', request).values
    return found[0] if found else None
