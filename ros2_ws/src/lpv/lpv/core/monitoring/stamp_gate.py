"""Tells a clock that was set from single stamps that fit no stream."""

from lpv.core.support.timestamps import NANOSECONDS

JUMP = NANOSECONDS
"""Stamps of one stream are never further apart, but where its clock was set [ns]."""
CONFIRMATIONS = 3
"""Successive stamps after a jump that show that the clock was set."""


class StampGate:
    """Gate for the stamps of one stream.

    A stamp that is further than `JUMP` from the newest one is refused, until `CONFIRMATIONS` of
    them follow one another: the clock was set then, or samples were missing for long.

    ``last`` is the newest stamp that was accepted [ns], of the new clock once that was set.
    ``shift`` is the difference of the last two stamps that were accepted if the clock was set in
    between, else 0 [ns].
    """

    def __init__(self) -> None:
        self.last: int | None = None
        self.shift = 0
        self._jump, self._count = 0, 0

    def accept(self, stamp: int) -> bool:
        """Whether a stamp [ns] is of the stream, or the clock of the stream was set for good."""
        self.shift = 0
        if self.last is None or abs(stamp - self.last) <= JUMP:
            self.follow(stamp if self.last is None else max(stamp, self.last))
            return True
        follows = self._count > 0 and 0 < stamp - self._jump <= JUMP
        self._jump, self._count = stamp, self._count + 1 if follows else 1
        if self._count < CONFIRMATIONS:
            return False
        self.shift = stamp - self.last
        self.follow(stamp)
        return True

    def follow(self, stamp: int) -> None:
        """Take a stamp [ns] that follows the last one."""
        self.last, self._count = stamp, 0
