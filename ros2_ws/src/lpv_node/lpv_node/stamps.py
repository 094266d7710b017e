"""Time stamps as integers of nanoseconds, the one form that never rounds."""

from builtin_interfaces.msg import Time

from lpv_core.support.timestamps import NANOSECONDS


def to_nanoseconds(stamp: Time) -> int:
    """Nanoseconds of a stamp."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp: Time, nanoseconds: int) -> None:
    """Write nanoseconds, not negative, into a stamp."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)
