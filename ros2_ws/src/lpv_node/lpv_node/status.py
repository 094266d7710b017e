"""One node's status on /diagnostics."""

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from lpv.core.support.timestamps import NANOSECONDS
from lpv_node.stamps import set_stamp

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class StatusReporter:
    """Publishes a status when it changes, and every second of its clock.

    Parameters
    ----------
    node : rclpy.node.Node
        Owns the publisher.
    part : str
        What the status is of; the node's name is put before it.
    hardware_id : str
        The arm's name.

    Attributes
    ----------
    publisher : rclpy.publisher.Publisher
        Of /diagnostics; an output of the node.
    """

    def __init__(self, node: Node, part: str, hardware_id: str) -> None:
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        name = f'{node.get_fully_qualified_name()}: {part}'
        self._status = DiagnosticStatus(name=name, hardware_id=hardware_id)
        self._last: tuple[bytes, str] | None = None
        self._due = 0

    def report(
        self, stamp: int, level: bytes, message: str, values: Callable[[], Mapping[str, object]]
    ) -> None:
        """Report a status as of a stamp [ns] with a level of diagnostic_msgs/DiagnosticStatus.

        ``values`` is called where the status is published.
        """
        if self._last == (level, message) and self._due - NANOSECONDS <= stamp < self._due:
            return
        self._last, self._due = (level, message), stamp + NANOSECONDS
        self._status.level, self._status.message = level, message
        self._status.values = [KeyValue(key=k, value=str(v)) for k, v in values().items()]
        array = DiagnosticArray(status=[self._status])
        set_stamp(array.header.stamp, max(0, stamp))
        self.publisher.publish(array)
