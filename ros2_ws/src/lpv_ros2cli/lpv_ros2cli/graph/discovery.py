"""A node for the time of one command, and how long to wait until the graph is known.

There is no daemon that knows the graph already.  Finding all participants takes 0.1 s or, where an
announcement was missed, the 3 s until the next one: so the wait ends when as many participants were
found as have ports open on this machine, and goes on until then.
"""

import contextlib
import os
import time
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lpv_core.support.discovery import DISCOVERY_RANGE
from lpv_ros2cli.errors import CliError

if TYPE_CHECKING:
    from rclpy.node import Node

Found = TypeVar('Found')
LONGEST = 10.0
"""Longest wait for a name of the graph, or for the whole graph [s]."""
_QUIET = 0.4
"""A graph that has not changed for this long is taken as known [s]."""
_SURELY_QUIET = 1.0
"""The same, before something is said to be missing: a busy machine is slower [s]."""
_POLL = 0.02
_EVERY_NODE_PUBLISHES = '/parameter_events'


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the options of commands that query the graph."""
    parser.add_argument(
        '--spin-time',
        type=float,
        default=None,
        metavar='SECONDS',
        help='time to discover the graph (until all nodes of this machine are '
        f'known, at most {LONGEST:g} s)',
    )
    parser.add_argument(
        '--no-daemon',
        action='store_true',
        help='accepted for compatibility: there is no daemon here',
    )


@contextlib.contextmanager
def command_node(name: str | None = None) -> Iterator['Node']:
    """Context with a hidden node."""
    import rclpy
    from rclpy.exceptions import InvalidNodeNameException
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(
            name or f'_ros2cli_{os.getpid()}', start_parameter_services=False, enable_rosout=False
        )
    except (InvalidNodeNameException, RuntimeError, ValueError) as error:
        rclpy.try_shutdown()
        raise CliError(f'no ROS node: {" ".join(str(error).split())}') from error
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def settle(node: 'Node', spin_time: float | None = None) -> None:
    """Wait until the graph is known."""
    find(node, lambda: None, spin_time, _QUIET)


def find(
    node: 'Node',
    query: Callable[[], Found],
    spin_time: float | None = None,
    quiet: float = _SURELY_QUIET,
) -> Found:
    """Repeat a query until it finds something or the whole graph is known."""
    start = changed = time.monotonic()
    known = None
    while True:
        found, now = query(), time.monotonic()
        if found or now > start + (LONGEST if spin_time is None else spin_time):
            return found
        seen = (
            len(node.get_node_names()),
            len(node.get_topic_names_and_types()),
            len(node.get_service_names_and_types()),
        )
        if seen != known:
            known, changed = seen, now
        elif spin_time is None and now > changed + quiet and _all_found(node):
            return found
        time.sleep(_POLL)


def wait_for(condition: Callable[[], Found], timeout: float = LONGEST) -> Found:
    """Wait for something that the graph is known to have."""
    deadline = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < deadline:
        time.sleep(_POLL)
    return found


def _all_found(node: 'Node') -> bool:
    """Whether every participant of this machine was found, and of others probably."""
    if os.environ.get(DISCOVERY_RANGE) != 'LOCALHOST':
        return False  # who is on the network cannot be known: take the whole time
    participants = {
        bytes(info.endpoint_gid[:12])
        for info in node.get_publishers_info_by_topic(_EVERY_NODE_PUBLISHES)
    }
    wanted = _local_participants(node.context.get_domain_id())
    return min(len(participants), len(node.get_node_names())) >= wanted


def _local_participants(domain: int) -> int:
    """Number of DDS participants on this machine by their ports; 0 where that cannot be told."""
    first = 7400 + 250 * domain + 10  # of the specification: base, domain gain, offset d1
    try:
        lines = Path('/proc/net/udp').read_text(encoding='ascii').splitlines()[1:]
        ports = {int(line.split()[1].rpartition(':')[2], 16) for line in lines}
    except (OSError, ValueError, IndexError):
        return 0
    return len(ports & set(range(first, first + 240, 2)))
