"""What the nodes reported of themselves on /diagnostics."""

from dataclasses import dataclass
from pathlib import Path

from lpv.bag.rosbag.reading import open_bag
from lpv.core.support.timestamps import to_nanoseconds

_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'


@dataclass(frozen=True)
class NodeReport:
    """One status of a node."""

    stamp: int  # [ns]
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
                    found.setdefault(part, []).append(NodeReport(stamp, status.message))
    return {part: sorted(reports, key=lambda r: r.stamp) for part, reports in found.items()}
