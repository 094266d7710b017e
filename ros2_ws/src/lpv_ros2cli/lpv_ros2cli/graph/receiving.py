"""What echo, hz, bw and delay share: types of topics, filters, and receiving until interrupted."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.command_line.expressions import Expression
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import absolute
from lpv_ros2cli.message.types import load

if TYPE_CHECKING:
    from rclpy.node import Node

_POLL = 0.1
"""Pause between two looks for a topic that is not there yet [s]."""


def topic_class(
    node: 'Node', topic_name: str, spin_time: float | None, wait: bool = True
) -> tuple[str, Any]:
    """Absolute name of a topic, and the class of its messages; waits until it is published.

    Without ``wait``, a topic that is not found is an error.
    """
    name = absolute(topic_name)

    def types_there() -> list[str] | None:
        return dict(node.get_topic_names_and_types()).get(name)

    types = discovery.find(node, types_there, spin_time)
    if not types:
        print(f'WARNING: topic [{topic_name}] does not appear to be published yet', flush=True)
        if not wait:
            raise CliError('Could not determine the type for the passed topic')
        while not (types := types_there()):
            time.sleep(_POLL)
    if len(types) > 1:
        raise CliError(
            f"Cannot echo topic '{topic_name}', as it contains more than one type: "
            f'[{", ".join(types)}]'
        )
    return name, load(types[0], 'msg')


def message_filter(text: str | None) -> Callable[[Any], bool]:
    """Condition of ``--filter`` on a message ``m``."""
    if text is None:
        return lambda _message: True
    expression = Expression(text, '--filter')
    return lambda message: bool(expression.value({'m': message}))


class Reception:
    """Receives messages of a node's subscriptions until enough, or until a callback fails."""

    def __init__(self, node: 'Node') -> None:
        self._node = node
        self._error: CliError | None = None

    def subscribe(
        self, message_class: Any, name: str, callback: Callable[..., None], profile: Any, raw: bool
    ) -> None:
        """Subscribe; a CliError of the callback ends `run` with that error."""

        def guarded(message: Any) -> None:
            try:
                if self._error is None:
                    callback(message)
            except CliError as error:
                self._error = error

        self._node.create_subscription(message_class, name, guarded, profile, raw=raw)

    def run(self, done: Callable[[], object] = lambda: False, timeout: float | None = None) -> bool:
        """Receive until ``done``; False after the timeout."""
        from rclpy.executors import SingleThreadedExecutor

        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        deadline = None if timeout is None else time.monotonic() + timeout
        try:
            while not done():
                if deadline is not None and time.monotonic() > deadline:
                    return False
                executor.spin_once(timeout_sec=0.1)  # short: SIGINT is seen in between
                if self._error is not None:
                    raise self._error
            return True
        finally:
            executor.remove_node(self._node)
            executor.shutdown()
