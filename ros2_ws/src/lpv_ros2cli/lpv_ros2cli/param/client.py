"""Access to another node's parameters through its services."""

import array
from typing import TYPE_CHECKING, Any

import yaml

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph.calling import call, ready_client
from lpv_ros2cli.graph.names import find_node

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor, ParameterValue, SetParametersResult
    from rclpy.node import Node

_TYPE_NAMES = (
    'not set',
    'boolean',
    'integer',
    'double',
    'string',
    'byte array',
    'boolean array',
    'integer array',
    'double array',
    'string array',
)
"""Names by rcl_interfaces/ParameterType."""


class ParameterAccess:
    """Parameters of one node."""

    def __init__(self, node: 'Node', name: str, spin_time: float | None = None) -> None:
        self._node = node
        self.name = find_node(node, name, spin_time)

    def _call(self, service: Any, service_name: str, **fields: object) -> Any:
        client = ready_client(self._node, service, f'{self.name}/{service_name}')
        try:
            return call(self._node, client, service.Request(**fields))
        finally:
            self._node.destroy_client(client)

    def names(self) -> list[str]:
        """Names of the declared parameters, sorted."""
        from rcl_interfaces.srv import ListParameters

        return sorted(self._call(ListParameters, 'list_parameters').result.names)

    def values(self, names: list[str]) -> list['ParameterValue']:
        """Values (rcl_interfaces/ParameterValue) of parameters, in the order of the names."""
        from rcl_interfaces.srv import GetParameters

        values = self._call(GetParameters, 'get_parameters', names=list(names)).values
        # A node that lacks one of the parameters answers with fewer values, or none.
        return values if len(values) == len(names) else [self.lookup(name) for name in names]

    def lookup(self, name: str) -> 'ParameterValue':
        """Value of one parameter, without type if the node does not declare it."""
        from rcl_interfaces.msg import ParameterValue
        from rcl_interfaces.srv import GetParameters

        found = self._call(GetParameters, 'get_parameters', names=[name]).values
        return found[0] if found else ParameterValue()

    def value(self, name: str) -> 'ParameterValue':
        """Value of one declared parameter."""
        from rcl_interfaces.msg import ParameterType

        found = self.lookup(name)
        if found.type == ParameterType.PARAMETER_NOT_SET and name not in self.names():
            raise CliError(
                f"Parameter not set: node {self.name} declares no '{name}'; "
                f'ros2 param list {self.name} shows what it has'
            )
        return found

    def describe(self, names: list[str]) -> list['ParameterDescriptor']:
        """Descriptors (rcl_interfaces/ParameterDescriptor) of declared parameters."""
        from rcl_interfaces.srv import DescribeParameters

        return self._call(DescribeParameters, 'describe_parameters', names=list(names)).descriptors

    def set(self, values: dict[str, 'ParameterValue']) -> dict[str, 'SetParametersResult']:
        """Set parameters, one by one."""
        from rcl_interfaces.msg import Parameter
        from rcl_interfaces.srv import SetParameters

        wanted = [Parameter(name=name, value=value) for name, value in values.items()]
        results = self._call(SetParameters, 'set_parameters', parameters=wanted).results
        if len(results) != len(wanted):
            raise CliError(f'node {self.name} gave no answer for each of the parameters')
        return dict(zip(values, results))


def value_from_text(text: str) -> 'ParameterValue':
    """Value of a parameter from YAML; what is no YAML is a text, as upstream."""
    from rclpy.parameter import get_parameter_value

    try:
        return get_parameter_value(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CliError(f'the value is not valid YAML: {" ".join(str(error).split())}') from error


def plain_value(value: 'ParameterValue') -> Any:
    """Value of a parameter as a scalar or a list."""
    from rclpy.parameter import parameter_value_to_python

    plain: Any = parameter_value_to_python(value)
    return list(plain) if isinstance(plain, (tuple, array.array)) else plain


def type_name(kind: int) -> str:
    """Name of a parameter type."""
    return _TYPE_NAMES[kind] if kind < len(_TYPE_NAMES) else f'type {kind}'


def fitted(value: 'ParameterValue', kind: int | None) -> 'ParameterValue':
    """A whole number as double where the parameter is one: ``1`` is then as good as ``1.0``."""
    from rcl_interfaces.msg import ParameterType, ParameterValue

    if (value.type, kind) == (ParameterType.PARAMETER_INTEGER, ParameterType.PARAMETER_DOUBLE):
        return ParameterValue(type=kind, double_value=float(value.integer_value))
    if (value.type, kind) == (
        ParameterType.PARAMETER_INTEGER_ARRAY,
        ParameterType.PARAMETER_DOUBLE_ARRAY,
    ):
        return ParameterValue(
            type=kind, double_array_value=[float(v) for v in value.integer_array_value]
        )
    return value
