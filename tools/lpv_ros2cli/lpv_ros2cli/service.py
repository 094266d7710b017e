"""``ros2 service``: list, call."""

import argparse
import math

from lpv_ros2cli import graph, messages
from lpv_ros2cli.command_line import CliError, takes


@takes('-t', '--show-types', action='store_true', help='show the types')
def run_list(arguments: argparse.Namespace) -> None:
    """Print the services of the graph."""
    with graph.command_node() as node:
        graph.settle(node)
        graph.print_names(node.get_service_names_and_types(), arguments.show_types)


@takes('service_name', 'service_type')
@takes('values', nargs='?', default='{}', help='fields of the request in YAML')
def run_call(arguments: argparse.Namespace) -> None:
    """Call a service, waiting until it is there, and print its response."""
    service = messages.load(arguments.service_type, 'srv')
    request = messages.from_yaml(service.Request, arguments.values)
    name = graph.absolute(arguments.service_name)
    with graph.command_node() as node:
        while not (
            types := graph.find(node, lambda: dict(node.get_service_names_and_types()).get(name))
        ):
            print('waiting for service to become available...', flush=True)
        if messages.load(types[0], 'srv') is not service:
            raise CliError(f"service '{name}' is of type {types[0]}")
        print(f'requester: making request: {request!r}\n', flush=True)
        response = graph.call(node, service, name, request, math.inf)
        print(f'response:\n{response!r}\n', flush=True)
