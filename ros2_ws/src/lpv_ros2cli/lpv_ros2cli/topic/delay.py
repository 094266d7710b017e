"""``ros2 topic delay``."""

from argparse import ArgumentParser, Namespace
from collections import deque
from typing import Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.receiving import topic_class
from lpv_ros2cli.topic import measuring
from lpv_ros2cli.topic.statistics import Statistics


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    measuring.add_arguments(parser, 'delay', 10000, help='topic with a header')


def run(arguments: Namespace) -> None:
    """Print the time from stamp to reception once a second until interrupted."""
    measuring.check_window(arguments.window, 1)
    delays = Delays(arguments.window)
    with discovery.command_node() as node:
        name, message_class = topic_class(node, arguments.topic, arguments.spin_time)
        if 'header' not in message_class.get_fields_and_field_types():
            raise CliError('msg does not have header')

        def receive(message: Any) -> None:
            stamp = message.header.stamp
            now = node.get_clock().now().nanoseconds
            delays.add((now - stamp.sec * 10**9 - stamp.nanosec) * 1e-9)

        measurement = measuring.Measurement(node)
        measurement.subscribe((name, message_class), receive)
        measurement.run(delays.report)


class Delays:
    """Delays of the last messages of a topic."""

    def __init__(self, window: int) -> None:
        self._delays: deque[float] = deque(maxlen=window)
        self._is_first, self._is_new = True, False

    def add(self, delay: float) -> None:
        """Count a delay [s], except of the first message: discovery is in it."""
        if not self._is_first:
            self._delays.append(delay)
        self._is_first, self._is_new = False, True

    def report(self) -> str:
        """Lines about the delays; empty as long as there are none."""
        if not self._delays:
            return ''
        if not self._is_new:
            return 'no new messages'
        self._is_new = False
        statistics = Statistics.of(self._delays)
        return f'average delay: {statistics.mean:.3f}\n\t{statistics.spread()}'
