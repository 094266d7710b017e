"""``ros2 topic echo``."""

from argparse import ArgumentParser, Namespace
from typing import Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.receiving import receive, topic_and_class
from lpv_ros2cli.message.to_text import DEFAULT_LENGTH, Style, field_of, is_message, to_csv, to_yaml


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
    parser.add_argument('--flow-style', action='store_true', help='one line a message')
    parser.add_argument('--once', action='store_true', help='leave after the first message')
    parser.add_argument('--timeout', type=float, metavar='SECONDS', help='leave after this time')


def run(arguments: Namespace) -> None:
    """Print messages until interrupted."""
    if arguments.truncate_length < 0:
        raise CliError('--truncate-length must not be negative')
    style = Style(
        None if arguments.full_length else arguments.truncate_length,
        arguments.no_arr,
        arguments.no_str,
        arguments.flow_style,
    )
    with discovery.command_node() as node:
        name, message_class = topic_and_class(node, arguments)
        if arguments.field:
            field_of(message_class(), arguments.field.partition('[')[0])
        echo = _Echo(arguments, style)
        node.create_subscription(
            message_class, name, echo.show, qos.chosen_profile(arguments, qos.fitting(node, name))
        )
        in_time = receive(
            node, lambda: echo.error or (arguments.once and echo.shown), arguments.timeout
        )
    if echo.error:
        raise echo.error
    if not in_time and not echo.shown:
        raise CliError(f'no message on {name} within {arguments.timeout:g} s')


class _Echo:
    """Prints messages, and counts them."""

    def __init__(self, arguments: Namespace, style: Style) -> None:
        self._arguments, self._style = arguments, style
        self.shown = 0
        self.error: CliError | None = None

    def show(self, message: Any) -> None:
        if self._arguments.once and self.shown:
            return
        value = message
        if self._arguments.field:
            try:
                value = field_of(message, self._arguments.field)
            except CliError as error:  # an element beyond the end of this array
                self.error = error
                return
        if self._arguments.csv:
            print(to_csv(value, self._style), flush=True)
        elif is_message(value) or not isinstance(value, str):
            print(f'{to_yaml(value, self._style)}---', flush=True)
        else:
            print(f'{value}\n---', flush=True)
        self.shown += 1
