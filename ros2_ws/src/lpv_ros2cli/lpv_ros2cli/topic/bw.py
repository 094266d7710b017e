"""``ros2 topic bw``."""

import time
from argparse import ArgumentParser, Namespace
from collections import deque

from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.receiving import topic_class
from lpv_ros2cli.topic import measuring

_UNITS = ((1, 'B', 0), (1000, 'KB', 2), (1000_000, 'MB', 2))
"""Sizes are shown in the unit of the bandwidth: divisor, name, decimals."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    measuring.add_arguments(parser, 'bandwidth', 100, help='topic')


def run(arguments: Namespace) -> None:
    """Print the bandwidth once a second until interrupted."""
    measuring.check_window(arguments.window, 2)
    bandwidth = Bandwidth(arguments.window)
    with discovery.command_node() as node:
        measurement = measuring.Measurement(node)
        measurement.subscribe(
            topic_class(node, arguments.topic, arguments.spin_time),
            lambda data: bandwidth.add(time.monotonic(), len(data)),
            raw=True,
        )
        print(f'Subscribed to [{arguments.topic}]', flush=True)
        measurement.run(lambda: bandwidth.describe(time.monotonic()))


class Bandwidth:
    """Bandwidth over the last messages."""

    def __init__(self, window: int) -> None:
        self._times: deque[float] = deque(maxlen=window)
        self._sizes: deque[int] = deque(maxlen=window)

    def add(self, now: float, size: int) -> None:
        """Count a message that came at a time [s], of a size [bytes]."""
        self._times.append(now)
        self._sizes.append(size)

    def describe(self, now: float) -> str:
        """Two lines about the time up to now [s]; empty where too little is known."""
        if len(self._times) < 2:
            return ''
        count, total = len(self._sizes), sum(self._sizes)
        rate = total / (now - self._times[0])
        divisor, unit, digits = next((form for form in _UNITS if rate < 1000 * form[0]), _UNITS[-1])

        def shown(number: float) -> str:
            return f'{number / divisor:.{digits}f} {unit}'

        return (
            f'{shown(rate)}/s from {count} messages\n\tMessage size mean: {shown(total / count)} '
            f'min: {shown(min(self._sizes))} max: {shown(max(self._sizes))}'
        )
