"""``ros2 param describe``."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess, type_name

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    completion.add_argument(
        parser, completion.parameters, 'parameter_names', nargs='+', help='parameters'
    )


def run(arguments: Namespace) -> None:
    """Print descriptions and constraints of parameters."""
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        declared = set(access.names())
        missing = [name for name in arguments.parameter_names if name not in declared]
        if missing:
            raise CliError(
                f"node {access.name} declares no parameter '{missing[0]}'; "
                f'ros2 param list {access.name} shows what it has'
            )
        descriptors = access.describe(arguments.parameter_names)
    for descriptor in descriptors:
        print('\n'.join(_lines(descriptor)))


def _lines(descriptor: 'ParameterDescriptor') -> Iterator[str]:
    yield f'Parameter name: {descriptor.name}'
    yield f'  Type: {type_name(descriptor.type)}'
    if descriptor.description:
        yield f'  Description: {descriptor.description}'
    yield '  Constraints:'
    if descriptor.read_only:
        yield '    Read only: true'
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        yield f'    Min value: {limits.from_value}'
        yield f'    Max value: {limits.to_value}'
        if limits.step:
            yield f'    Step: {limits.step}'
    if descriptor.additional_constraints:
        yield f'    Additional constraints: {descriptor.additional_constraints}'
