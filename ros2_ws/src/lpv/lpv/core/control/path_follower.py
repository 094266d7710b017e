"""References along a path for an arm that is not where the path is: approach, then follow."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.control.path import Reference, SerialPath
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.limits import SMALL
from lpv.core.support.timestamps import NANOSECONDS

APPROACH_SPEED = 0.5
"""Fastest joint rate on the way to a path, unless another one is asked for [rad/s]."""
_RAMP = 0.5
"""Time in which the path picks up its speed after a stop on the way [s]."""
APPROACH = 1.0
"""Least time of an approach [s]: a short distance in less time asks for torques that throw an
upright arm far if one of them is held for too long."""
_SHARE = 0.8
"""Of the speed at which the tracker stops the arm, in an approach: what rates exceed by noise and
overshoot."""
_FIELDS = ('position', 'velocity', 'acceleration', 'tip')


def approach_speeds(arm: SerialArm, allowed: float, speed: float = APPROACH_SPEED) -> np.ndarray:
    """Fastest rate of each joint in an approach, shape (n,) [rad/s].

    ``allowed`` is the share of the velocity limits beyond which the tracker stops the arm; of a
    prismatic joint ``speed`` counts times its `SerialJoint.scale`, as limits of its error do.
    """
    return np.minimum(speed * arm.scales(), _SHARE * allowed * np.array(arm.velocity_limit))


class PathFollower:
    """Reference of the tracking loop over time.

    The clock of the path starts at the first reference and stands still while the loop is stopped.
    An arm that is elsewhere when the loop (re)starts is led to the path's present point first, in
    joint space, from rest to rest by a quintic; then the path goes on, with its speed ramped up if
    the point is not an end of the path.  A start near the path follows it at once.  ``speed`` is
    the fastest rate of an approach, of all joints or of each, and ``scale`` what counts as 1 rad.
    """

    def __init__(
        self, path: SerialPath, speed: ArrayLike = APPROACH_SPEED, scale: ArrayLike = 1.0
    ) -> None:
        self._path, self._speed, self._scale = path, np.asarray(speed), np.asarray(scale)
        self.reset()

    def reset(self) -> None:
        """Return to the start of the path."""
        self._start: int | None = None  # stamp of the first reference since the last stop [ns]
        self._last = 0  # of the last reference [ns]
        self._reached = 0.0  # time on the path's clock [s]

    def stop(self, stamp: int | None = None) -> None:
        """Stop the clock of the path until the next reference.

        ``stamp`` [ns] is that of the last reference followed, where they were taken from `ahead`.
        """
        if self._start is not None:
            time = self._time(self._last if stamp is None else stamp)
            if time >= 0.0:
                self._reached = float(self._progress(np.array([time]))[0][0])
        self._start = None

    @property
    def running(self) -> bool:
        """Whether references are being given: neither stopped nor yet to start."""
        return self._start is not None

    def reference(self, stamp: int, position: ArrayLike) -> Reference:
        """Reference at a time [ns], never less than before except after `reset` or `stop`.

        ``position`` is where the arm is, in joint coordinates [rad].
        """
        if self._start is None:
            self._restart(stamp, np.asarray(position, float))
        self._last = stamp
        rows = self.ahead(np.array([stamp]))
        return Reference(rows.position[0], rows.velocity[0], rows.acceleration[0], rows.tip[0])

    def ahead(self, stamps: np.ndarray) -> Reference:
        """References at times [ns] after the present start, those of `reference` bit for bit."""
        time = self._time(stamps)
        result = self._on_path(*self._progress(np.maximum(time, 0.0)))
        approaching = np.flatnonzero(time < 0.0)
        if len(approaching):
            share = 1.0 + time[approaching, None] / self._approach
            references = self._approach_at(share)
            for name in _FIELDS:
                getattr(result, name)[approaching] = getattr(references, name)
        return result

    def _time(self, stamps: Any) -> Any:
        """Time after the approach [s] at stamps [ns]."""
        return (stamps - self._start) / NANOSECONDS - self._approach

    def _restart(self, stamp: int, position: np.ndarray) -> None:
        self._start, self._from = stamp, self._reached
        self._offset = position - self._path.sample(self._from).position
        distance = np.abs(self._offset)
        is_near = bool((distance <= SMALL * self._scale).all())
        at_end = not self._path.start < self._from < self._path.end
        self._ramp = 0.0 if at_end else _RAMP
        # The peak rate of the quintic is 15/8 of its mean.
        longest = float((1.875 * distance / self._speed).max())
        self._approach = 0.0 if is_near else max(longest, APPROACH)

    def _approach_at(self, share: np.ndarray) -> Reference:
        """Between where the arm was found and the path, at shares of the approach's time."""
        # Products: a power of an array may round otherwise than one of its elements.
        left = 1.0 - share * share * share * (10.0 - 15.0 * share + 6.0 * share * share)
        rest = share * (1.0 - share)
        rate = -30.0 * rest * rest / self._approach
        bend = -60.0 * rest * (1.0 - 2.0 * share) / (self._approach * self._approach)
        position = self._path.sample(self._from).position + left * self._offset
        tip = self._path.tip(position)
        return Reference(position, rate * self._offset, bend * self._offset, tip)

    def _progress(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time on the path's clock [s] after the approach, its pace [1], the pace's rate [1/s]."""
        ramp = self._ramp
        share = np.minimum(time / ramp, 1.0) if ramp else np.ones_like(time)
        on_ramp = self._from + ramp * share * share * share * (1.0 - 0.5 * share)
        reached = np.where(share < 1.0, on_ramp, self._from + (time - 0.5 * ramp))
        change = 6.0 * share * (1.0 - share) / ramp if ramp else np.zeros_like(time)
        return reached, share * share * (3.0 - 2.0 * share), change

    def _on_path(self, reached: np.ndarray, pace: np.ndarray, change: np.ndarray) -> Reference:
        """References at times of the path's clock that runs at a changing pace."""
        on_path = self._path.sample(reached)
        pace, change = pace[:, None], change[:, None]
        return Reference(
            on_path.position,
            pace * on_path.velocity,
            pace * pace * on_path.acceleration + change * on_path.velocity,
            on_path.tip,
        )
