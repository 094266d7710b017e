"""``ros2 service call``."""

import sys
import time

from lpv_ros2cli import completion, discovery
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.fill import message_from_text
from lpv_ros2cli.interfaces import full_type, load
from lpv_ros2cli.names import absolute
from lpv_ros2cli.service.calling import call, ready_client


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('service_name', help='service').completer = completion.services
    parser.add_argument(
        'service_type', help='its type, e.g. std_srvs/srv/Trigger'
    ).completer = completion.interface_types('srv')
    group = parser.add_mutually_exclusive_group()
    group.add_argument('values', nargs='?', default='{}', help='fields of the request in YAML')
    group.add_argument('--stdin', action='store_true', help='read the fields from stdin')
    parser.add_argument('-r', '--rate', type=float, metavar='N', help='repeat the call, [Hz]')


def run(arguments) -> None:
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


def _check_type(node, name, expected) -> None:
    """A client of another type would wait for ever."""

    def types_there():
        return dict(node.get_service_names_and_types()).get(name)

    types = discovery.find(node, types_there, 0.5)
    if not types:
        print('waiting for service to become available...', flush=True)
        types = discovery.find(node, types_there)
    if not types:
        raise CliError(f"Unknown service '{name}': nobody serves it")
    if expected not in types:
        raise CliError(f"service '{name}' is of type {', '.join(types)}, not {expected}")
