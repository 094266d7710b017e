"""What the nodes reported of themselves on /diagnostics."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv.bag.errors import BagError
from lpv.bag.rosbag.reading import open_bag
from lpv.core.support.timestamps import to_nanoseconds

_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


@dataclass(frozen=True)
class NodeReport:
    """One status of a node."""

    stamp: int  # [ns]
    level: int  # as in diagnostic_msgs/DiagnosticStatus
    message: str  # its text


def node_reports(path: str | Path, namespace: str) -> dict[str, list[NodeReport]]:
    """Reports of one namespace's nodes by stamp, of ``observer``, ``tracking`` and ``drives``."""
    found: dict[str, list[NodeReport]] = {}
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.msgtype == _TYPE]
        for connection, _, data in reader.messages(connections) if connections else ():
            message = reader.deserialize(data, connection.msgtype)
            stamp = to_nanoseconds(message.header.stamp)
            for status in message.status:
                parent, _, name = status.name.rpartition('/')
                _, colon, part = name.partition(': ')
                if parent == namespace.rstrip('/') and colon:
                    report = NodeReport(stamp, _level(status.level), status.message)
                    found.setdefault(part, []).append(report)
    return {part: sorted(reports, key=lambda r: r.stamp) for part, reports in found.items()}


def _level(value: Any) -> int:
    """Levels are bytes in some versions of the definition and numbers in others."""
    if isinstance(value, (bytes, bytearray)):
        if len(value) != 1:
            raise BagError(f'diagnostics: a level has {len(value)} bytes')
        return value[0]
    return int(value)
