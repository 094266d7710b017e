"""Time stamps are integers in nanoseconds: the one form that never rounds."""

import struct
from typing import Any

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

NEVER = -(2**63)
"""Stamp of what has not happened."""

LAST_STAMP = 2**31 * NANOSECONDS - 1
"""Last stamp that a message can carry."""


def to_nanoseconds(stamp: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time, as nodes or rosbags give it."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp: Any, nanoseconds: int) -> None:
    """Write nanoseconds into a stamp, the last one of its type if they are more."""
    # Stamps of others may have more than a second in their nanoseconds.
    stamp.sec, stamp.nanosec = divmod(min(nanoseconds, LAST_STAMP), NANOSECONDS)


def leading_stamp(data: bytes) -> int | None:
    """Stamp of a CDR message whose first field is a Header or a Time."""
    if len(data) < 12:
        return None
    order = '<' if data[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(order + 'iI', data, 4)
    return seconds * NANOSECONDS + nanoseconds
