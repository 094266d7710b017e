"""``ros2 service call``."""

import sys
import time
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.calling import call, ready_client
from lpv_ros2cli.graph.names import absolute
from lpv_ros2cli.message.from_text import message_from_text
from lpv_ros2cli.message.types import full_type, load

if TYPE_CHECKING:
    from rclpy.node import Node


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(parser, completion.services, 'service_name', help='service')
    completion.add_argument(
        parser,
        completion.interface_types('srv'),
        'service_type',
        help='its type, e.g. std_srvs/srv/Trigger',
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument('values', nargs='?', default='{}', help='fields of the request in YAML')
    group.add_argument('--stdin', action='store_true', help='read the fields from stdin')
    parser.add_argument('-r', '--rate', type=float, metavar='N', help='repeat the call, [Hz]')


def run(arguments: Namespace) -> None:
    """Call a service and print its answer."""
    if arguments.rate is not None and not arguments.rate > 0.0:
        raise CliError('--rate must be greater than zero')
    service_class = load(arguments.service_type, 'srv')
    text = sys.stdin.read() if arguments.stdin else arguments.values
    request = message_from_text(service_class.Request, text)
    with discovery.command_node() as node:
        name = absolute(arguments.service_name)
        _check_type(node, name, full_type(arguments.service_type, 'srv'))
        client = ready_client(node, service_class, name)
        while True:
            start = time.monotonic()
            print(f'requester: making request: {request!r}\n', flush=True)
            print(f'response:\n{call(node, client, request, None)!r}\n', flush=True)
            if arguments.rate is None:
                return
            time.sleep(max(0.0, start + 1.0 / arguments.rate - time.monotonic()))


def _check_type(node: 'Node', name: str, expected: str) -> None:
    """Wait for the service; a client of another type would wait in vain."""

    def types_there() -> list[str] | None:
        return dict(node.get_service_names_and_types()).get(name)

    types = discovery.find(node, types_there, 0.5)
    if not types:
        print('waiting for service to become available...', flush=True)
        while not (types := types_there()):
            time.sleep(0.05)
    if expected not in types:
        raise CliError(f"service '{name}' is of type {', '.join(types)}, not {expected}")
