"""``ros2 service info``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.lookup import SERVICES


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.services, 'service_name', help='service')
    parser.add_argument('--include-hidden-services', action='store_true')


def run(arguments: Namespace) -> None:
    """Print type, clients and servers of a service."""
    name, hidden = arguments.service_name, arguments.include_hidden_services
    with discovery.command_node() as node:
        types = SERVICES.find(node, name, hidden, arguments.spin_time)
        if not types:
            raise CliError(f"Unknown service '{name}'")
        discovery.settle(node, arguments.spin_time)
        clients, servers = node.count_clients(name), node.count_services(name)
    print(f'Type: {types[0] if len(types) == 1 else types}')
    print(f'Clients count: {clients}\nServices count: {servers}')
