"""References of the samples to come, computed for many at once."""

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.control.path import Reference
from lpv.core.control.path_follower import PathFollower

_AHEAD = 128
"""Samples at a time: the cost of a few for all, and too few to delay a sample noticeably."""


class UpcomingReferences:
    """What a follower gives one by one, where samples come evenly, bit for bit.

    ``period`` is the sample time [ns], ``tip`` the number of the tip's coordinates.  ``motion``,
    shape (3, joints), has position, velocity and acceleration of the present reference [rad],
    [rad/s], [rad/s2]; ``reference`` is the same one, in the same memory throughout.
    """

    def __init__(self, follower: PathFollower, period: int, joints: int, tip: int) -> None:
        self._follower, self._period = follower, period
        kind = np.dtype([('motion', 'f8', (3, joints)), ('tip', 'f8', (tip,))])
        self._present, self._block = np.zeros(1, kind), np.zeros(_AHEAD, kind)
        self.motion: np.ndarray = self._present['motion'][0]
        position, velocity, acceleration = self.motion
        self.reference = Reference(position, velocity, acceleration, self._present['tip'][0])
        self._first: int | None = None  # stamp of the block's first row [ns]
        self._last: int | None = None  # stamp of the last reference [ns]

    def advance(self, stamp: int, position: ArrayLike) -> None:
        """Go to what `PathFollower.reference` gives for a stamp [ns] and position."""
        even = self._last is not None and stamp - self._last == self._period
        self._last = stamp
        over = self._first is None or stamp >= self._first + _AHEAD * self._period
        if even and over:
            self._first = stamp
            ahead = self._follower.ahead(stamp + self._period * np.arange(_AHEAD))
            ahead.write(self._block['motion'], self._block['tip'])
        if self._first is not None:
            row, rest = divmod(stamp - self._first, self._period)
            if rest == 0 and 0 <= row < _AHEAD:
                self._present[0] = self._block[row]
                return
        present = self._follower.reference(stamp, position)
        present.write(self._present['motion'], self._present['tip'])

    def stop(self) -> None:
        """As `PathFollower.stop`."""
        self._follower.stop(self._last)
        self._first = self._last = None

    def reset(self) -> None:
        """As `PathFollower.reset`."""
        self._follower.reset()
        self._first = self._last = None
