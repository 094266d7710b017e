"""``ros2 topic delay``."""

from argparse import ArgumentParser, Namespace
from collections import deque
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import Reception, topic_class
from lpv_ros2cli.topic.statistics import Statistics

_WINDOW = 10000


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic', help='topic with a header')
    parser.add_argument(
        '-w',
        '--window',
        type=int,
        default=_WINDOW,
        metavar='N',
        help=f'messages over which the delay is averaged ({_WINDOW})',
    )


def run(arguments: Namespace) -> None:
    """Print the time from stamp to reception once a second until interrupted."""
    if arguments.window < 1:
        raise CliError('--window must be at least 1')
    delays = Delays(arguments.window)
    with discovery.command_node() as node:
        name, message_class = topic_class(node, arguments.topic, arguments.spin_time)
        if 'header' not in message_class.get_fields_and_field_types():
            raise CliError('msg does not have header')

        def receive(message: Any) -> None:
            stamp = message.header.stamp
            now = node.get_clock().now().nanoseconds
            delays.add((now - stamp.sec * 10**9 - stamp.nanosec) * 1e-9)

        reception = Reception(node)
        profile = qos.matching(node, name, depth=1000)
        reception.subscribe(message_class, name, receive, profile, raw=False)
        node.create_timer(1.0, lambda: _report(delays))
        reception.run()


def _report(delays: 'Delays') -> None:
    text = delays.report()
    if text:
        print(text, flush=True)


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
