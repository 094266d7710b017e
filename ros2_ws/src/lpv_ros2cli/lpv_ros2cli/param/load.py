"""``ros2 param load``."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from typing import Any

from lpv_ros2cli.command_line.yaml_text import read_yaml
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess, fitted, value_from_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)
    parser.add_argument('parameter_file', help='parameter file (YAML)')
    parser.add_argument(
        '--no-use-wildcard',
        action='store_true',
        help='leave out what the file sets for all nodes (/**)',
    )


def run(arguments: Namespace) -> int:
    """Set what a parameter file says of a node; 1 where the node refused any of it."""
    data = read_yaml(arguments.parameter_file, 'the parameter file')
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        values = _values_for(access.name, data, not arguments.no_use_wildcard)
        kinds = {
            d.name: d.type
            for d in access.describe([name for name in access.names() if name in values])
        }
        results = access.set(
            {
                name: fitted(value_from_text(_text(value)), kinds.get(name))
                for name, value in values.items()
            }
        )
    for name, result in results.items():
        reason = f': {result.reason}' if result.reason else ''
        print(f'Set parameter {name} {"successful" if result.successful else "failed"}{reason}')
    return 0 if all(result.successful for result in results.values()) else 1


def _values_for(node_name: str, data: object, wildcard: bool) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise CliError('the parameter file must hold a mapping of node names')
    values: dict[str, Any] = {}
    for key, section in data.items():
        names_it = str(key) in (node_name, node_name.lstrip('/'))
        if not (names_it or (wildcard and key == '/**')):
            continue
        parameters = section.get('ros__parameters') if isinstance(section, dict) else None
        if not isinstance(parameters, dict):
            raise CliError(f"the parameter file has no mapping 'ros__parameters' below '{key}'")
        values.update(_flat(parameters, ''))
    if not values:
        raise CliError(f'the parameter file says nothing of node {node_name}')
    return values


def _flat(level: dict[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in level.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value


def _text(value: object) -> str:
    """YAML of a value, from which rclpy makes a parameter of the right type."""
    import yaml

    return yaml.safe_dump(value, default_flow_style=True).removesuffix('\n...\n').strip()
