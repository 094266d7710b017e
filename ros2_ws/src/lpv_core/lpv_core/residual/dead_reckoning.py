"""How far each sensor should have moved by the measured rates, and what its reading says instead.

The residual r = y_p - S int theta' dt of a healthy sensor stands still, but for noise and errors of
the rates: no torque, no mass and no gravity enters.  A position fault enters it undelayed, and is
in it for good.  It says nothing of where the sensor stood at the start, which only gravity tells;
the fault estimate f^ says that, slowly and within the error of the model.

What stated errors of the rates can have added to the residual since some time is the difference of
two values of the allowance, plus their noise (`lpv_core.residual.change_detection`).
"""

import numpy as np

from lpv_core.model.joints import JointMap, row_dot
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

RATE_BIAS = 0.1
"""Bias of a rate sensor, over the standard deviation of its noise."""

_RESERVE = 4.0
"""What may be between two samples, over what is known of the accelerations at both."""
_LATELY = 0.05
"""Time constant of the average of roughness [s]."""
_LATE = 1.5
"""Samples that come after so many sample times have others lost before them."""

RECKONING_CONSTANTS = record_type(
    ('sensor_matrix', 'f8', (2, 2)), ('bias', 'f8'), ('scale', 'f8'), ('longest', 'f8')
)
"""S; bias [rad/s] and relative error of the rates; longest interval without lost samples [s]."""
RECKONING_STATE = record_type(
    ('started', '?'),
    ('rate', 'f8', (2,)),
    ('acceleration', 'f8', (2,)),
    ('travel', 'f8', (2,)),
    ('residual', 'f8', (2,)),
    ('allowance', 'f8', (2,)),
    ('lost', 'f8', (2,)),
    ('roughness', 'f8', (2,)),
)
"""Per sensor: rate and acceleration at the last sample [rad/s], [rad/s2]; S int theta' dt, residual
and allowance [rad]; part of the allowance that samples lost just before this one make [rad]; mean
change of the rate from one sample to the next beyond its acceleration [rad/s]."""


def dead_reckoning(arm) -> np.record:
    """Constants of `update_dead_reckoning` for one arm.

    Parameters
    ----------
    arm : ArmParameters
        Its sensors.

    Returns
    -------
    numpy.record
        Of type `RECKONING_CONSTANTS`.
    """
    return new_record(
        RECKONING_CONSTANTS,
        sensor_matrix=np.asarray(JointMap(arm).sensor_matrix),
        bias=RATE_BIAS * arm.velocity_noise,
        scale=arm.velocity_error,
        longest=_LATE * arm.sample_time,
    )


@njit
def reset_reckoning(state) -> None:
    """Start anew with the next estimate."""
    state.started = False


@njit
def update_dead_reckoning(params: np.record, state: np.record, estimate: np.record) -> None:
    """Follow one estimate; fills ``residual``, ``allowance`` and ``lost`` of the state.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    estimate : numpy.record
        Latest estimate.
    """
    for i in range(2):
        rate = row_dot(
            params.sensor_matrix, i, estimate.absolute_velocity[0], estimate.absolute_velocity[1]
        )
        acceleration = row_dot(
            params.sensor_matrix,
            i,
            estimate.absolute_acceleration[0],
            estimate.absolute_acceleration[1],
        )
        expected = row_dot(
            params.sensor_matrix, i, estimate.absolute_position[0], estimate.absolute_position[1]
        )
        state.lost[i] = 0.0
        if not state.started:
            state.travel[i], state.allowance[i], state.roughness[i] = expected, 0.0, 0.0
        elif estimate.bridged:
            # The encoder's own increment is all that is known of a gap: r stays what it was.
            state.travel[i] = estimate.fault[i] + expected - state.residual[i]
        else:
            state.travel[i] += 0.5 * estimate.interval * (state.rate[i] + rate)
            if estimate.interval > params.longest:
                _bridge(state, i, estimate.interval, rate, acceleration)
            else:
                _watch_roughness(state, i, estimate.interval, rate)
        state.residual[i] = estimate.fault[i] + expected - state.travel[i]
        state.allowance[i] += (
            estimate.interval * (params.bias + params.scale * abs(rate)) + state.lost[i]
        )
        state.rate[i], state.acceleration[i] = rate, acceleration
    state.started = True


@njit
def _bridge(state, i, interval, rate, acceleration) -> None:
    """Lost samples: the trapezoid is corrected by the model's accelerations at both ends (Euler and
    Maclaurin), and what may have been between them is allowed for."""
    before, twelfth = state.acceleration[i], interval * interval / 12.0
    state.travel[i] += twelfth * (before - acceleration)
    mean = abs(rate - state.rate[i]) / interval
    state.lost[i] = (
        _RESERVE * twelfth * (abs(before) + abs(acceleration) + mean)
        + interval * state.roughness[i]
    )


@njit
def _watch_roughness(state, i, interval, rate) -> None:
    """A gap is carried on by the two rates at its ends: their noise counts as it is, which may be
    more than stated where the arm is quick."""
    rough = abs(rate - state.rate[i] - interval * state.acceleration[i])
    state.roughness[i] += min(1.0, interval / _LATELY) * (rough - state.roughness[i])
