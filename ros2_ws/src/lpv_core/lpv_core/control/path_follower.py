"""References along a path for an arm that is not where the path is: approach, then follow."""

import math

import numpy as np

from lpv_core.control.path import Reference
from lpv_core.model.kinematics import forward
from lpv_core.support.timestamps import NANOSECONDS

_NEAR = 0.05
"""A start within so many radians of the path needs no approach: noise and a resting controller's
error are smaller, and torques stay small."""
_RAMP = 0.5
"""Time in which the path picks up its speed after a stop on the way [s]."""
_SHORTEST = 1.0
"""Least time of an approach [s]: a short way in less asks for torques that throw an upright arm
far if one of them is held for too long."""
_UNHEEDED = 0.02
"""Way of the reference, with the arm at rest, from which commands are taken for lost [rad]."""
_MOVED = 0.01
"""Way of an arm that follows, from where it was found: above the noise of estimates [rad]."""


class PathGuide:
    """What the tracking loop follows when.

    The clock of the path starts at the first reference and stands still while the loop is stopped.
    An arm that is elsewhere when the loop (re)starts is led to the path's present point first, in
    joint space, from rest to rest by a quintic; then the path goes on, with its speed ramped up if
    it is on the way.  A start near the beginning of the path follows it at once.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    path : CartesianPath
        Its path.
    speed : float, optional
        Fastest joint rate of an approach [rad/s].
    """

    def __init__(self, arm, path, speed: float = 0.5) -> None:
        self._arm, self._path, self._speed = arm, path, speed
        self.reset()

    def reset(self) -> None:
        """Forget how far the path has been followed: it starts anew."""
        self._since = None
        self._reached = 0.0
        self._heeded = False

    def stop(self, stamp: int | None = None) -> None:
        """Stop the clock of the path until the next reference.

        Parameters
        ----------
        stamp : int, optional
            Of the last reference that was followed, where they were taken from `ahead` [ns].
        """
        if stamp is not None and self._since is not None:
            time = (stamp - self._since) / NANOSECONDS - self._approach
            if time >= 0.0:
                self._reached = float(self._progress(np.array([time]))[0][0])
        self._since = None

    @property
    def running(self) -> bool:
        """Whether references are being given: neither stopped nor yet to start."""
        return self._since is not None

    def reference(self, stamp: int, position: np.ndarray):
        """Reference at a time.

        Parameters
        ----------
        stamp : int
            Time, never less than before except after `reset` or `stop` [ns].
        position : array_like, shape (2,)
            Where the arm is, in joint coordinates; only used when the loop (re)starts [rad].

        Returns
        -------
        lpv_core.control.path.Reference
            Arrays of shape (2,).
        """
        if self._since is None:
            self._start(stamp, np.asarray(position, float))
        time = (stamp - self._since) / NANOSECONDS
        if time < self._approach:
            return self._lead(time / self._approach)
        return self._follow(time - self._approach)

    def ahead(self, stamps: np.ndarray):
        """References at many times after the present start, as `reference` gives them one by one.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            Times [ns].

        Returns
        -------
        lpv_core.control.path.Reference
            Arrays of shape (n, 2).
        """
        time = (stamps - self._since) / NANOSECONDS - self._approach
        reached, pace, change = self._progress(np.maximum(time, 0.0))
        on_path = self._path.sample(reached)
        pace, change = pace[:, None], change[:, None]
        result = Reference(
            on_path.position,
            pace * on_path.velocity,
            pace**2 * on_path.acceleration + change * on_path.velocity,
            on_path.tip,
        )
        leading = np.flatnonzero(time < 0.0)
        if len(leading):
            led = self._lead(1.0 + time[leading, None] / self._approach)
            for name in ('position', 'velocity', 'acceleration', 'tip'):
                getattr(result, name)[leading] = getattr(led, name)
        return result

    def _progress(self, time):
        """How far the path is so long after the approach [s], its pace, and the pace's rate."""
        ramp = self._ramp
        share = np.minimum(time / ramp, 1.0) if ramp else np.ones_like(time)
        on_ramp = self._from + ramp * (share**3 - 0.5 * share**4)
        reached = np.where(share < 1.0, on_ramp, self._from + (time - 0.5 * ramp))
        change = 6.0 * share * (1.0 - share) / ramp if ramp else np.zeros_like(time)
        return reached, share**2 * (3.0 - 2.0 * share), change

    @property
    def is_on_path(self) -> bool:
        """Whether the path itself is followed: the present start has no approach and no ramp."""
        return self._approach == 0.0 and self._ramp == 0.0

    def arm_not_following(self, reference, position: np.ndarray) -> bool:
        """Whether the arm has stood still since the start although the reference has moved on.

        Commands then do not arrive: the drives still brake.  To go on would build up torque for
        the moment in which they are heard; the loop had better stop and start again.

        Parameters
        ----------
        reference : lpv_core.control.path.Reference
            The present one.
        position : array_like, shape (2,)
            Where the arm is, in joint coordinates [rad].

        Returns
        -------
        bool
            False for good once the arm has moved.
        """
        self._heeded |= bool(np.abs(position - self._stood).max() > _MOVED)
        way = np.abs(reference.position - self._first).max()
        return bool(not self._heeded and way > _UNHEEDED)

    def _start(self, stamp, position) -> None:
        self._since, self._from = stamp, self._reached
        self._heeded = False
        self._offset = position - self._path.sample(self._from).position
        distance = float(np.abs(self._offset).max())
        resting = not self._path.start < self._from < self._path.end
        self._ramp = 0.0 if resting else _RAMP
        # The peak rate of the quintic is 15/8 of its mean.
        self._approach = max(1.875 * distance / self._speed, _SHORTEST) if distance > _NEAR else 0.0
        self._stood, self._first = position, position
        if not self._approach:
            self._first = position - self._offset

    def _lead(self, share):
        """On the way from where the arm was found to the path: a share of the approach's time."""
        left = 1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        rate = -30.0 * (share * (1.0 - share)) ** 2 / self._approach
        bend = -60.0 * share * (1.0 - share) * (1.0 - 2.0 * share) / self._approach**2
        position = self._path.sample(self._from).position + left * self._offset
        return Reference(position, rate * self._offset, bend * self._offset, self._tip(position))

    def _tip(self, position):
        # Kinematics count q1 from the x-axis, which is -pi/2 from the upper vertical.
        turned = position + np.array([self._arm.zero_angle + 0.5 * math.pi, 0.0])
        return forward(turned, self._arm.lengths)

    def _follow(self, time):
        """Along the path, so long after the approach [s]."""
        if time >= self._ramp:
            self._reached = self._from + (time - 0.5 * self._ramp)
            return self._path.sample(self._reached)
        reached, pace, change = (float(v[0]) for v in self._progress(np.array([time])))
        self._reached = reached
        on_path = self._path.sample(reached)
        return Reference(
            on_path.position,
            pace * on_path.velocity,
            pace**2 * on_path.acceleration + change * on_path.velocity,
            on_path.tip,
        )
