"""How large a confirmed fault is, how well that is known, and what to remove from the reading."""

import math

from lpv_core.decision.fault_classification import BIAS, NOISE, SCALE, SPIKE, step_of
from lpv_core.decision.scale_filter import follow_scale
from lpv_core.decision.sensor_state import IMPOSSIBLE, MEASURED
from lpv_core.residual.change_detection import least_change
from lpv_core.residual.onset_estimation import AROUND
from lpv_core.residual.sample_buffer import first_since
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

_APART, _REST_SHARE = 2.0, 0.02
"""A residual that differs from the height of its step by so much in the mean, over the noise of a
reading, is no bias; share of a sample in that mean."""


@njit
def removable(params, state) -> float:
    """What is to be removed from the reading of a sensor with an alarm.

    A step whose height is known leaves a reading as good as that of a healthy sensor; of noise, its
    mean remains; spikes go one by one; else all that the residual has changed, so that the loop
    closes on dead reckoning from before the fault.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.

    Returns
    -------
    float
        [rad].
    """
    if state.kind == SPIKE:
        away = state.amount - state.average
        return away if abs(away) > least_change(params.changes) else 0.0
    if state.kind == NOISE:
        return state.amount - state.average
    if state.kind == SCALE and state.filter.used:
        return state.amount - state.filter.astray
    return state.height if state.kind == BIAS and state.measured == MEASURED else state.amount


@njit
def size_error(params, state) -> float:
    """How far ``amount`` may be from the fault, if that was seen as a change.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.

    Returns
    -------
    float
        Noise, and what errors of the rates can have added up to since before the fault [rad].
    """
    return params.changes.noise[0] + growth(params, state)


@njit
def growth(params, state) -> float:
    """What errors of the rates can have added to the residual since before the fault [rad].

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.

    Returns
    -------
    float
        Noise, bias and scale, as stated.
    """
    elapsed = max(0.0, (state.sample.stamp - state.onset) / NANOSECONDS)
    return (
        params.changes.walk * math.sqrt(elapsed) + state.sample.allowance - state.allowance_before
    )


@njit
def measure_step(state, stamps, values) -> None:
    """Measure the height of a step from the samples around it.

    Parameters
    ----------
    state, stamps, values
        See `lpv_core.decision.sensor_state`.
    """
    row = first_since(stamps, state.end, state.onset)
    first = max(row - AROUND, 0, state.end - len(stamps) // 2)
    if row - first < AROUND // 2 or state.end - row < AROUND // 2:
        state.measured = IMPOSSIBLE
        return
    last = min(row + AROUND, state.end)
    state.height = step_of(stamps[first:last], values[first:last], row - first)
    state.measured, state.rest = MEASURED, 0.0


@njit
def follow_fault(params, state) -> None:
    """Follow the mean of noise; drop the height of a step when r leaves it: the fault is over, or
    another one has come.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    """
    away = abs(state.amount - state.average) > least_change(params.changes)
    if state.kind == SPIKE and away:
        state.spikes[0] = state.sample.stamp
    elif state.kind == NOISE or state.kind == SPIKE:
        # The gain of a Kalman filter at rest: what the rates add in one sample over the scatter.
        moved = params.step + state.sample.allowance - state.last_allowance
        share = moved / max(state.scatter, params.noise, moved)
        state.average += share * (state.amount - state.average)
    elif state.kind == SCALE and state.filter.used:
        follow_scale(params, state)
    if state.measured == MEASURED:
        rest = state.amount - state.height
        state.rest += _REST_SHARE * (rest - state.rest)
        if abs(rest) > least_change(params.changes) or abs(
            state.rest
        ) > _APART * params.noise + 0.5 * growth(params, state):
            state.measured = IMPOSSIBLE
