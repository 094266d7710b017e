"""Time stamps as integers of nanoseconds, the one form that never rounds."""

from lpv_core.support.timestamps import NANOSECONDS


def to_nanoseconds(stamp) -> int:
    """Nanoseconds of a builtin_interfaces/Time.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        The stamp.

    Returns
    -------
    int
        [ns].
    """
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp, nanoseconds: int) -> None:
    """Write nanoseconds into a builtin_interfaces/Time.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Written to.
    nanoseconds : int
        [ns], not negative.
    """
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)
