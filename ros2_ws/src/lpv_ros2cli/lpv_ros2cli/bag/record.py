"""``ros2 bag record``: starts the recorder of lpv_bag."""

import json
import os
import re
import time
from pathlib import Path

from lpv_ros2cli import completion, discovery
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.names import absolute, without_hidden
from lpv_ros2cli.packages import executable


def add_arguments(parser):
    """Declare the verb's arguments."""
    parser.add_argument('topics', nargs='*', metavar='topic', help='topics; they need not be '
                        'there yet').completer = completion.topics
    parser.add_argument('--topics', nargs='+', dest='more_topics', default=[], metavar='topic',
                        help='topics').completer = completion.topics
    parser.add_argument('-a', '--all', '--all-topics', action='store_true',
                        help='all topics that are there at the start')
    parser.add_argument('-e', '--regex', metavar='PATTERN',
                        help='topics that are there at the start and contain the pattern')
    parser.add_argument('-x', '--exclude-regex', metavar='PATTERN', help='but not these')
    parser.add_argument('-o', '--output', help='folder to create (rosbag2_<date>-<time>)')
    parser.add_argument('-s', '--storage', choices=('mcap',), default='mcap', help='storage (mcap)')
    parser.add_argument('--include-hidden-topics', action='store_true')
    parser.add_argument('--spin-time', type=float, default=None, metavar='SECONDS',
                        help='look for topics so long')


def run(arguments):
    """Become the recorder, which ends at SIGINT or SIGTERM with a complete bag."""
    chosen = [*arguments.topics, *arguments.more_topics]
    if not chosen and not arguments.all and arguments.regex is None:
        raise CliError('what is to be recorded? Name topics, or give --all or --regex PATTERN', 2)
    output = Path(arguments.output or time.strftime('rosbag2_%Y_%m_%d-%H_%M_%S'))
    if output.exists():
        raise CliError(f"output folder '{output}' already exists")
    topics = _topics(arguments, chosen)
    if not topics:
        raise CliError('there are no topics to record')
    program = executable('lpv_bag', 'recorder')
    print(f'recording {len(topics)} topics into {output}; press Ctrl-C to end', flush=True)
    os.execv(program, [str(program), '--ros-args', '-r', '__node:=rosbag2_recorder',
                       # JSON is YAML: quoted whatever a name looks like.
                       '-p', f'output:={json.dumps(str(output))}',
                       '-p', f'topics:={json.dumps(topics)}'])


def _topics(arguments, chosen):
    include, exclude = _pattern(arguments.regex), _pattern(arguments.exclude_regex)
    with discovery.command_node() as node:
        topics = {absolute(name, node) for name in chosen}
        if arguments.all or include is not None:
            discovery.settle(node, arguments.spin_time)
            topics |= {name for name, _ in without_hidden(
                node.get_topic_names_and_types(), arguments.include_hidden_topics)
                if arguments.all or include.search(name)}
    return sorted(name for name in topics if exclude is None or not exclude.search(name))


def _pattern(text):
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise CliError(f'{text!r} is no regular expression: {error}') from error
