"""Where a change of a residual comes from: when it began, and how."""

from lpv_core.residual.change_detection import WINDOWS, least_change
from lpv_core.residual.sample_buffer import ALLOWANCE, RESIDUAL, first_since, median_before
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

AROUND = 50
"""Samples before a fault that its size is measured from."""
_FEW, _JUMP = 5, 0.6
"""A jump shows between the means of so many samples, by that part of a jump of single ones."""


@njit
def take_baseline(state, values, row: int) -> None:
    """Keep what a fault is measured from.

    Parameters
    ----------
    state, values
        See `lpv_core.decision.sensor_state`.
    row : int
        Last row before the fault.
    """
    state.baseline = median_before(values, row, AROUND)
    state.allowance_before = values[row, ALLOWANCE]


@njit
def fit_step_or_ramp(state, stamps, values, row: int):
    """Whether a residual has jumped or begun to move, and when.

    A reading can jump; what wrong rates do to the residual takes time.  Least squares fits of a
    step, r_0 + h for t >= t_0, and of a straight course, r_0 + b (t - t_0) for t >= t_0: for each
    t_0 the best h and b follow from sums over the samples since then.

    Parameters
    ----------
    state, stamps, values
        See `lpv_core.decision.sensor_state`; ``state.baseline`` is r_0.
    row : int
        Last row before the change.

    Returns
    -------
    tuple of bool, float and int
        Whether the step fits better; b [rad/s], of no meaning for a step; and t_0 [ns].
    """
    now = state.sample.stamp
    count, times, squares = 1.0, 0.0, 0.0  # the present sample, at time zero
    away, products = state.sample.residual - state.baseline, 0.0
    step, jumped, course, speed, began = away * away, now, 0.0, 0.0, now
    for k in range(state.end - 1, row - 1, -1):
        time, value = (stamps[k] - now) / NANOSECONDS, values[k, RESIDUAL] - state.baseline
        power = squares - 2.0 * time * times + time * time * count
        cross = products - time * away
        if count > 1.0 and cross * cross > course * power:  # one sample alone has jumped
            course, speed, began = cross * cross / power, cross / power, stamps[k]
        count, times, squares = count + 1.0, times + time, squares + time * time
        away, products = away + value, products + value * time
        if away * away > step * count:
            step, jumped = away * away / count, stamps[k]
    stepped = step >= course
    return stepped, speed, jumped if stepped else began


@njit
def has_jumped(params, state, stamps, values) -> bool:
    """Whether a change that is no step came by jumps, or began with one; rates move r little by
    little.

    Parameters
    ----------
    params, state, stamps, values
        See `lpv_core.decision.sensor_state`.

    Returns
    -------
    bool
        True if r differed between neighbouring samples by more than noise, or between the means of
        a few by more than any error of a rate that would not show at once.
    """
    limit = least_change(params.changes)
    first = first_since(stamps, state.end, state.since - round(WINDOWS[state.window] * NANOSECONDS))
    for k in range(first, state.end):
        after = values[k + 1, RESIDUAL] if k + 1 < state.end else state.sample.residual
        if abs(after - values[k, RESIDUAL]) > limit:
            return True
        if first + _FEW <= k <= state.end - _FEW:
            across = 0.0
            for i in range(_FEW):
                across += values[k + i, RESIDUAL] - values[k - 1 - i, RESIDUAL]
            if abs(across) > _JUMP * _FEW * limit:
                return True
    return False
