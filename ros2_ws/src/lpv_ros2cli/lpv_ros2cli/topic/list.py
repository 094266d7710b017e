"""``ros2 topic list``."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import Any

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.graph.names import without_hidden


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_name_arguments(parser, 'topics')
    parser.add_argument(
        '-v', '--verbose', action='store_true', help='show publishers and subscribers'
    )


def run(arguments: Namespace) -> None:
    """Print the topics of the graph."""
    with discovery.command_node() as node:
        discovery.settle(node, arguments.spin_time)
        topics = without_hidden(node.get_topic_names_and_types(), arguments.include_hidden_topics)
        if arguments.count_topics:
            print(len(topics))
        elif arguments.verbose:
            _print_side(topics, 'Published', 'publisher', node.count_publishers)
            _print_side(topics, 'Subscribed', 'subscriber', node.count_subscribers)
        else:
            listing.print_names(topics, arguments)


def _print_side(
    topics: list[tuple[Any, ...]], heading: str, who: str, count: Callable[[str], int]
) -> None:
    print(f'{heading} topics:')
    for name, types in topics:
        number = count(name)
        if number:
            print(f' * {name} [{", ".join(types)}] {number} {who}{"s" if number > 1 else ""}')
    print()
