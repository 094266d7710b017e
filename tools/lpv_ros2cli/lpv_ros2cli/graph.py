"""The running graph: a node for the time of one command, names, calls of services.

There is no daemon that knows the graph already.  Finding all participants takes 0.1 s or, where an
announcement was missed, the 3 s until the next one: so the wait ends when as many participants were
found as have ports open on this machine, and goes on until then.
"""

import contextlib
import faulthandler
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lpv.core.support.discovery import DISCOVERY_RANGE
from lpv.core.support.limits import PATIENCE, QUIET
from lpv_ros2cli.command_line import CliError

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node

Found = TypeVar('Found')
_QUIET = 0.4
"""A graph that has not changed for this long is taken as known [s]."""
_LEAVE = 12.0 * PATIENCE
"""Longest time to leave the graph, much longer than any machine takes [s]."""


@contextlib.contextmanager
def command_node() -> Iterator['Node']:
    """Context with a hidden node."""
    from lpv.bag.rosbag.live import node_alone

    options = {'start_parameter_services': False, 'enable_rosout': False}
    with contextlib.ExitStack() as stack:
        stack.callback(faulthandler.cancel_dump_traceback_later)
        try:
            node, _ = stack.enter_context(node_alone(f'_ros2cli_{os.getpid()}', **options))
        except (RuntimeError, ValueError) as error:  # of rcl: no such domain, no network
            raise CliError(f'no ROS node: {" ".join(str(error).split())}') from error
        # Where another node leaves at the same time, Fast DDS may wait for itself for ever, in a
        # call during which Python sees no signal.
        stack.callback(faulthandler.dump_traceback_later, _LEAVE, exit=True, file=2)
        yield node


def spin(node: 'Node') -> None:
    """Handle what has come, or wait for it: not long, so that SIGINT is seen in between."""
    executor: Any = node.executor  # of node_alone
    executor.spin_once(timeout_sec=0.1)


def settle(node: 'Node') -> None:
    """Wait until the graph is known."""
    find(node, lambda: None, _QUIET)


def find(node: 'Node', query: Callable[[], Found], quiet: float = QUIET) -> Found:
    """Repeat a query until it finds something or the whole graph is known."""
    start = changed = time.monotonic()
    known, local = None, os.environ.get(DISCOVERY_RANGE) == 'LOCALHOST'
    while True:
        found, now = query(), time.monotonic()
        seen = len(node.get_node_names()), len(node.get_topic_names_and_types())
        if seen != known:
            known, changed = seen, now
        is_quiet = now > changed + (quiet if local else QUIET)
        if found or now > start + 2.0 * PATIENCE or (is_quiet and (_all_found(node) or not local)):
            return found
        time.sleep(0.02)


def _all_found(node: 'Node') -> bool:
    """Whether every participant of this machine was found; each publishes its parameter events."""
    infos = node.get_publishers_info_by_topic('/parameter_events')
    participants = {bytes(info.endpoint_gid[:12]) for info in infos}
    first = 7400 + 250 * node.context.get_domain_id() + 10  # ports of the DDS specification
    try:
        lines = Path('/proc/net/udp').read_text(encoding='ascii').splitlines()[1:]
        ports = {int(line.split()[1].rpartition(':')[2], 16) for line in lines}
    except (OSError, ValueError, IndexError):
        return True  # that cannot be told here
    wanted = len(ports & set(range(first, first + 240, 2)))
    return min(len(participants), len(node.get_node_names())) >= wanted


def absolute(name: str) -> str:
    """Absolute form of a name."""
    return name if name.startswith('/') else f'/{name}'


def print_names(names_and_types: Iterable[tuple[str, Sequence[str]]], show_types: bool) -> None:
    """Names one a line, without those of which a part begins with an underscore."""
    for name, types in sorted(names_and_types):
        if '/_' not in name:
            print(f'{name} [{", ".join(types)}]' if show_types else name)


def node_names(node: 'Node', hidden: bool = False) -> list[str]:
    """Nodes of the graph."""
    return sorted(
        f'{namespace.rstrip("/")}/{name}'
        for name, namespace in node.get_node_names_and_namespaces()
        if hidden or not name.startswith('_')
    )


def find_node(node: 'Node', name: str) -> str:
    """Wait until a node is in the graph; its full name."""
    full = absolute(name)
    if not find(node, lambda: full in node_names(node, hidden=True)):
        known = ', '.join(dict.fromkeys(node_names(node))) or 'no nodes'
        raise CliError(f'Node not found: {full} (there are: {known})')
    return full


def find_topic(node: 'Node', name: str) -> tuple[str, str]:
    """Wait until a topic is in the graph; its full name and its type."""
    full = absolute(name)
    types = find(node, lambda: dict(node.get_topic_names_and_types()).get(full))
    if not types:
        raise CliError(f"Unknown topic '{full}'")
    return full, types[0]


def call(
    node: 'Node', service: Any, name: str, request: Any = None, longest: float = PATIENCE
) -> Any:
    """Call a service of the graph that answers within so many seconds; its response."""
    client: Client = node.create_client(service, name)
    deadline = time.monotonic() + longest
    future = None
    while future is None or not future.done():
        if time.monotonic() > deadline:
            raise CliError(f"service '{name}' did not answer within {longest:g} s")
        if future is not None:
            spin(node)
        elif client.wait_for_service(0.1):  # short: SIGINT is seen in between
            future = client.call_async(service.Request() if request is None else request)
    return future.result()
