"""``ros2 topic hz``."""

import math
import time
from argparse import ArgumentParser, Namespace
from collections import deque

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import receive, topic_and_class

_WINDOW = 10000


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic_name', help='topic')
    parser.add_argument(
        '-w',
        '--window',
        type=int,
        default=_WINDOW,
        metavar='N',
        help=f'messages over which the rate is averaged ({_WINDOW})',
    )
    parser.add_argument(
        '--wall-time',
        action='store_true',
        help='accepted for compatibility: rates are of the wall clock',
    )


def run(arguments: Namespace) -> None:
    """Print the rate once a second until interrupted."""
    if arguments.window < 2:
        raise CliError('--window must be at least 2')
    rate = Rate(arguments.window)
    with discovery.command_node() as node:
        name, message_class = topic_and_class(node, arguments)
        node.create_subscription(
            message_class,
            name,
            lambda _: rate.take(time.monotonic()),
            qos.fitting(node, name, depth=1000),
            raw=True,
        )
        node.create_timer(1.0, lambda: _report(rate))
        receive(node)


def _report(rate: 'Rate') -> None:
    text = rate.describe()
    if text:
        print(text, flush=True)


class Rate:
    """Rate of messages over the last ones."""

    def __init__(self, window: int) -> None:
        self._intervals: deque[float] = deque(maxlen=window)
        self._last: float | None = None
        self._reported = 0
        self.count = 0

    def take(self, now: float) -> None:
        """Count a message that came at a time [s]."""
        if self._last is not None:
            self._intervals.append(now - self._last)
        self._last = now
        self.count += 1

    def describe(self) -> str:
        """Two lines about the rate; empty where no interval is known or nothing new came."""
        if not self._intervals:
            return ''
        if self.count == self._reported:
            return 'no new messages'
        self._reported = self.count
        number = len(self._intervals)
        mean = sum(self._intervals) / number
        spread = math.sqrt(sum((x - mean) ** 2 for x in self._intervals) / number)
        rate = 1.0 / mean if mean > 0.0 else 0.0
        return (
            f'average rate: {rate:.3f}\n\tmin: {min(self._intervals):.3f}s '
            f'max: {max(self._intervals):.3f}s std dev: {spread:.5f}s window: {number + 1}'
        )
