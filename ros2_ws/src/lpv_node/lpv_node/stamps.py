"""Time stamps as integers of nanoseconds, the one form that never rounds."""

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
