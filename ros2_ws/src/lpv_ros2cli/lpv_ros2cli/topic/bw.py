"""``ros2 topic bw``."""

import time
from argparse import ArgumentParser, Namespace
from collections import deque

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import receive, topic_and_class

_WINDOW = 100


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
        help=f'messages over which the bandwidth is averaged ({_WINDOW})',
    )


def run(arguments: Namespace) -> None:
    """Print the bandwidth once a second until interrupted."""
    if arguments.window < 2:
        raise CliError('--window must be at least 2')
    bandwidth = Bandwidth(arguments.window)
    with discovery.command_node() as node:
        name, message_class = topic_and_class(node, arguments)
        node.create_subscription(
            message_class,
            name,
            lambda data: bandwidth.take(time.monotonic(), len(data)),
            qos.fitting(node, name, depth=1000),
            raw=True,
        )
        print(f'Subscribed to [{name}]', flush=True)
        node.create_timer(1.0, lambda: _report(bandwidth))
        receive(node)


def _report(bandwidth: 'Bandwidth') -> None:
    text = bandwidth.describe(time.monotonic())
    if text:
        print(text, flush=True)


class Bandwidth:
    """Bandwidth over the last messages."""

    def __init__(self, window: int) -> None:
        self._times: deque[float] = deque(maxlen=window)
        self._sizes: deque[int] = deque(maxlen=window)

    def take(self, now: float, size: int) -> None:
        """Count a message that came at a time [s], of a size [bytes]."""
        self._times.append(now)
        self._sizes.append(size)

    def describe(self, now: float) -> str:
        """Two lines about the time up to now [s]; empty where too little is known."""
        if len(self._times) < 2:
            return ''
        number, total = len(self._sizes), sum(self._sizes)
        span = now - self._times[0]
        sizes = ' '.join(
            f'{name}: {_bytes(value)}'
            for name, value in (
                ('mean', total / number),
                ('min', min(self._sizes)),
                ('max', max(self._sizes)),
            )
        )
        return f'{_bytes(total / span)}/s from {number} messages\n\tMessage size {sizes}'


def _bytes(number: float) -> str:
    for unit in ('B', 'KB'):
        if number < 1000:
            return f'{number:.0f} {unit}' if unit == 'B' else f'{number:.2f} {unit}'
        number /= 1000
    return f'{number:.2f} MB'
