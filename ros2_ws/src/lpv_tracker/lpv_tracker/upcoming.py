"""References of the samples to come, computed for many at once."""

import numpy as np
from numpy.typing import ArrayLike

from lpv_core.control.path import Reference
from lpv_core.control.path_follower import PathFollower

_AHEAD = 64
"""Samples at a time: the cost of one for 64, and too few to delay a sample noticeably."""


class UpcomingReferences:
    """What a follower gives one by one, where samples come evenly, bit for bit.

    Parameters
    ----------
    follower : PathFollower
        Gives the references.
    period : int
        Sample time [ns].
    """

    def __init__(self, follower: PathFollower, period: int) -> None:
        self._follower, self._period = follower, period
        self._block: Reference | None = None
        self._first = 0  # stamp of the block's first row [ns]
        self._last: int | None = None  # stamp of the last reference [ns]

    def reference(self, stamp: int, position: ArrayLike) -> Reference:
        """As `PathFollower.reference`."""
        even = self._last is not None and stamp - self._last == self._period
        self._last = stamp
        over = self._block is None or stamp >= self._first + _AHEAD * self._period
        # On the way to the path the two are the same but for rounding.
        if even and over and self._follower.is_on_path:
            self._first = stamp
            self._block = self._follower.ahead(stamp + self._period * np.arange(_AHEAD))
        row, rest = divmod(stamp - self._first, self._period)
        if self._block is None or rest or not 0 <= row < _AHEAD:
            return self._follower.reference(stamp, position)
        block = self._block
        return Reference(
            block.position[row], block.velocity[row], block.acceleration[row], block.tip[row]
        )

    def stop(self) -> None:
        """As `PathFollower.stop`."""
        self._follower.stop(self._last)
        self._block = self._last = None

    def reset(self) -> None:
        """As `PathFollower.reset`."""
        self._follower.reset()
        self._block = self._last = None
