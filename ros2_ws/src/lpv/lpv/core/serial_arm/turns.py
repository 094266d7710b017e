"""Positions of joints that turn without end, which drivers give within one turn.

A reading that leaves its range at one end comes back at the other: no joint has moved by a turn,
whatever else its reading does there.  Joints with limits do not wrap; theirs that jump by a turn
are faults.
"""

import math

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.timestamps import NANOSECONDS

TURN = 2.0 * math.pi
FARTHEST = 1e3
"""Readings beyond are no positions of a joint [rad]."""


class Turns:
    """Continues the positions of an arm's joints, batch by batch."""

    def __init__(self, arm: SerialArm) -> None:
        self._endless = np.array([joint.is_endless for joint in arm.joints])
        self._period = arm.sample_time
        self._last = np.full(len(self._endless), math.nan)  # as it came [rad]
        self._turns = np.zeros(len(self._endless))
        self._stamps = np.zeros(len(self._endless), np.int64)  # of these [ns]

    def continued(
        self, stamps: IntArray, position: FloatArray, velocity: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Positions without wraps, and rates that are differences without them.

        Parameters
        ----------
        stamps : ndarray of int64, shape (m,)
            [ns].
        position, velocity : ndarray, shape (m, n)
            Of the joints; NaN where missing [rad], [rad/s].

        Returns
        -------
        position, velocity : ndarray, shape (m, n)
            Of jumps by half a turn to one and a half, a turn is taken out.
        """
        if len(stamps) == 0 or not self._endless.any():
            return position, velocity
        shape = len(stamps) + 1, len(self._endless)
        seen, at = np.empty(shape), np.empty(shape, np.int64)
        seen[0], seen[1:] = self._last, position
        at[0], at[1:] = self._stamps, stamps[:, None]
        with np.errstate(invalid='ignore'):
            finite = np.abs(seen) < FARTHEST
            if not finite.all():  # the last one that there was
                place = np.where(finite, np.arange(len(seen))[:, None], 0)
                place = np.maximum.accumulate(place, axis=0)
                seen = np.take_along_axis(seen, place, axis=0)
                at = np.take_along_axis(at, place, axis=0)
            jump = seen[1:] - seen[:-1]
            size = np.abs(jump)
            wraps = (size > 0.5 * TURN) & (size < 1.5 * TURN) & self._endless
        self._last, self._stamps = seen[-1], at[-1]
        if not (wraps.any() or self._turns.any()):
            return position, velocity
        time = np.maximum((stamps[:, None] - at[:-1]) / NANOSECONDS, self._period)
        whole = np.where(wraps, np.sign(jump), 0.0)
        turns = self._turns + np.cumsum(whole, axis=0)
        self._turns = turns[-1]
        # A rate that is nearer to the jump than to the way is a difference that holds it.
        way, step = jump - TURN * whole, velocity * time
        holds = np.abs(step - jump) < np.abs(step - way)
        return position - TURN * turns, velocity - np.where(holds, TURN * whole / time, 0.0)

    def went_on(self, stamp: int, position: FloatArray) -> None:
        """Continue from positions, shape (n,), that were taken at a stamp [ns] as they came."""
        self._last, self._turns = position.copy(), np.zeros(len(position))
        self._stamps = np.full(len(position), stamp)
