"""Where a change of a residual comes from: when it began, and how."""

import numpy as np

from lpv_core.residual.change_detection import WINDOWS, least_change
from lpv_core.residual.sample_buffer import (
    ALLOWANCE,
    RESIDUAL,
    SampleBuffer,
    first_since,
    median_before,
)
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

AROUND = 50
"""Samples before a fault that its size is measured from."""
_FEW, _JUMP = 5, 0.6
"""A jump shows between the means of so many samples, by that part of a jump of single ones."""


@njit
def take_baseline(state: np.record, buffer: SampleBuffer, row: int) -> None:
    """Keep what a fault is measured from: residual and allowance up to the last row before it."""
    state.before.residual = median_before(buffer, row, AROUND)
    state.before.allowance = buffer.values[row, ALLOWANCE]


@njit
def fit_step_or_ramp(state: np.record, buffer: SampleBuffer, row: int) -> tuple[bool, float, int]:
    """Whether a residual has jumped or begun to move, and when.

    A reading can jump; what wrong rates do to the residual takes time.  Least squares fits of a
    step, r_0 + h for t >= t_0, and of a ramp, r_0 + b (t - t_0) for t >= t_0: for each t_0 the best
    h and b follow from sums over the samples since then.

    Parameters
    ----------
    state : numpy.record
        Of type `lpv_core.decision.sensor_state.SENSOR_STATE`; ``state.before.residual`` is r_0.
    buffer : SampleBuffer
        The sensor's past.
    row : int
        Last row before the change.

    Returns
    -------
    tuple of bool, float and int
        Whether the step fits better; b [rad/s], of no meaning for a step; and t_0 [ns].
    """
    baseline, now = state.before.residual, state.sample.stamp
    count, times, squares = 1.0, 0.0, 0.0  # the present sample, at time zero
    away, products = state.sample.residual - baseline, 0.0
    step, jumped, ramp, speed, began = away * away, now, 0.0, 0.0, now
    for k in range(buffer.used[0] - 1, row - 1, -1):
        time, value = (buffer.stamps[k] - now) / NANOSECONDS, buffer.values[k, RESIDUAL] - baseline
        power = squares - 2.0 * time * times + time * time * count
        cross = products - time * away
        if count > 1.0 and cross * cross > ramp * power:  # one sample alone has jumped
            ramp, speed, began = cross * cross / power, cross / power, buffer.stamps[k]
        count, times, squares = count + 1.0, times + time, squares + time * time
        away, products = away + value, products + value * time
        if away * away > step * count:
            step, jumped = away * away / count, buffer.stamps[k]
    stepped = step >= ramp
    return stepped, speed, jumped if stepped else began


@njit
def has_jumped(state: np.record, buffer: SampleBuffer) -> bool:
    """Whether a change that is no step came by jumps, or began with one; rates move r gradually.

    Parameters
    ----------
    state : numpy.record
        Of type `lpv_core.decision.sensor_state.SENSOR_STATE`.
    buffer : SampleBuffer
        The sensor's past.

    Returns
    -------
    bool
        True if r differed between neighbouring samples by more than noise, or between the means of
        a few by more than any error of a rate that would not show at once.
    """
    limit, values, count = least_change(state.limits.changes), buffer.values, buffer.used[0]
    evidence = state.evidence
    first = first_since(buffer, evidence.since - round(WINDOWS[evidence.window] * NANOSECONDS))
    for k in range(first, count):
        after = values[k + 1, RESIDUAL] if k + 1 < count else state.sample.residual
        if abs(after - values[k, RESIDUAL]) > limit:
            return True
        if first + _FEW <= k <= count - _FEW:
            across = 0.0
            for i in range(_FEW):
                across += values[k + i, RESIDUAL] - values[k - 1 - i, RESIDUAL]
            if abs(across) > _JUMP * _FEW * limit:
                return True
    return False
