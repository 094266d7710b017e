"""Tab completion: hooks argcomplete in, and says what packages, topics and nodes there are."""

import os
import shlex
from argparse import Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node


def complete() -> None:
    """Answer a request of the shell for completions and leave; otherwise do nothing."""
    if '_ARGCOMPLETE' not in os.environ:
        return
    import argcomplete

    from lpv_core.support.discovery import stay_local
    from lpv_ros2cli.command_line.parsing import build_parser, chosen
    from lpv_ros2cli.errors import CliError

    stay_local()
    try:
        parser = build_parser(*chosen(_words()))
    except CliError:
        parser = build_parser()
    argcomplete.autocomplete(parser, exclude=['-h', '--help'])


def add_argument(
    parser: Any, completer: Callable[..., list[str]], *names: str, **options: Any
) -> None:
    """Declare an argument of which the shell completes the values."""
    parser.add_argument(*names, **options).completer = completer


def _words() -> list[str]:
    """Finished words of the line that is being typed, without the program."""
    line = os.environ.get('COMP_LINE', '')[: int(os.environ.get('COMP_POINT', '0'))]
    try:
        words = shlex.split(line)
    except ValueError:  # an open quote
        words = line.split()
    return words[1:] if line.endswith(' ') else words[1:-1]


def packages(**_: object) -> list[str]:
    """Completer: names of packages."""
    from lpv_ros2cli import packages as index

    return index.names()


def executables(parsed_args: Namespace, **_: object) -> list[str]:
    """Completer: programs of the package that was typed."""
    from lpv_ros2cli import packages as index

    return [path.name for path in index.executables(parsed_args.package)]


def launch_words(parsed_args: Namespace, **_: object) -> list[str]:
    """Completer: launch files of the package that was typed, then the file's arguments."""
    from lpv_ros2cli.launch.arguments import declared
    from lpv_ros2cli.launch.context import Context
    from lpv_ros2cli.launch.files import find_launch_file, launch_files_of

    names = [path.name for path in launch_files_of(parsed_args.package_or_file)]
    chosen = [word for word in parsed_args.rest or () if word in names]
    if not chosen:
        return names
    path = find_launch_file(parsed_args.package_or_file, chosen[0])
    return [f'{name}:=' for name in declared(path, Context({}))]


def topics(**_: object) -> list[str]:
    """Completer: topics of the running graph."""
    return _from_graph(lambda node: [name for name, _ in node.get_topic_names_and_types()])


def services(**_: object) -> list[str]:
    """Completer: services of the running graph."""
    return _from_graph(lambda node: [name for name, _ in node.get_service_names_and_types()])


def nodes(**_: object) -> list[str]:
    """Completer: nodes of the running graph."""
    from lpv_ros2cli.graph.names import node_names

    return _from_graph(lambda node: node_names(node, hidden=False))


def interface_types(kind: str) -> Callable[..., Any]:
    """Make a completer of interface types."""

    def types(**_: object) -> list[str]:
        from lpv_ros2cli.message.types import installed

        return [name for name in installed() if f'/{kind}/' in name]

    return types


def parameters(parsed_args: Namespace, **_: object) -> list[str]:
    """Completer: parameters of the node that was typed."""
    from lpv_ros2cli.errors import CliError
    from lpv_ros2cli.graph.discovery import command_node
    from lpv_ros2cli.param.client import ParameterAccess

    try:
        with command_node() as node:
            return ParameterAccess(node, parsed_args.node_name).names()
    except CliError:
        return []


def _from_graph(ask: Callable[['Node'], list[str]]) -> list[str]:
    from lpv_ros2cli.graph.discovery import command_node, settle

    with command_node() as node:
        settle(node)
        return [name for name in ask(node) if '/_' not in name]
