"""Angle errors by dead reckoning: intervals that grow with the errors of the rates alone.

The observer's angle moves by the measured rates and by a correction that is known, so that its
error changes by that correction and by what the rates miss, whatever torques act.  Such an interval
grows for ever; cut with the reachable set at each step, both stay as small as the smaller one.

Where samples were lost, the angles are carried on by the rates at both ends of the gap; the
trapezoid is corrected by the model's accelerations there (Euler and Maclaurin), and what may have
been between them is allowed for.
"""

import math

import numpy as np

from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import record_type

_RESERVE = 4.0
"""What may be between two samples, over what is known of the accelerations at both."""
_SMOOTHING = 0.05
"""Time constant of the average of roughness [s]."""

RECKONING_STATE = record_type(
    # Per angle:
    ('low', 'f8', (2,)),  # interval of its error, but for noise [rad]
    ('high', 'f8', (2,)),  # [rad]
    ('age', 'f8', (2,)),  # time over which noise of the rates has been integrated [s]
    ('theta', 'f8', (2,)),  # last theta^ [rad]
    ('rate', 'f8', (2,)),  # last v [rad/s]
    ('acceleration', 'f8', (2,)),  # at the last sample [rad/s2]
    ('jump', 'f8', (2,)),  # what samples lost just before this one leave unknown [rad]
    ('roughness', 'f8', (2,)),  # mean change of the rate in a sample beyond acceleration [rad/s]
)


@njit
def start_reckoning(
    state: np.record, observer: np.record, start: np.ndarray, noise: np.ndarray
) -> None:
    """Begin with errors of given sizes, whose sum counts, per angle [rad]."""
    for i in range(2):
        state.low[i], state.high[i] = -(start[i] + noise[i]), start[i] + noise[i]
        state.age[i] = state.roughness[i] = 0.0
    _note(state, observer)


@njit
def _note(state: np.record, observer: np.record) -> None:
    for i in range(2):
        state.theta[i], state.rate[i] = observer.x[i], observer.v_new[i]
        state.acceleration[i] = observer.acceleration[i]


@njit
def note_lost_samples(longest: float, state: np.record, observer: np.record) -> None:
    """Fill ``jump`` of the state at one estimate after another, where an interval is longer [s]."""
    interval = observer.interval
    for i in range(2):
        change, before = abs(observer.v_new[i] - state.rate[i]), state.acceleration[i]
        state.jump[i] = 0.0
        if observer.bridged:
            continue
        if interval > longest:
            between = abs(before) + abs(observer.acceleration[i]) + change / interval
            state.jump[i] = _RESERVE * interval * interval / 12.0 * between
            state.jump[i] += interval * state.roughness[i]
        else:
            # Noise of the two rates at a gap's ends counts as it is, which may be more than stated.
            rough = abs(observer.v_new[i] - state.rate[i] - interval * before)
            state.roughness[i] += min(1.0, interval / _SMOOTHING) * (rough - state.roughness[i])


@njit
def move_interval(state: np.record, observer: np.record, rate_error: np.ndarray) -> None:
    """Follow one estimate: absolute rates are wrong by at most ``rate_error`` but for noise
    [rad/s], and angles by ``jump`` more."""
    dt = observer.interval
    for i in range(2):
        shift, grown = 0.0, state.jump[i]
        if not observer.bridged:  # over a gap the angles follow the encoder, errors stay
            shift = observer.x[i] - state.theta[i]
            shift -= 0.5 * dt * (observer.v_new[i] + state.rate[i])
            grown += dt * rate_error[i]
            state.age[i] += dt
        state.low[i] += shift - grown
        state.high[i] += shift + grown
    _note(state, observer)


@njit
def cut_interval(state: np.record, i: int, limit: float, noise: float) -> float:
    """Cut the interval of angle i at +-limit [rad]; its largest error with the ``noise`` of the
    rates [rad/sqrt(s)]."""
    if max(-state.low[i], state.high[i]) > limit:
        state.low[i] = min(max(state.low[i], -limit), limit)
        state.high[i] = max(min(state.high[i], limit), -limit)
        if -state.low[i] >= limit and state.high[i] >= limit:
            state.age[i] = 0.0
    return max(-state.low[i], state.high[i]) + noise * math.sqrt(state.age[i])
