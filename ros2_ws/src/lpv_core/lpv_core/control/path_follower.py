"""References along a path for an arm that is not where the path is: approach, then follow."""

import numpy as np
from numpy.typing import ArrayLike

from lpv_core.control.path import Reference, TimedPath
from lpv_core.support.timestamps import NANOSECONDS

_NEAR = 0.05
"""A start this near to the path needs no approach [rad]: noise and a resting controller's error are
smaller, and torques stay small."""
_RAMP = 0.5
"""Time in which the path picks up its speed after a stop on the way [s]."""
_SHORTEST = 1.0
"""Least time of an approach [s]: a short distance in less time asks for torques that throw an
upright arm far if one of them is held for too long."""
_FIELDS = ('position', 'velocity', 'acceleration', 'tip')


class PathFollower:
    """Reference of the tracking loop over time.

    The clock of the path starts at the first reference and stands still while the loop is stopped.
    An arm that is elsewhere when the loop (re)starts is led to the path's present point first, in
    joint space, from rest to rest by a quintic; then the path goes on, with its speed ramped up if
    the point is not an end of the path.  A start near the path follows it at once.

    Parameters
    ----------
    path : TimedPath
        Of an arm of any number of joints n.
    speed : float, optional
        Fastest joint rate of an approach [rad/s].
    """

    def __init__(self, path: TimedPath, speed: float = 0.5) -> None:
        self._path, self._speed = path, speed
        self.reset()

    def reset(self) -> None:
        """Return to the start of the path."""
        self._start: int | None = None  # stamp of the first reference since the last stop [ns]
        self._reached = 0.0  # time on the path's clock [s]

    def stop(self, stamp: int | None = None) -> None:
        """Stop the clock of the path until the next reference.

        Parameters
        ----------
        stamp : int, optional
            Of the last reference that was followed, where they were taken from `ahead` [ns].
        """
        if stamp is not None and self._start is not None:
            time = (stamp - self._start) / NANOSECONDS - self._approach
            if time >= 0.0:
                self._reached = float(self._progress(np.array([time]))[0][0])
        self._start = None

    @property
    def running(self) -> bool:
        """Whether references are being given: neither stopped nor yet to start."""
        return self._start is not None

    @property
    def is_on_path(self) -> bool:
        """Whether the path itself is followed: the present start has no approach and no ramp."""
        return self._approach == 0.0 and self._ramp == 0.0

    def reference(self, stamp: int, position: ArrayLike) -> Reference:
        """Reference at a time.

        Parameters
        ----------
        stamp : int
            Time, never less than before except after `reset` or `stop` [ns].
        position : array_like, shape (n,)
            Where the arm is, in joint coordinates [rad].

        Returns
        -------
        Reference
            Of one time.
        """
        start = self._start
        if start is None:
            start = stamp
            self._restart(stamp, np.asarray(position, float))
        time = (stamp - start) / NANOSECONDS
        if time < self._approach:
            return self._approach_at(time / self._approach)
        return self._follow(time - self._approach)

    def ahead(self, stamps: np.ndarray) -> Reference:
        """References at many times after the present start, as `reference` gives them one by one.

        Parameters
        ----------
        stamps : ndarray of int64, shape (m,)
            Times [ns].

        Returns
        -------
        Reference
            Of m times.
        """
        time = (stamps - self._start) / NANOSECONDS - self._approach
        result = self._on_path(*self._progress(np.maximum(time, 0.0)))
        approaching = np.flatnonzero(time < 0.0)
        if len(approaching):
            share = 1.0 + time[approaching, None] / self._approach
            references = self._approach_at(share)
            for name in _FIELDS:
                getattr(result, name)[approaching] = getattr(references, name)
        return result

    def _restart(self, stamp: int, position: np.ndarray) -> None:
        self._start, self._from = stamp, self._reached
        self._offset = position - self._path.sample(self._from).position
        distance = float(np.abs(self._offset).max())
        at_end = not self._path.start < self._from < self._path.end
        self._ramp = 0.0 if at_end else _RAMP
        # The peak rate of the quintic is 15/8 of its mean.
        self._approach = max(1.875 * distance / self._speed, _SHORTEST) if distance > _NEAR else 0.0

    def _approach_at(self, share: float | np.ndarray) -> Reference:
        """Between where the arm was found and the path, at a share of the approach's time."""
        left = 1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        rate = -30.0 * (share * (1.0 - share)) ** 2 / self._approach
        bend = -60.0 * share * (1.0 - share) * (1.0 - 2.0 * share) / self._approach**2
        position = self._path.sample(self._from).position + left * self._offset
        tip = self._path.tip(position)
        return Reference(position, rate * self._offset, bend * self._offset, tip)

    def _follow(self, time: float) -> Reference:
        """Along the path, at a time after the approach [s]."""
        if time >= self._ramp:
            self._reached = self._from + (time - 0.5 * self._ramp)
            return self._path.sample(self._reached)
        progress = [float(v[0]) for v in self._progress(np.array([time]))]
        self._reached = progress[0]
        return self._on_path(*progress)

    def _progress(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time on the path's clock [s] after the approach, its pace [1], the pace's rate [1/s]."""
        ramp = self._ramp
        share = np.minimum(time / ramp, 1.0) if ramp else np.ones_like(time)
        on_ramp = self._from + ramp * (share**3 - 0.5 * share**4)
        reached = np.where(share < 1.0, on_ramp, self._from + (time - 0.5 * ramp))
        change = 6.0 * share * (1.0 - share) / ramp if ramp else np.zeros_like(time)
        return reached, share**2 * (3.0 - 2.0 * share), change

    def _on_path(self, reached: ArrayLike, pace: ArrayLike, change: ArrayLike) -> Reference:
        """References at times of the path's clock that runs at a changing pace."""
        on_path = self._path.sample(reached)
        pace, change = np.asarray(pace)[..., None], np.asarray(change)[..., None]
        return Reference(
            on_path.position,
            pace * on_path.velocity,
            pace**2 * on_path.acceleration + change * on_path.velocity,
            on_path.tip,
        )
