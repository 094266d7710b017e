"""Verbs that topics and services have alike: type and find."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import absolute, without_hidden

if TYPE_CHECKING:
    from rclpy.node import Node

NamesAndTypes = list[tuple[str, list[str]]]


@dataclass(frozen=True)
class Kind:
    """Topics or services."""

    noun: str  # topic or service
    interface: str  # msg or srv
    example: str  # a type
    query: Callable[['Node'], NamesAndTypes]
    names: Callable[..., list[str]]  # completer

    def find(
        self, node: 'Node', typed: str, hidden: bool, spin_time: float | None
    ) -> list[str] | None:
        """Types of a name, as soon as it is in the graph; None or empty if it is not."""
        name = absolute(typed)
        if '/_' in name and not hidden:
            return None
        return discovery.find(node, lambda: dict(self.query(node)).get(name), spin_time)


TOPICS = Kind(
    'topic',
    'msg',
    'std_msgs/msg/String',
    lambda node: node.get_topic_names_and_types(),
    completion.topics,
)
SERVICES = Kind(
    'service',
    'srv',
    'std_srvs/srv/Trigger',
    lambda node: node.get_service_names_and_types(),
    completion.services,
)


@dataclass(frozen=True)
class TypeVerb:
    """``type``: prints the types of a name; exit code 1 if it is not in the graph."""

    kind: Kind

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Declare the verb's arguments."""
        noun = self.kind.noun
        discovery.add_arguments(parser)
        completion.add_argument(parser, self.kind.names, 'name', metavar=f'{noun}_name', help=noun)
        parser.add_argument(f'--include-hidden-{noun}s', action='store_true', dest='hidden')

    def run(self, arguments: Namespace) -> int:
        """Print the types."""
        with discovery.command_node() as node:
            types = self.kind.find(node, arguments.name, arguments.hidden, arguments.spin_time)
        for name in types or ():
            print(name)
        return 0 if types else 1


@dataclass(frozen=True)
class FindVerb:
    """``find``: prints the names that have a type."""

    kind: Kind

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Declare the verb's arguments."""
        noun, types = self.kind.noun, completion.interface_types(self.kind.interface)
        discovery.add_arguments(parser)
        completion.add_argument(
            parser, types, 'type', metavar=f'{noun}_type', help=f'type, e.g. {self.kind.example}'
        )
        parser.add_argument(
            '-c',
            f'--count-{noun}s',
            action='store_true',
            dest='count',
            help=f'only show the number of {noun}s',
        )
        parser.add_argument(f'--include-hidden-{noun}s', action='store_true', dest='hidden')

    def run(self, arguments: Namespace) -> None:
        """Print the names."""
        with discovery.command_node() as node:
            discovery.settle(node, arguments.spin_time)
            all_names = without_hidden(self.kind.query(node), arguments.hidden)
        names = [name for name, types in all_names if arguments.type in types]
        if arguments.count:
            print(len(names))
            return
        for name in names:
            print(name)
