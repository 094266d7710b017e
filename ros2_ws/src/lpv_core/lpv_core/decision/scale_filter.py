"""How large a scale error is, and how far dead reckoning has gone astray meanwhile.

The residual has changed by r - r_0 = a theta + w + noise: a is the scale error, a constant, and w a
random walk by the noise of the rates.  Motion tells them apart.  A Kalman filter of (a, w) gives
the angle as well as a healthy sensor does, while dead reckoning alone is ever less sure of it.
"""

import math

import numpy as np

from lpv_core.residual.sample_buffer import ALLOWANCE, READING, RESIDUAL, SampleBuffer
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type

SCALE_FILTER = record_type(
    ('used', '?'),  # whether the fault is a scale error to the filter
    ('scale', 'f8'),  # a [1]
    ('walk', 'f8'),  # w [rad]
    ('variance', 'f8', (3,)),  # P_aa [1], P_aw [rad], P_ww [rad2]
    ('surprise', 'f8'),  # mean of the innovations over their standard deviation [1]
)

_SHARE = 0.02
"""Share of a sample in the mean of the innovations."""
_SURPRISED = 0.6
"""Mean of innovations, over their deviation, that no scale error leaves: six times its own."""


@njit
def start_scale(state: np.record, buffer: SampleBuffer, row: int) -> None:
    """Filter what has come since the onset, from its first row on."""
    f, values = state.scale, buffer.values
    f.used, f.scale, f.walk = True, 0.0, 0.0
    f.variance[0], f.variance[1], f.variance[2] = (
        1.0,
        0.0,
        0.1 * state.limits.noise * state.limits.noise,
    )
    last = state.before.allowance
    for k in range(row, buffer.used[0]):
        change = values[k, RESIDUAL] - state.before.residual
        angle = values[k, READING] - values[k, RESIDUAL] + state.before.residual
        _follow(state.limits, f, angle, change, values[k, ALLOWANCE] - last)
        last = values[k, ALLOWANCE]
    f.surprise = 0.0  # what it learned from does not count


@njit
def follow_scale(state: np.record) -> None:
    """Filter the present sample; what no scale error does ends it."""
    sample, amount = state.sample, state.alarm.amount
    allowed = sample.allowance - state.last_allowance
    _follow(state.limits, state.scale, sample.reading - amount, amount, allowed)
    if abs(state.scale.surprise) > _SURPRISED:
        state.scale.used, state.scale.walk = False, 0.0


@njit
def _follow(limits: np.record, f: np.record, angle: float, change: float, allowed: float) -> None:
    """One step of the Kalman filter with h = (theta, 1)."""
    p, angle = f.variance, angle + f.walk
    walk = limits.step + allowed
    p[2] += walk * walk
    cross_a, cross_w = p[0] * angle + p[1], p[1] * angle + p[2]  # P h
    power = angle * cross_a + cross_w + limits.noise * limits.noise  # h P h + R
    innovation = change - f.scale * angle - f.walk
    f.scale += cross_a / power * innovation
    f.walk += cross_w / power * innovation
    p[0] -= cross_a * cross_a / power
    p[1] -= cross_a * cross_w / power
    p[2] -= cross_w * cross_w / power
    f.surprise += _SHARE * (innovation / math.sqrt(power) - f.surprise)
