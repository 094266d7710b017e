"""References of all samples of an offline run, from the path follower of the tracker node."""

import numpy as np

from lpv.core.control.path import Reference, TimedPath
from lpv.core.control.path_follower import APPROACH_SPEED, PathFollower
from lpv.core.support.timestamps import NANOSECONDS


class PathReferences:
    """References of all samples; rows count the samples in which the clock of the path runs.

    Parameters
    ----------
    path : TimedPath
        Of an arm of n joints.
    sample_time : float
        [s].
    count : int
        Number of samples m.
    speed : float, optional
        Fastest joint rate of an approach [rad/s].

    Attributes
    ----------
    motion : ndarray, shape (m, 3, n)
        Joint positions, rates and accelerations [rad], [rad/s], [rad/s2].
    tip : ndarray, shape (m, 2) or (m, 3)
        [m].
    """

    def __init__(
        self, path: TimedPath, sample_time: float, count: int, speed: float = APPROACH_SPEED
    ) -> None:
        self._follower = PathFollower(path, speed)
        # Times as the graph has them, in whole nanoseconds: products k*Ts are some last bits off.
        times = np.rint(np.arange(count) * sample_time * NANOSECONDS)
        self._stamps = times.astype(np.int64)
        self._period = sample_time
        start = path.sample(0.0)
        self.motion = np.empty((count, 3, len(start.position)))
        self.tip = np.empty((count, len(start.tip)))
        self._set(0, start)

    def restart(self, first: int, position: np.ndarray) -> None:
        """From row ``first`` on, references of a loop that starts, or goes on after a stop."""
        if self._follower.running:
            self._follower.stop(round((first - 1) * self._period * NANOSECONDS))
        self._follower.reference(int(self._stamps[first]), position)
        self._set(first, self._follower.ahead(self._stamps[first:]))

    def _set(self, first: int, reference: Reference) -> None:
        self.motion[first:, 0] = reference.position
        self.motion[first:, 1] = reference.velocity
        self.motion[first:, 2] = reference.acceleration
        self.tip[first:] = reference.tip
