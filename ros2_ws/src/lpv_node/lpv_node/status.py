"""One node's status on /diagnostics."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from lpv.bag.rosbag.interfaces import standard_types
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.support.timestamps import NANOSECONDS


def diagnostics(stamp: int, status: Iterable[Mapping[str, Any]]) -> bytes:
    """DiagnosticArray with a stamp [ns] of statuses as of `BagMessages`, for a publisher."""
    return BagMessages(standard_types(), '').diagnostics(max(0, stamp), status)


class StatusReporter:
    """Publishes the status of a part of a node when it changes, and every second of its clock."""

    def __init__(self, node: Node, part: str, hardware_id: str) -> None:
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._name, self._arm = f'{node.get_fully_qualified_name()}: {part}', hardware_id
        self._last: tuple[int, str] | None = None
        self._due = 0

    def report(
        self, stamp: int, level: int, message: str, values: Callable[[], Mapping[str, object]]
    ) -> None:
        """Report a status as of a stamp [ns]; ``values`` are asked for if it is published."""
        if self._last == (level, message) and self._due - NANOSECONDS <= stamp < self._due:
            return
        self._last, self._due = (level, message), stamp + NANOSECONDS
        names = ('level', 'message', 'name', 'hardware_id', 'values')
        fields = dict(zip(names, (level, message, self._name, self._arm, values())))
        self.publisher.publish(diagnostics(stamp, [fields]))
