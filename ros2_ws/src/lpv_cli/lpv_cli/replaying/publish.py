"""``lpv replay --publish``: a bag into the live graph."""

import argparse

from rich.console import Console

from lpv_cli.needs import require_ros
from lpv_cli.options import flag, number
from lpv_core.support.discovery import stay_local


def add_publishing(parser: argparse.ArgumentParser) -> None:
    flag(
        parser,
        '--publish',
        'play the bag into the live graph, with /clock, and run nothing offline; needs ROS 2',
    )
    number(parser, '--rate', 1.0, 'with --publish: speed')
    flag(parser, '--loop', 'with --publish: again and again')
    number(
        parser,
        '--clock-rate',
        100.0,
        'with --publish: messages on /clock per second of the bag, 0 for none',
    )
    parser.add_argument(
        '--topics',
        nargs='+',
        help='with --publish: topics to play; all but the answers of the diagnosis if not given',
    )
    number(
        parser,
        '--wait',
        5.0,
        'with --publish: longest time to wait for a subscriber before the first message [s]',
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
