"""``ros2 bag play``."""

import time
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.bag.reading import opened, topics_of
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.message.types import load

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from lpv_bag.rosbag.reading import BagReader

_BETWEEN = 0.1
"""Pause between two rounds of a loop: a bag of one message must not flood the graph [s]."""
_ACKNOWLEDGEMENT_TIMEOUT = 1.0
"""Time for slow subscribers to acknowledge the last messages [s]."""
_FASTEST = 1e4
"""Most messages a second on /clock."""


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('bag_path', help='bag')
    parser.add_argument(
        '-r',
        '--rate',
        type=float,
        default=1.0,
        metavar='N',
        help='speed, as a multiple of the recorded one (1)',
    )
    parser.add_argument('--topics', nargs='+', metavar='topic', help='only these')
    parser.add_argument(
        '-m',
        '--remap',
        nargs='+',
        default=[],
        metavar='old:=new',
        help='publish topics under other names',
    )
    parser.add_argument('-l', '--loop', action='store_true', help='start again at the end')
    parser.add_argument(
        '-d',
        '--delay',
        type=float,
        default=0.0,
        metavar='SECONDS',
        help='wait before the first message',
    )
    parser.add_argument(
        '--start-offset',
        type=float,
        default=0.0,
        metavar='SECONDS',
        help='skip this time at the start of the bag',
    )
    parser.add_argument(
        '--clock',
        type=float,
        nargs='?',
        const=40.0,
        default=0.0,
        metavar='HZ',
        help='publish /clock at this rate (40)',
    )


def run(arguments: Namespace) -> None:
    """Publish a bag's messages at the times at which they were recorded."""
    if not arguments.rate > 0.0 or not arguments.rate < float('inf'):
        raise CliError('--rate must be greater than zero')
    if not all(
        0.0 <= value < 1e9 for value in (arguments.clock, arguments.delay, arguments.start_offset)
    ):
        raise CliError('--clock, --delay and --start-offset must be numbers from zero')
    from lpv_bag.replay.playback import Playback, await_acknowledgement  # slow, and not for --help

    with opened(arguments.bag_path) as reader, discovery.command_node('rosbag2_player') as node:
        connections, publishers = _publishers(node, reader, arguments)
        print(
            f'playing {len(publishers)} topics of {arguments.bag_path} at '
            f'{arguments.rate:g} x the recorded speed',
            flush=True,
        )
        # Subscribers that are there are given the time to be found: they miss nothing then.
        discovery.wait_for(
            lambda: all(p.get_subscription_count() for p in publishers.values()), 1.0
        )
        time.sleep(arguments.delay)
        playback = Playback(
            reader, connections, publishers, arguments.rate, *_clock(node, arguments)
        )
        begin, total = reader.start_time + round(arguments.start_offset * 1e9), 0
        while (count := playback.run(start=begin, origin=begin)) and arguments.loop:
            total += count
            time.sleep(_BETWEEN)
        await_acknowledgement(publishers.values(), _ACKNOWLEDGEMENT_TIMEOUT)
        print(f'published {total + count} messages')


def _publishers(node: 'Node', reader: 'BagReader', arguments: Namespace) -> tuple[Any, ...]:
    """Connections to be played, and the publisher of each topic."""
    from lpv_bag.replay.playback import recorded_qos

    remaps, topics = dict(_pair(text) for text in arguments.remap), topics_of(reader)
    unknown = set(arguments.topics or ()) - set(topics)
    if unknown:
        raise CliError(f'the bag has no topic {min(unknown)}; it has: {", ".join(topics)}')
    publishers = {}
    for name, connections in topics.items():
        if arguments.topics and name not in arguments.topics:
            continue
        try:
            message_class = load(connections[0].msgtype, 'msg')
        except CliError as error:
            print(f'{name} is not played: {error}', flush=True)
            continue
        publishers[name] = node.create_publisher(
            message_class, remaps.get(name, name), recorded_qos(connections)
        )
    if not publishers:
        raise CliError('the bag has no topic that can be played')
    return [c for name in publishers for c in topics[name]], publishers


def _clock(node: 'Node', arguments: Namespace) -> tuple['Publisher | None', int | None]:
    """Publisher of /clock and the bag's time between its messages, so many a second of ours."""
    if not arguments.clock:
        return None, None
    from rosgraph_msgs.msg import Clock

    period = arguments.rate / min(arguments.clock, _FASTEST)
    return node.create_publisher(Clock, '/clock', 10), max(1, round(period * 1e9))


def _pair(text: str) -> tuple[str, str]:
    old, found, new = text.partition(':=')
    if not found or not old or not new:
        raise CliError(f'malformed remap {text!r}, expected old:=new')
    return old, new
