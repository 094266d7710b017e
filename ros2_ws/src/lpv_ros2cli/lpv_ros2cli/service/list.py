"""``ros2 service list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import without_hidden


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    parser.add_argument('-t', '--show-types', action='store_true', help='show the types')
    parser.add_argument(
        '-c', '--count-services', action='store_true', help='only show the number of services'
    )
    parser.add_argument(
        '--include-hidden-services',
        action='store_true',
        help='also names with a part that begins with an underscore',
    )


def run(arguments: Namespace) -> None:
    """Print the services of the graph."""
    with discovery.command_node() as node:
        discovery.settle(node, arguments.spin_time)
        services = without_hidden(
            node.get_service_names_and_types(), arguments.include_hidden_services
        )
    if arguments.count_services:
        print(len(services))
        return
    for name, types in services:
        print(f'{name} [{", ".join(types)}]' if arguments.show_types else name)
