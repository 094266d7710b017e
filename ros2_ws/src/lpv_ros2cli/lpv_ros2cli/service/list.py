"""``ros2 service list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.graph.names import without_hidden


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_name_arguments(parser, 'services')


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
    listing.print_names(services, arguments)
