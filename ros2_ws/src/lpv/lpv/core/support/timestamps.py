"""Time stamps are integers in nanoseconds, as ROS messages carry them."""

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

NEVER = -(2**63)
"""Stamp of what has not happened."""
