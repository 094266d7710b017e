"""What echo, hz and bw share: a topic's type, and receiving until enough or interrupted."""

import time
from collections.abc import Callable
from typing import Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.interfaces import load
from lpv_ros2cli.names import absolute, find_topic


def topic_and_class(node, arguments):
    """Topic, and the class of its messages.

    Parameters
    ----------
    node : rclpy.node.Node
        Looks.
    arguments : argparse.Namespace
        With ``topic_name``, ``spin_time`` and perhaps ``message_type``: with a type that was
        given, the topic need not be there yet.

    Returns
    -------
    name : str
        Absolute name.
    message_class : type
        Class.

    Raises
    ------
    CliError
        If there is no such topic, it has several types, or the type is not installed.
    """
    if getattr(arguments, 'message_type', None):
        return absolute(arguments.topic_name), load(arguments.message_type, 'msg')
    name, types = find_topic(node, arguments.topic_name, arguments.spin_time)
    if len(types) > 1:
        raise CliError(f"Topic '{name}' has more than one type: {', '.join(types)}; give one")
    return name, load(types[0], 'msg')


def receive(node, done: Callable[..., Any] = lambda: False, timeout: float | None = None) -> bool:
    """Take messages until enough.

    Parameters
    ----------
    node : rclpy.node.Node
        With subscriptions.
    done : callable, optional
        Whether it is enough.
    timeout : float, optional
        Longest time [s].

    Returns
    -------
    bool
        False after the timeout.
    """
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
