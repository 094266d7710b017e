"""What bw, delay and hz share: their window, and a line a second about what arrives."""

from argparse import ArgumentParser
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import Reception

if TYPE_CHECKING:
    from rclpy.node import Node


def add_arguments(
    parser: ArgumentParser, measure: str, window: int, topic: str = 'topic', **options: Any
) -> None:
    """Declare discovery, topic, and the window over which a measure is averaged."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, topic, **options)
    parser.add_argument(
        '-w',
        '--window',
        type=int,
        default=window,
        metavar='N',
        help=f'messages over which the {measure} is averaged ({window})',
    )


def check_window(window: int, least: int) -> None:
    """CliError for a window below the least one."""
    if window < least:
        raise CliError(f'--window must be at least {least}')


class Measurement:
    """Messages of some topics, and a text about them once a second until interrupted."""

    def __init__(self, node: 'Node') -> None:
        self._node, self._reception = node, Reception(node)

    def subscribe(
        self, topic: tuple[str, Any], callback: Callable[[Any], None], raw: bool = False
    ) -> None:
        """Pass all messages of a topic, given by its name and class, to a callback."""
        name, message_class = topic
        profile = qos.matching(self._node, name, depth=1000)
        self._reception.subscribe(message_class, name, callback, profile, raw)

    def run(self, describe: Callable[[], str]) -> None:
        """Print what there is to say; an empty text is not printed."""

        def report() -> None:
            if text := describe():
                print(text, flush=True)

        self._node.create_timer(1.0, report)
        self._reception.run()
