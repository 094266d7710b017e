"""``ros2 topic pub``."""

import sys
import time
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery, qos
from lpv_ros2cli.graph.names import absolute
from lpv_ros2cli.message.from_text import message_from_text
from lpv_ros2cli.message.types import load

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic_name', help='topic')
    completion.add_argument(
        parser, completion.interface_types('msg'), 'message_type', help='its type'
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        'values',
        nargs='?',
        default='{}',
        help='fields in YAML; "header: auto" and "stamp: now" take the present time',
    )
    group.add_argument('--stdin', action='store_true', help='read the fields from stdin')
    parser.add_argument('-r', '--rate', type=float, default=1.0, metavar='N', help='rate [Hz] (1)')
    parser.add_argument(
        '-p', '--print', type=int, default=1, metavar='N', help='print only every N-th message'
    )
    times = parser.add_mutually_exclusive_group()
    times.add_argument('-1', '--once', action='store_true', help='publish one message')
    times.add_argument('-t', '--times', type=int, default=0, metavar='N', help='publish N messages')
    parser.add_argument(
        '-w',
        '--wait-matching-subscriptions',
        type=int,
        default=None,
        metavar='N',
        help='wait for N subscriptions first (1 with --once and --times, else 0)',
    )
    parser.add_argument(
        '--max-wait-time-secs',
        type=float,
        default=None,
        metavar='SECONDS',
        help='longest wait for them (none)',
    )
    parser.add_argument(
        '--keep-alive',
        type=float,
        default=0.1,
        metavar='SECONDS',
        help='time to stay after the last message (0.1)',
    )
    parser.add_argument('-n', '--node-name', help='name of the publishing node')
    qos.add_arguments(parser, 'default')


def run(arguments: Namespace) -> None:
    """Publish until enough or interrupted."""
    from rclpy.qos import QoSProfile

    if not arguments.rate > 0.0:
        raise CliError('--rate must be greater than zero')
    if arguments.times < 0 or arguments.print < 1:
        raise CliError('--times must not be negative, and --print at least 1')
    message_class = load(arguments.message_type, 'msg')
    text = sys.stdin.read() if arguments.stdin else arguments.values
    message_from_text(message_class, text)  # errors before anything is made
    count = 1 if arguments.once else arguments.times
    with discovery.command_node(arguments.node_name) as node:
        publisher = node.create_publisher(
            message_class,
            absolute(arguments.topic_name),
            qos.chosen_profile(arguments, QoSProfile(depth=10)),
        )
        _await_subscriptions(publisher, arguments, count)
        print('publisher: beginning loop', flush=True)
        _loop(node, publisher, message_class, text, arguments, count)
        time.sleep(max(0.0, arguments.keep_alive))


def _await_subscriptions(publisher: 'Publisher', arguments: Namespace, count: int) -> None:
    wanted = arguments.wait_matching_subscriptions
    wanted = int(count > 0) if wanted is None else wanted
    start = told = time.monotonic()
    while publisher.get_subscription_count() < wanted:
        now = time.monotonic()
        if arguments.max_wait_time_secs is not None and now > start + arguments.max_wait_time_secs:
            raise CliError(
                f'Timed out waiting for {wanted} matching subscription(s) after '
                f'{arguments.max_wait_time_secs:g} s'
            )
        if now > told:
            print(f'Waiting for at least {wanted} matching subscription(s)...', flush=True)
            told = now + 1.0
        time.sleep(0.02)


def _loop(
    node: 'Node',
    publisher: 'Publisher',
    message_class: Any,
    text: str,
    arguments: Namespace,
    count: int,
) -> None:
    number, due = 0, time.monotonic()
    while not count or number < count:
        message = message_from_text(message_class, text, node.get_clock().now().to_msg())
        publisher.publish(message)
        if number % arguments.print == 0:
            print(f'publishing #{number + 1}: {message!r}\n', flush=True)
        number += 1
        due += 1.0 / arguments.rate
        if not count or number < count:
            time.sleep(max(0.0, due - time.monotonic()))
