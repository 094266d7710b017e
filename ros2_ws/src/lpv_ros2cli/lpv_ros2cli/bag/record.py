"""``ros2 bag record``: starts the recorder of lpv_bag."""

import json
import os
import re
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import absolute, without_hidden
from lpv_ros2cli.packages import executable


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(
        parser,
        completion.topics,
        'topics',
        nargs='*',
        metavar='topic',
        help='topics; they need not be there yet',
    )
    completion.add_argument(
        parser,
        completion.topics,
        '--topics',
        nargs='+',
        dest='more_topics',
        default=[],
        metavar='topic',
        help='topics',
    )
    parser.add_argument('-a', '--all', '--all-topics', action='store_true', help='all topics')
    parser.add_argument(
        '-e',
        '--regex',
        metavar='PATTERN',
        help='topics that are there at the start and contain the pattern',
    )
    parser.add_argument('-x', '--exclude-regex', metavar='PATTERN', help='but not these')
    parser.add_argument(
        '-b',
        '--max-bag-size',
        type=int,
        default=0,
        metavar='BYTES',
        help='begin a new file at this size (never)',
    )
    parser.add_argument(
        '-d',
        '--max-bag-duration',
        type=int,
        default=0,
        metavar='SECONDS',
        help='begin a new file after this time (never)',
    )
    parser.add_argument('-o', '--output', help='folder to create (rosbag2_<date>-<time>)')
    parser.add_argument('-s', '--storage', choices=('mcap',), default='mcap', help='storage (mcap)')
    parser.add_argument('--include-hidden-topics', action='store_true')
    parser.add_argument(
        '--spin-time', type=float, default=None, metavar='SECONDS', help='time to discover topics'
    )


def run(arguments: Namespace) -> None:
    """Become the recorder, which ends at SIGINT or SIGTERM with a complete bag."""
    chosen = {absolute(name) for name in (*arguments.topics, *arguments.more_topics)}
    if not chosen and not arguments.all and arguments.regex is None:
        raise CliError('what is to be recorded? Name topics, or give --all or --regex PATTERN', 2)
    output = Path(arguments.output or time.strftime('rosbag2_%Y_%m_%d-%H_%M_%S'))
    if output.exists():
        raise CliError(f"output folder '{output}' already exists")
    settings = {'output': str(output), **_splitting(arguments), **_selection(arguments, chosen)}
    program = executable('lpv_bag', 'recorder')
    words = [str(program), '--ros-args', '-r', '__node:=rosbag2_recorder']
    for name, value in settings.items():
        # JSON is YAML: quoted whatever a name looks like.
        words += ['-p', f'{name}:={json.dumps(value)}']
    print('press Ctrl-C to end the recording', flush=True)
    os.execv(program, words)


def _selection(arguments: Namespace, chosen: set[str]) -> dict[str, Any]:
    include, exclude = _pattern(arguments.regex), _pattern(arguments.exclude_regex)
    if arguments.all and exclude is None and 'all' in _recorder_parameters():
        return {'all': True, 'exclude': ['']}
    topics = set(chosen)
    if arguments.all or include is not None:
        with discovery.command_node() as node:
            discovery.settle(node, arguments.spin_time)
            topics |= {
                name
                for name, _ in without_hidden(
                    node.get_topic_names_and_types(), arguments.include_hidden_topics
                )
                if include is None or arguments.all or include.search(name)
            }
    kept = sorted(t for t in topics if exclude is None or not exclude.search(t))
    if not kept:
        raise CliError('there are no topics to record')
    return {'topics': kept}


def _splitting(arguments: Namespace) -> dict[str, Any]:
    known, settings = _recorder_parameters(), {}
    for option, value, name in (
        ('-b', -(-arguments.max_bag_size // (1 << 20)), 'split_size'),
        ('-d', float(arguments.max_bag_duration), 'split_duration'),
    ):
        if value < 0 or (value and name not in known):
            raise CliError(f'option {option}: bags cannot be split so', 2)
        if value:
            settings[name] = value
    return settings


def _recorder_parameters() -> set[str]:
    from lpv_bag.recorder.node import SPECS

    return {spec.name for spec in SPECS}


def _pattern(text: str | None) -> re.Pattern[str] | None:
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise CliError(f'{text!r} is no regular expression: {error}') from error
