"""Efforts of drivers that measure none and publish zeros."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray


def without_efforts(
    position: FloatArray, effort: FloatArray, start: FloatArray, least: FloatArray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Whether joints have left ``start`` by ``least`` up to each sample; whether efforts came.

    Efforts that are 0 in motion, and always were, are not measured; an arm that rests on its brakes
    needs none.  Positions and efforts have shape (samples, n); both answers (samples,).
    """
    moved = (np.abs(position - start) > least).any(1)
    given = (np.abs(effort) > 0.0).any(1) & np.isfinite(position).any(1)
    return np.logical_or.accumulate(moved), np.logical_or.accumulate(given)
