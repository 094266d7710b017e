"""The observer's own reports on /diagnostics."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv_bag.errors import BagError
from lpv_bag.rosbag.reading import open_bag
from lpv_bag.run.record import stamp_of

_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'
_OBSERVER = ': observer'


@dataclass(frozen=True)
class ObserverReport:
    """One report of an observer."""

    stamp: int  # [ns]
    level: int  # as in diagnostic_msgs/DiagnosticStatus
    message: str  # its text


def observer_reports(path: str | Path, namespace: str) -> list[ObserverReport]:
    """Reports of the observer in one namespace.

    Parameters
    ----------
    path : str or pathlib.Path
        Bag.
    namespace : str
        Namespace of the observer's node, e.g. ``/lpv``.

    Returns
    -------
    list of ObserverReport
        In the order of their stamps; empty where none were recorded.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    found = []
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.msgtype == _TYPE]
        for connection, _, data in reader.messages(connections) if connections else ():
            message = reader.deserialize(data, connection.msgtype)
            for status in message.status:
                parent, _, name = status.name.rpartition('/')
                if parent == namespace.rstrip('/') and name.endswith(_OBSERVER):
                    found.append(
                        ObserverReport(
                            stamp_of(message.header.stamp), _level(status.level), status.message
                        )
                    )
    return sorted(found, key=lambda report: report.stamp)


def _level(value: Any) -> int:
    """Levels are bytes in some versions of the definition and numbers in others."""
    if isinstance(value, (bytes, bytearray)):
        if len(value) != 1:
            raise BagError(f'diagnostics: a level has {len(value)} bytes')
        return value[0]
    return int(value)
