"""How large a scale error is, and how far dead reckoning has gone astray meanwhile.

The residual has changed by r - r_0 = a theta + w + noise: a is the scale error, a constant, and w a
random walk by the noise of the rates.  Motion tells them apart.  A Kalman filter of (a, w) gives
the angle as well as a healthy sensor does, while dead reckoning alone is ever less sure of it.
"""

import math

from lpv_core.residual.sample_buffer import ALLOWANCE, READING, RESIDUAL
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type

SCALE_FILTER = record_type(
    ('used', '?'), ('scale', 'f8'), ('astray', 'f8'), ('variance', 'f8', (3,)), ('surprise', 'f8')
)
"""Whether the fault is a scale error to the filter; a [1] and w [rad]; their covariance, P_aa,
P_aw, P_ww; mean of the innovations over their deviation."""

_SHARE = 0.02
"""Share of a sample in the mean of the innovations."""
_SURPRISED = 0.6
"""Mean of innovations, over their deviation, that no scale error leaves: six times its own."""


@njit
def start_scale(params, state, values, row: int) -> None:
    """Filter what has come since the onset.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state, see `lpv_core.decision.sensor_state`.
    values : ndarray, shape (2*size, 4)
        The sensor's past.
    row : int
        First row since the onset.
    """
    f = state.filter
    f.used, f.scale, f.astray = True, 0.0, 0.0
    f.variance[0], f.variance[1], f.variance[2] = 1.0, 0.0, 0.1 * params.noise * params.noise
    last = state.allowance_before
    for k in range(row, state.end):
        _follow(
            params,
            f,
            values[k, READING] - values[k, RESIDUAL] + state.baseline,
            values[k, RESIDUAL] - state.baseline,
            values[k, ALLOWANCE] - last,
        )
        last = values[k, ALLOWANCE]
    f.surprise = 0.0  # what it learned from does not count


@njit
def follow_scale(params, state) -> None:
    """Filter the present sample; what no scale error does ends it.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state, see `lpv_core.decision.sensor_state`.
    """
    sample = state.sample
    _follow(
        params,
        state.filter,
        sample.reading - state.amount,
        state.amount,
        sample.allowance - state.last_allowance,
    )
    if abs(state.filter.surprise) > _SURPRISED:
        state.filter.used, state.filter.astray = False, 0.0


@njit
def _follow(params, f, angle, change, allowed) -> None:
    p, angle = f.variance, angle + f.astray
    walk = params.step + allowed
    p[2] += walk * walk
    cross_a, cross_w = p[0] * angle + p[1], p[1] * angle + p[2]
    power = angle * cross_a + cross_w + params.noise * params.noise
    innovation = change - f.scale * angle - f.astray
    f.scale += cross_a / power * innovation
    f.astray += cross_w / power * innovation
    p[0] -= cross_a * cross_a / power
    p[1] -= cross_a * cross_w / power
    p[2] -= cross_w * cross_w / power
    f.surprise += _SHARE * (innovation / math.sqrt(power) - f.surprise)
