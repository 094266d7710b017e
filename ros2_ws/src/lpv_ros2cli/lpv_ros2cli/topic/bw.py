"""``ros2 topic bw``."""

import time
from collections import deque

from lpv_ros2cli import completion, discovery, qos
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.topic.listening import receive, topic_and_class

_WINDOW = 100


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    parser.add_argument('topic_name', help='topic').completer = completion.topics
    parser.add_argument(
        '-w',
        '--window',
        type=int,
        default=_WINDOW,
        metavar='N',
        help=f'messages over which the bandwidth is averaged ({_WINDOW})',
    )


def run(arguments) -> None:
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


def _report(bandwidth) -> None:
    text = bandwidth.describe(time.monotonic())
    if text:
        print(text, flush=True)


class Bandwidth:
    """Bandwidth over the last messages.

    Parameters
    ----------
    window : int
        Most messages that count.
    """

    def __init__(self, window: int) -> None:
        self._times, self._sizes = deque(maxlen=window), deque(maxlen=window)

    def take(self, now, size) -> None:
        """Count a message that came at a time [s], of a size [bytes]."""
        self._times.append(now)
        self._sizes.append(size)

    def describe(self, now):
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


def _bytes(number):
    for unit in ('B', 'KB'):
        if number < 1000:
            return f'{number:.0f} {unit}' if unit == 'B' else f'{number:.2f} {unit}'
        number /= 1000
    return f'{number:.2f} MB'
