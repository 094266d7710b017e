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
from lpv.core.uio.model.joints import row_dot

_RESERVE = 4.0
"""What may be between two samples, over what is known of the accelerations at both."""
_SMOOTHING = 0.05
"""Time constant of the average of roughness [s]."""

INTERVAL_STATE = record_type(
    ('low', 'f8', (2,)),  # interval of each angle error, but for noise [rad]
    ('high', 'f8', (2,)),  # [rad]
    ('age', 'f8', (2,)),  # time over which noise of the rates has been integrated [s]
    ('theta', 'f8', (2,)),  # last theta^ [rad]
    ('rate', 'f8', (2,)),  # last v [rad/s]
)
LOSS_STATE = record_type(
    # Per sensor:
    ('started', '?'),
    ('rate', 'f8', (2,)),  # at the last sample [rad/s]
    ('acceleration', 'f8', (2,)),  # at the last sample [rad/s2]
    ('lost', 'f8', (2,)),  # what samples lost just before this one leave unknown [rad]
    ('roughness', 'f8', (2,)),  # mean change of the rate in a sample beyond acceleration [rad/s]
)


@njit
def start_interval(state: np.record, observer: np.record, size: np.ndarray) -> None:
    """Begin with errors of a given size, per angle [rad]."""
    for i in range(2):
        state.low[i], state.high[i], state.age[i] = -size[i], size[i], 0.0
        state.theta[i] = observer.x[i]
        state.rate[i] = observer.v_new[i]


@njit
def move_interval(
    state: np.record, observer: np.record, rate_error: np.ndarray, jump: np.ndarray
) -> None:
    """Follow one estimate: absolute rates are wrong by at most ``rate_error`` but for noise
    [rad/s], and angles by ``jump`` more, an unknown part of lost samples [rad]."""
    dt = observer.interval
    for i in range(2):
        theta, rate = observer.x[i], observer.v_new[i]
        shift, grown = 0.0, jump[i]
        if not observer.bridged:  # over a gap the angles follow the encoder, errors stay
            shift = theta - state.theta[i] - 0.5 * dt * (rate + state.rate[i])
            grown += dt * rate_error[i]
            state.age[i] += dt
        state.low[i] += shift - grown
        state.high[i] += shift + grown
        state.theta[i], state.rate[i] = theta, rate


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


@njit
def note_lost_samples(
    joints: np.record, longest: float, state: np.record, observer: np.record
) -> None:
    """Follow one estimate; fills ``lost`` of the state where an interval is longer [s]."""
    matrix, interval = joints.sensor, observer.interval
    known, speed = observer.acceleration, observer.v_new
    for i in range(2):
        rate = row_dot(matrix, i, speed[0], speed[1])
        acceleration = row_dot(matrix, i, known[0], known[1])
        change, before = abs(rate - state.rate[i]), state.acceleration[i]
        state.lost[i] = 0.0
        if not state.started:
            state.roughness[i] = 0.0
        elif not observer.bridged and interval > longest:
            between = abs(before) + abs(acceleration) + change / interval
            state.lost[i] = _RESERVE * interval * interval / 12.0 * between
            state.lost[i] += interval * state.roughness[i]
        elif not observer.bridged:
            # Noise of the two rates at a gap's ends counts as it is, which may be more than stated.
            rough = abs(rate - state.rate[i] - interval * before)
            state.roughness[i] += min(1.0, interval / _SMOOTHING) * (rough - state.roughness[i])
        state.rate[i], state.acceleration[i] = rate, acceleration
    state.started = True
