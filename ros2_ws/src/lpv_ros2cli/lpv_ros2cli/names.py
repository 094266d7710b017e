"""Names of the graph: absolute forms, and lists without what is hidden."""

from typing import Any

from lpv_ros2cli.discovery import find
from lpv_ros2cli.errors import CliError


def absolute(name: str) -> str:
    """Absolute form of a topic or service name.

    Parameters
    ----------
    name : str
        As typed; relative ones are in the root namespace, as the node of a command is.

    Returns
    -------
    str
        Absolute name.

    Raises
    ------
    CliError
        If it is no valid name.
    """
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
    """Absolute form of a node name.

    Parameters
    ----------
    name : str
        As typed.

    Returns
    -------
    str
        Absolute name.
    """
    return name if name.startswith('/') else f'/{name}'


def node_names(node, hidden: bool) -> list[str]:
    """Nodes of the graph.

    Parameters
    ----------
    node : rclpy.node.Node
        Looks.
    hidden : bool
        Also those whose name begins with an underscore.

    Returns
    -------
    list of str
        Absolute names, sorted; a name that two nodes have occurs twice.
    """
    return sorted(
        f'{namespace.rstrip("/")}/{name}'
        for name, namespace in node.get_node_names_and_namespaces()
        if hidden or not name.startswith('_')
    )


def find_node(node, name: str, spin_time: float | None = None) -> str:
    """Wait until a node is in the graph.

    Parameters
    ----------
    node : rclpy.node.Node
        Looks.
    name : str
        Node name as typed.
    spin_time : float, optional
        Longest wait [s].

    Returns
    -------
    str
        Absolute name.

    Raises
    ------
    CliError
        If it does not appear.
    """
    full = absolute_node(name)
    if not find(node, lambda: full in node_names(node, hidden=True), spin_time):
        raise CliError(f'Node not found: {full}{_known(node_names(node, hidden=False))}')
    return full


def find_topic(node, name: str, spin_time: float | None = None) -> tuple[str, list[str]]:
    """Wait until a topic is in the graph.

    Parameters
    ----------
    node : rclpy.node.Node
        Looks.
    name : str
        Topic as typed.
    spin_time : float, optional
        Longest wait [s].

    Returns
    -------
    name : str
        Absolute name.
    types : list of str
        Its types.

    Raises
    ------
    CliError
        If it does not appear.
    """
    full = absolute(name)
    types = find(node, lambda: dict(node.get_topic_names_and_types()).get(full), spin_time)
    if not types:
        raise CliError(f"Unknown topic '{full}': nobody publishes or subscribes to it")
    return full, types


def without_hidden(names_and_types: list[tuple[Any, ...]], hidden: bool) -> list[tuple[Any, ...]]:
    """Names and types, sorted, without those of which a part begins with an underscore.

    Parameters
    ----------
    names_and_types : list of tuple
        Of a graph query.
    hidden : bool
        Keep the hidden ones.

    Returns
    -------
    list of tuple
        Kept ones.
    """
    return sorted((name, types) for name, types in names_and_types if hidden or '/_' not in name)


def _known(names):
    return f' (there are: {", ".join(dict.fromkeys(names))})' if names else ' (there are no nodes)'
