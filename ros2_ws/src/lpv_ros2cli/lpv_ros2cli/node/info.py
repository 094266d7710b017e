"""``ros2 node info``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import absolute_node, find_node, without_hidden


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.nodes, 'node_name', help='node')
    parser.add_argument(
        '--include-hidden', action='store_true', help='also hidden topics and services'
    )


def run(arguments: Namespace) -> None:
    """Print what a node publishes, subscribes to, serves and calls."""
    with discovery.command_node() as node:
        full = find_node(node, arguments.node_name, arguments.spin_time)
        discovery.settle(node, arguments.spin_time)
        namespace, _, name = absolute_node(full).rpartition('/')
        print(full)
        for heading, ask in (
            ('Subscribers', node.get_subscriber_names_and_types_by_node),
            ('Publishers', node.get_publisher_names_and_types_by_node),
            ('Service Servers', node.get_service_names_and_types_by_node),
            ('Service Clients', node.get_client_names_and_types_by_node),
        ):
            print(f'  {heading}:')
            for topic, types in without_hidden(
                ask(name, namespace or '/'), arguments.include_hidden
            ):
                print(f'    {topic}: {", ".join(types)}')
        # Actions are hidden topics and services; this software has none.
        print('\n  Action Servers:\n\n  Action Clients:\n')
