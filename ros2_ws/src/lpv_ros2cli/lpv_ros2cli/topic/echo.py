"""``ros2 topic echo``."""

from argparse import ArgumentParser, Namespace
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.names import absolute
from lpv_ros2cli.graph.receiving import Reception, message_filter, topic_class
from lpv_ros2cli.message.to_text import DEFAULT_LENGTH, Style, field_of, is_message, to_csv, to_yaml
from lpv_ros2cli.message.types import load


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic_name', help='topic')
    completion.add_argument(
        parser,
        completion.interface_types('msg'),
        'message_type',
        nargs='?',
        help='its type; the topic need not be there yet then',
    )
    qos.add_arguments(parser, 'what fits the publishers')
    parser.add_argument('--csv', action='store_true', help='one line a message, comma-separated')
    parser.add_argument('--field', metavar='NAME', help='only this field, e.g. header.stamp')
    parser.add_argument(
        '-f', '--full-length', action='store_true', help='do not shorten long arrays and texts'
    )
    parser.add_argument(
        '-l',
        '--truncate-length',
        type=int,
        default=DEFAULT_LENGTH,
        metavar='N',
        help=f'length to which they are shortened ({DEFAULT_LENGTH})',
    )
    parser.add_argument('--no-arr', action='store_true', help='do not show arrays')
    parser.add_argument('--no-str', action='store_true', help='do not show texts')
    parser.add_argument('--flow-style', action='store_true', help='one line a list')
    parser.add_argument(
        '--filter',
        metavar='EXPRESSION',
        help='only messages for which this holds, e.g. \'m.kind == "bias"\'; with --field, m is '
        'the field',
    )
    parser.add_argument('--raw', action='store_true', help='show the serialized messages')
    parser.add_argument('--once', action='store_true', help='leave after the first message')
    parser.add_argument('--timeout', type=float, metavar='SECONDS', help='leave after this time')


def run(arguments: Namespace) -> None:
    """Print messages until interrupted."""
    if arguments.truncate_length < 0:
        raise CliError('--truncate-length must not be negative')
    if arguments.raw and (arguments.csv or arguments.field or arguments.filter):
        raise CliError('--raw excludes --csv, --field and --filter', 2)
    echo = _Echo(arguments)
    with discovery.command_node() as node:
        if arguments.message_type:
            name = absolute(arguments.topic_name)
            message_class = load(arguments.message_type, 'msg')
        else:
            name, message_class = topic_class(
                node, arguments.topic_name, arguments.spin_time, wait=False
            )
            # A topic may be known by its subscriptions; publishers decide what is latched.
            discovery.find(
                node, lambda: node.get_publishers_info_by_topic(name), arguments.spin_time
            )
        if arguments.field:
            field_of(message_class(), arguments.field.partition('[')[0])
        profile = qos.chosen_profile(arguments, qos.matching(node, name))
        reception = Reception(node)
        reception.subscribe(message_class, name, echo.show, profile, arguments.raw)
        in_time = reception.run(lambda: arguments.once and echo.shown, arguments.timeout)
    if not in_time and not echo.shown:
        raise CliError(f'no message on {name} within {arguments.timeout:g} s')


class _Echo:
    """Prints messages, and counts them."""

    def __init__(self, arguments: Namespace) -> None:
        self._arguments = arguments
        self._style = Style(
            None if arguments.full_length else arguments.truncate_length,
            arguments.no_arr,
            arguments.no_str,
            arguments.flow_style,
        )
        self._matches = message_filter(arguments.filter)
        self.shown = 0

    def show(self, message: Any) -> None:
        if self._arguments.once and self.shown:
            return
        field = self._arguments.field
        value = field_of(message, field) if field else message
        if not self._matches(value):
            return
        if not is_message(value):  # a field, or a serialized message
            print(value, end='\n---\n', flush=True)
        elif self._arguments.csv:
            print(to_csv(value, self._style), flush=True)
        else:
            print(to_yaml(value, self._style), end='---\n', flush=True)
        self.shown += 1
