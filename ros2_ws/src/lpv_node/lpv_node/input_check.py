"""Messages that a node refuses: wrong sizes, values that are not finite, foreign stamps."""

import math
import time
from collections.abc import Iterable, Sized
from itertools import chain

from rclpy.node import Node

from lpv_core.support.timestamps import NANOSECONDS

_JUMP = NANOSECONDS
"""Stamps of one stream are never further apart, but where its time restarts [ns]."""
_QUIET = 5.0
"""Time between two lines of one reason [s]."""
_CONFIRMATIONS = 3
"""Successive stamps after a jump that show that time has restarted."""


def all_finite(*fields: Iterable[float]) -> bool:
    """Whether all elements of some number fields are finite."""
    return all(map(math.isfinite, chain.from_iterable(fields)))


def all_sized(count: int, *fields: Sized) -> bool:
    """Whether some fields have one element for each of the arm's joints."""
    return {*map(len, fields)} == {count}


class StampGuard:
    """Tells a stream whose time restarts from single stamps of another sender."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._jump, self._count = 0, 0

    def accept(self, stamp: int) -> bool:
        """Whether a stamp [ns] continues the stream, or one that has restarted for good."""
        if self._last is not None and abs(stamp - self._last) > _JUMP:
            follows = self._count > 0 and 0 < stamp - self._jump < _JUMP
            self._jump, self._count = stamp, self._count + 1 if follows else 1
            if self._count < _CONFIRMATIONS:
                return False
        self._last, self._count = stamp, 0
        return True


class Refusals:
    """Counts refused messages by their reason, and logs each reason at most every 5 s."""

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._logged: dict[str, float] = {}
        self._last = -math.inf
        self.counts: dict[str, int] = {}

    def add(self, reason: str) -> None:
        """Count one message."""
        self._last = now = time.monotonic()
        self.counts[reason] = self.counts.get(reason, 0) + 1
        if now - self._logged.get(reason, -math.inf) > _QUIET:
            self._logged[reason] = now
            self._logger.warning(f'refused: {reason} ({self.counts[reason]} so far)')

    @property
    def is_recent(self) -> bool:
        """Whether a message was refused in the last seconds."""
        return time.monotonic() - self._last < _QUIET
