"""What echo, hz and bw share: a topic's type, and receiving until enough or interrupted."""

import time
from argparse import Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph.names import absolute, find_topic
from lpv_ros2cli.message.types import load

if TYPE_CHECKING:
    from rclpy.node import Node


def topic_and_class(node: 'Node', arguments: Namespace) -> tuple[str, Any]:
    """Topic, and the class of its messages."""
    if getattr(arguments, 'message_type', None):
        return absolute(arguments.topic_name), load(arguments.message_type, 'msg')
    name, types = find_topic(node, arguments.topic_name, arguments.spin_time)
    if len(types) > 1:
        raise CliError(f"Topic '{name}' has more than one type: {', '.join(types)}; give one")
    return name, load(types[0], 'msg')


def receive(
    node: 'Node', done: Callable[..., Any] = lambda: False, timeout: float | None = None
) -> bool:
    """Take messages until enough."""
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline = None if timeout is None else time.monotonic() + timeout
    try:
        while not done():
            if deadline is not None and time.monotonic() > deadline:
                return False
            executor.spin_once(timeout_sec=0.1)  # short: SIGINT is seen in between
        return True
    finally:
        executor.remove_node(node)
        executor.shutdown()
