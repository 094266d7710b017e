"""Time stamps as integers of nanoseconds, the one form that never rounds."""

import struct

from builtin_interfaces.msg import Time

from lpv.core.support.timestamps import NANOSECONDS

LAST_STAMP = 2**31 * NANOSECONDS - 1


def to_nanoseconds(stamp: Time) -> int:
    """Nanoseconds of a stamp."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp: Time, nanoseconds: int) -> None:
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
