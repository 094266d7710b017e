"""Names of the graph: absolute forms, and lists without what is hidden."""

from typing import TYPE_CHECKING, Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph.discovery import find

if TYPE_CHECKING:
    from rclpy.node import Node


def absolute(name: str) -> str:
    """Absolute form of a topic or service name."""
    from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
    from rclpy.expand_topic_name import expand_topic_name
    from rclpy.validate_full_topic_name import validate_full_topic_name

    try:
        expanded = expand_topic_name(name, 'ros2', '/')
        validate_full_topic_name(expanded)
    except (InvalidTopicNameException, InvalidServiceNameException, ValueError) as error:
        raise CliError(f'{name!r} is no valid name: {str(error).splitlines()[0]}') from error
    return expanded


def absolute_node(name: str) -> str:
    """Absolute form of a node name."""
    return name if name.startswith('/') else f'/{name}'


def node_names(node: 'Node', hidden: bool) -> list[str]:
    """Nodes of the graph."""
    return sorted(
        f'{namespace.rstrip("/")}/{name}'
        for name, namespace in node.get_node_names_and_namespaces()
        if hidden or not name.startswith('_')
    )


def find_node(node: 'Node', name: str, spin_time: float | None = None) -> str:
    """Wait until a node is in the graph."""
    full = absolute_node(name)
    if not find(node, lambda: full in node_names(node, hidden=True), spin_time):
        raise CliError(f'Node not found: {full}{_known(node_names(node, hidden=False))}')
    return full


def find_topic(node: 'Node', name: str, spin_time: float | None = None) -> tuple[str, list[str]]:
    """Wait until a topic is in the graph."""
    full = absolute(name)
    types = find(node, lambda: dict(node.get_topic_names_and_types()).get(full), spin_time)
    if not types:
        raise CliError(f"Unknown topic '{full}'")
    return full, types


def without_hidden(names_and_types: list[tuple[Any, ...]], hidden: bool) -> list[tuple[Any, ...]]:
    """Names and types, sorted, without those of which a part begins with an underscore."""
    return sorted((name, types) for name, types in names_and_types if hidden or '/_' not in name)


def _known(names: list[str]) -> str:
    return f' (there are: {", ".join(dict.fromkeys(names))})' if names else ' (there are no nodes)'
