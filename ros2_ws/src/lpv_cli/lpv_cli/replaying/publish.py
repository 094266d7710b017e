"""``lpv replay --publish``: a bag into the live graph."""

import argparse

from rich.console import Console

from lpv_cli.needs import require_ros
from lpv_core.support.discovery import stay_local


def add_publishing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--publish',
        action='store_true',
        help='play the bag into the live graph, with /clock, and run nothing offline; needs ROS 2',
    )
    parser.add_argument('--rate', type=float, default=1.0, help='with --publish: speed (1)')
    parser.add_argument('--loop', action='store_true', help='with --publish: again and again')
    parser.add_argument(
        '--clock-rate',
        type=float,
        default=100.0,
        help='with --publish: messages on /clock per second of the bag, 0 for none (100)',
    )
    parser.add_argument(
        '--topics',
        nargs='+',
        help='with --publish: topics to play; all but the answers of the diagnosis if not given',
    )
    parser.add_argument(
        '--wait',
        type=float,
        default=5.0,
        help='with --publish: longest time to '
        'wait for a subscriber before the first message [s] (5)',
    )


def publish(arguments: argparse.Namespace, console: Console) -> int:
    stay_local()
    require_ros()
    from lpv_bag.replay.player import Player

    player = Player(
        arguments.bag,
        arguments.topics,
        arguments.topic,
        arguments.rate,
        arguments.loop,
        arguments.clock_rate,
        arguments.wait,
        (arguments.start, arguments.end),
    )
    count = player.run(lambda text: console.print(text))
    console.print(f'{count} messages published')
    return 0
