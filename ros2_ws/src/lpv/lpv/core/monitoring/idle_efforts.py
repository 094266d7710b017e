"""Efforts, or rates, of drivers that measure none and publish zeros."""

import numpy as np

from lpv.core.serial_arm.chain import BoolArray, FloatArray
from lpv.core.serial_arm.diagnosis.sampler import ROUNDING


def without_efforts(
    position: FloatArray, effort: FloatArray, start: FloatArray, least: FloatArray | float
) -> tuple[BoolArray, BoolArray]:
    """Whether each joint has left ``start`` by ``least`` up to each sample; whether efforts came.

    Efforts that are 0 in motion, and always were, are not measured; an arm that rests on its brakes
    needs none.  Positions, efforts and both answers have shape (samples, n).
    """
    moved = np.abs(position - start) > least
    given = (np.abs(effort) > ROUNDING) & np.isfinite(position).any(1, keepdims=True)
    return np.logical_or.accumulate(moved), np.logical_or.accumulate(given)


class IdleSignal:
    """Efforts or rates of a driver, as long as all were 0; ``least`` as of `without_efforts`.

    Efforts of some joints that are 0 for so many samples (``patience``) after others were not are
    not measured, either: what waits for the first of them is one row of the balances, and little is
    lost at rest.  A rate of a joint that rests is 0: None waits for ever.
    """

    def __init__(self, least: FloatArray, patience: int | None = None, given: bool = False) -> None:
        self._least, self._patience = least, patience
        self._given = np.full(len(least), given)  # which were other than 0
        self._others = 0  # samples since any was
        self._first: FloatArray | None = None  # positions of the first measurement
        self._has_moved = False  # from there, before any other came

    def leave_out(self, position: FloatArray, values: FloatArray) -> int:
        """Make values NaN that are not measured but 0; the first sample without any, or -1."""
        if self._given.all() or (self._patience is None and self._given.any()):
            return -1
        read = np.isfinite(position).any(1)
        if not read.any():
            return -1
        if self._first is None:
            self._first = position[read.argmax()].copy()
        moved, given = without_efforts(position, values, self._first, self._least)
        given |= self._given
        some, had_moved = given.any(1, keepdims=True), self._has_moved
        others = self._others + np.cumsum(some, axis=0)
        idle = (moved.any(1, keepdims=True) | had_moved) & ~some
        idle &= np.isfinite(values).any(1, keepdims=True)
        late = others > (np.inf if self._patience is None else self._patience)
        values[~given & (idle | late)] = np.nan
        self._given, self._others = given[-1].copy(), int(others[-1, 0])
        self._has_moved = had_moved or bool(idle.any())
        return int(idle.argmax()) if self._has_moved and not had_moved else -1
