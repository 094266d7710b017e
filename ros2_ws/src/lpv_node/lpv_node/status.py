"""One node's status on /diagnostics."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from lpv.core.support.timestamps import NANOSECONDS, set_stamp

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def diagnostics(stamp: int, found: Iterable[Mapping[str, Any]]) -> DiagnosticArray:
    """DiagnosticArray with a stamp [ns] of the fields of each status, its values by key."""
    array = DiagnosticArray()
    for fields in found:
        pairs = [KeyValue(key=key, value=str(value)) for key, value in fields['values'].items()]
        level = fields['level'] if isinstance(fields['level'], bytes) else bytes([fields['level']])
        array.status.append(DiagnosticStatus(**{**fields, 'level': level, 'values': pairs}))
    set_stamp(array.header.stamp, max(0, stamp))
    return array


class StatusReporter:
    """Publishes the status of a part of a node when it changes, and every second of its clock."""

    def __init__(self, node: Node, part: str, hardware_id: str) -> None:
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._name, self._arm = f'{node.get_fully_qualified_name()}: {part}', hardware_id
        self._last: tuple[bytes, str] | None = None
        self._due = 0

    def report(
        self, stamp: int, level: bytes, message: str, values: Callable[[], Mapping[str, object]]
    ) -> None:
        """Report a status as of a stamp [ns]; ``values`` are asked for if it is published."""
        if self._last == (level, message) and self._due - NANOSECONDS <= stamp < self._due:
            return
        self._last, self._due = (level, message), stamp + NANOSECONDS
        names = ('level', 'message', 'name', 'hardware_id', 'values')
        fields = dict(zip(names, (level, message, self._name, self._arm, values())))
        self.publisher.publish(diagnostics(stamp, [fields]))
