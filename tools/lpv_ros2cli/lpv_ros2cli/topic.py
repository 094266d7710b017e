"""``ros2 topic``: list, echo, hz, info."""

import argparse
import statistics
import time
from collections import deque
from typing import Any

from lpv_ros2cli import graph, messages
from lpv_ros2cli.command_line import takes

_WINDOW = 10000
"""Messages over which a rate is averaged, as in ros2cli."""


@takes('-t', '--show-types', action='store_true', help='show the types')
def run_list(arguments: argparse.Namespace) -> None:
    """Print the topics of the graph."""
    with graph.command_node() as node:
        graph.settle(node)
        graph.print_names(node.get_topic_names_and_types(), arguments.show_types)


@takes('topic_name')
def run_info(arguments: argparse.Namespace) -> None:
    """Print type, publishers and subscriptions of a topic."""
    with graph.command_node() as node:
        name, kind = graph.find_topic(node, arguments.topic_name)
        graph.settle(node)
        print(f'Type: {kind}\nPublisher count: {node.count_publishers(name)}')
        print(f'Subscription count: {node.count_subscribers(name)}')


@takes('topic_name')
@takes('--once', action='store_true', help='leave after the first message')
def run_echo(arguments: argparse.Namespace) -> None:
    """Print the messages of a topic until interrupted."""
    shown = False

    def show(message: Any) -> None:
        nonlocal shown
        shown = True
        print(messages.to_yaml(message), end='---\n', flush=True)

    with graph.command_node() as node:
        name, kind = graph.find_topic(node, arguments.topic_name)
        # A topic may be known by its subscriptions; publishers decide what is latched.
        graph.find(node, lambda: node.get_publishers_info_by_topic(name))
        node.create_subscription(messages.load(kind, 'msg'), name, show, _matching(10))
        while not (arguments.once and shown):
            graph.spin(node)


@takes('topic_name')
def run_hz(arguments: argparse.Namespace) -> None:
    """Print the rate of a topic's last messages once a second until interrupted."""
    times: deque[float] = deque(maxlen=_WINDOW + 1)
    last = 0.0

    def report() -> None:
        nonlocal last
        if len(times) < 2 or times[-1] == last:
            return
        last = times[-1]
        gaps = [b - a for a, b in zip(times, list(times)[1:])]
        mean, deviation = statistics.fmean(gaps), statistics.pstdev(gaps)
        print(
            f'average rate: {1.0 / mean if mean else 0.0:.3f}\n\tmin: {min(gaps):.3f}s '
            f'max: {max(gaps):.3f}s std dev: {deviation:.5f}s window: {len(gaps)}',
            flush=True,
        )

    with graph.command_node() as node:
        name, kind = graph.find_topic(node, arguments.topic_name)
        node.create_subscription(
            messages.load(kind, 'msg'),
            name,
            lambda _: times.append(time.monotonic()),
            _matching(1000),
            raw=True,
        )
        node.create_timer(1.0, report)
        while True:
            graph.spin(node)


def _matching(depth: int) -> Any:
    """Profile that is compatible with every publisher that a topic has now."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    best = ReliabilityPolicy.BEST_AVAILABLE, DurabilityPolicy.BEST_AVAILABLE
    return QoSProfile(depth=depth, reliability=best[0], durability=best[1])
