"""``ros2 topic hz``."""

import time
from argparse import ArgumentParser, Namespace
from collections import deque
from functools import partial
from typing import Any

from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.receiving import message_filter, topic_class
from lpv_ros2cli.topic import measuring
from lpv_ros2cli.topic.statistics import Statistics, table

_HEADINGS = ('topic', 'rate', 'min_delta', 'max_delta', 'std_dev', 'window')


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    measuring.add_arguments(parser, 'rate', 10000, 'topic_name', nargs='+', help='topics')
    parser.add_argument(
        '--filter',
        metavar='EXPRESSION',
        help='only messages m for which this holds, e.g. \'m.kind == "bias"\'',
    )
    parser.add_argument(
        '--wall-time',
        action='store_true',
        help='accepted for compatibility: rates are of the wall clock',
    )


def run(arguments: Namespace) -> None:
    """Print the rates once a second until interrupted."""
    measuring.check_window(arguments.window, 2)
    matches, rates = message_filter(arguments.filter), {}
    names = list(dict.fromkeys(arguments.topic_name))

    def receive(rate: Rate, message: Any) -> None:
        if matches(message):
            rate.add(time.monotonic())

    with discovery.command_node() as node:
        measurement = measuring.Measurement(node)
        for typed in names:
            topic = topic_class(node, typed, arguments.spin_time)
            rates[typed] = Rate(arguments.window)
            # Messages are only deserialized where the filter reads them.
            measurement.subscribe(
                topic, partial(receive, rates[typed]), raw=arguments.filter is None
            )
            if len(names) > 1:
                print(f'Subscribed to [{typed}]', flush=True)
        measurement.run(lambda: _describe(rates))


def _describe(rates: dict[str, 'Rate']) -> str:
    found = {name: new for name, rate in rates.items() if (new := rate.news()) is not None}
    if not found:
        return ''
    if len(rates) == 1:
        (new,) = found.values()
        return f'average rate: {1.0 / new.mean if new.mean > 0.0 else 0.0:.3f}\n\t{new.spread()}'
    rows = [
        (
            name,
            f'{1.0 / new.mean if new.mean > 0.0 else 0.0:.3f}',
            f'{new.least:.3f}',
            f'{new.most:.3f}',
            f'{new.deviation:.5f}',
            str(new.count),
        )
        for name, new in found.items()
    ]
    return table(_HEADINGS, rows)


class Rate:
    """Intervals between the last messages of a topic."""

    def __init__(self, window: int) -> None:
        self._intervals: deque[float] = deque(maxlen=window)
        self._last: float | None = None
        self._is_new = False

    def add(self, now: float) -> None:
        """Count a message that came at a time [s]."""
        if self._last is not None:
            self._intervals.append(now - self._last)
            self._is_new = True
        self._last = now

    def news(self) -> Statistics | None:
        """Statistics of the intervals [s]; None if there are no new ones since the last call."""
        if not self._is_new:
            return None
        self._is_new = False
        return Statistics.of(self._intervals)
