"""How large a confirmed fault is, how well that is known, and what to remove from the reading."""

import math

import numpy as np

from lpv_core.decision.fault_classification import step_height
from lpv_core.decision.fault_kinds import BIAS, NOISE, SCALE, SCATTERED, SPIKE
from lpv_core.decision.scale_filter import follow_scale
from lpv_core.decision.sensor_state import IMPOSSIBLE, MEASURED
from lpv_core.residual.change_detection import least_change
from lpv_core.residual.onset_estimation import AROUND
from lpv_core.residual.sample_buffer import SampleBuffer, first_since
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

_APART, _REST_SHARE = 2.0, 0.02
"""A residual that differs from the height of its step by so much in the mean, over the noise of a
reading, is no bias; share of a sample in that mean."""


@njit
def removable(state: np.record) -> float:
    """What is to be removed from the reading of a sensor with an alarm [rad].

    A step whose height is known leaves a reading as good as that of a healthy sensor; of noise, its
    mean remains; spikes go one by one; else all that the residual has changed, so that the loop
    closes on dead reckoning from before the fault.
    """
    kind, amount = state.alarm.kind, state.alarm.amount
    if kind == SPIKE:
        away = amount - state.scatter.average
        return away if abs(away) > least_change(state.limits.changes) else 0.0
    if kind == NOISE:
        return amount - state.scatter.average
    if kind == SCALE and state.scale.used:
        return amount - state.scale.walk
    return state.step.height if kind == BIAS and state.step.measured == MEASURED else amount


@njit
def size_error(state: np.record) -> float:
    """How far ``amount`` may be from a fault that was seen as a change [rad]."""
    return state.limits.changes.noise[0] + growth(state)


@njit
def growth(state: np.record) -> float:
    """What stated errors of the rates can have added to r since before the fault [rad]."""
    elapsed = max(0.0, (state.sample.stamp - state.alarm.onset) / NANOSECONDS)
    return (
        state.limits.changes.walk * math.sqrt(elapsed)
        + state.sample.allowance
        - state.before.allowance
    )


@njit
def measure_step(state: np.record, buffer: SampleBuffer) -> None:
    """Measure the height of a step from the samples around it."""
    step, stamps, count = state.step, buffer.stamps, buffer.used[0]
    row = first_since(buffer, state.alarm.onset)
    first = max(row - AROUND, 0, count - len(stamps) // 2)
    if row - first < AROUND // 2 or count - row < AROUND // 2:
        step.measured = IMPOSSIBLE
        return
    last = min(row + AROUND, count)
    step.height = step_height(stamps[first:last], buffer.values[first:last], row - first)
    step.measured, step.rest = MEASURED, 0.0


@njit
def follow_fault(state: np.record) -> None:
    """Follow the mean of noise; drop the height of a step when r leaves it: the fault is over, or
    another one has come."""
    kind, amount, scatter = state.alarm.kind, state.alarm.amount, state.scatter
    away = abs(amount - scatter.average) > least_change(state.limits.changes)
    if kind == SPIKE and away:
        state.spikes.stamps[0] = state.sample.stamp
    elif kind in SCATTERED:
        # The gain of a Kalman filter at rest: what the rates add in one sample over the scatter.
        moved = state.limits.step + state.sample.allowance - state.last_allowance
        share = moved / max(scatter.deviation, state.limits.noise, moved)
        scatter.average += share * (amount - scatter.average)
    elif kind == SCALE and state.scale.used:
        follow_scale(state)
    step = state.step
    if step.measured == MEASURED:
        rest = amount - step.height
        step.rest += _REST_SHARE * (rest - step.rest)
        apart = _APART * state.limits.noise + 0.5 * growth(state)
        if abs(rest) > least_change(state.limits.changes) or abs(step.rest) > apart:
            step.measured = IMPOSSIBLE
