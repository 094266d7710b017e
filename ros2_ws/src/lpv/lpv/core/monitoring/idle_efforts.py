"""Efforts, or rates, of drivers that measure none and publish zeros."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.sampler import ROUNDING


def without_efforts(
    position: FloatArray, effort: FloatArray, start: FloatArray, least: FloatArray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Whether joints have left ``start`` by ``least`` up to each sample; whether efforts came.

    Efforts that are 0 in motion, and always were, are not measured; an arm that rests on its brakes
    needs none.  Positions and efforts have shape (samples, n); both answers (samples,).
    """
    moved = (np.abs(position - start) > least).any(1)
    given = (np.abs(effort) > ROUNDING).any(1) & np.isfinite(position).any(1)
    return np.logical_or.accumulate(moved), np.logical_or.accumulate(given)


class IdleSignal:
    """Efforts or rates of a driver, as long as all were 0; ``least`` as of `without_efforts`."""

    def __init__(self, least: FloatArray, given: bool = False) -> None:
        self._least, self._given = least, given  # whether any was other than 0
        self._first: FloatArray | None = None  # positions of the first measurement
        self._has_moved = False  # from there, before any other came

    def leave_out(self, position: FloatArray, values: FloatArray) -> int:
        """Make values NaN that are not measured but 0; the first such sample of all, or -1."""
        if self._given:
            return -1
        read = np.isfinite(position).any(1)
        if not read.any():
            return -1
        if self._first is None:
            self._first = position[read.argmax()].copy()
        moved, is_given = without_efforts(position, values, self._first, self._least)
        had_moved = self._has_moved
        idle = (moved | had_moved) & ~is_given & np.isfinite(values).any(1)
        values[idle] = np.nan
        self._given, self._has_moved = bool(is_given[-1]), had_moved or bool(idle.any())
        return int(idle.argmax()) if self._has_moved and not had_moved else -1
