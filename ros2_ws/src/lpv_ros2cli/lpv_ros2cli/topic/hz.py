"""``ros2 topic hz``."""

import time
from argparse import ArgumentParser, Namespace
from collections import deque
from functools import partial
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import Reception, message_filter, topic_class
from lpv_ros2cli.topic.statistics import Statistics, table

_WINDOW = 10000
_HEADINGS = ('topic', 'rate', 'min_delta', 'max_delta', 'std_dev', 'window')


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic_name', nargs='+', help='topics')
    parser.add_argument(
        '-w',
        '--window',
        type=int,
        default=_WINDOW,
        metavar='N',
        help=f'messages over which the rate is averaged ({_WINDOW})',
    )
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
    if arguments.window < 2:
        raise CliError('--window must be at least 2')
    matches, rates = message_filter(arguments.filter), {}
    names = list(dict.fromkeys(arguments.topic_name))

    def receive(rate: Rate, message: Any) -> None:
        if matches(message):
            rate.add(time.monotonic())

    with discovery.command_node() as node:
        reception = Reception(node)
        for typed in names:
            name, message_class = topic_class(node, typed, arguments.spin_time)
            rates[typed] = Rate(arguments.window)
            profile = qos.matching(node, name, depth=1000)
            # Messages are only deserialized where the filter reads them.
            raw = arguments.filter is None
            reception.subscribe(message_class, name, partial(receive, rates[typed]), profile, raw)
            if len(names) > 1:
                print(f'Subscribed to [{typed}]', flush=True)
        node.create_timer(1.0, lambda: _report(rates))
        reception.run()


def _report(rates: dict[str, 'Rate']) -> None:
    found = {name: new for name, rate in rates.items() if (new := rate.news()) is not None}
    if not found:
        return
    if len(rates) == 1:
        (new,) = found.values()
        print(
            f'average rate: {1.0 / new.mean if new.mean > 0.0 else 0.0:.3f}\n\t{new.spread()}',
            flush=True,
        )
        return
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
    print(table(_HEADINGS, rows), flush=True)


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
