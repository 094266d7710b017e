"""How far each sensor should have moved by the measured rates, and what its reading says instead.

The residual r = y_p - S int theta' dt of a healthy sensor stands still, but for noise and errors of
the rates: no torque, no mass and no gravity enters.  A position fault enters it undelayed, and is
in it for good.  It says nothing of where the sensor stood at the start, which only gravity tells;
the fault estimate f^ says that, slowly and within the error of the model.

What stated errors of the rates can have added to the residual since some time is the difference of
two values of the allowance, plus their noise (`lpv_core.residual.change_detection`).
"""

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap, row_dot
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

RATE_BIAS = 0.1
"""Bias of a rate sensor, over the standard deviation of its noise."""

_RESERVE = 4.0
"""What may be between two samples, over what is known of the accelerations at both."""
_SMOOTHING = 0.05
"""Time constant of the average of roughness [s]."""
_LATE = 1.5
"""Samples that come after so many sample times have others lost before them."""

RECKONING_CONSTANTS = record_type(
    ('sensor_matrix', 'f8', (2, 2)),  # S
    ('bias', 'f8'),  # bias of the rates [rad/s]
    ('scale', 'f8'),  # relative error of the rates [1]
    ('longest', 'f8'),  # longest interval without lost samples [s]
)
RECKONING_STATE = record_type(
    # Per sensor:
    ('started', '?'),
    ('rate', 'f8', (2,)),  # at the last sample [rad/s]
    ('acceleration', 'f8', (2,)),  # at the last sample [rad/s2]
    ('travel', 'f8', (2,)),  # S int theta' dt [rad]
    ('residual', 'f8', (2,)),  # r [rad]
    ('allowance', 'f8', (2,)),  # what errors of the rates can have added to r [rad]
    ('lost', 'f8', (2,)),  # its part from samples lost just before this one [rad]
    ('roughness', 'f8', (2,)),  # mean change of the rate in a sample beyond acceleration [rad/s]
)


def dead_reckoning(arm: ArmParameters) -> np.record:
    """Constants of `update_dead_reckoning` for one arm, of type `RECKONING_CONSTANTS`."""
    return new_record(
        RECKONING_CONSTANTS,
        sensor_matrix=np.asarray(JointMap(arm).sensor_matrix),
        bias=RATE_BIAS * arm.velocity_noise,
        scale=arm.velocity_error,
        longest=_LATE * arm.sample_time,
    )


@njit
def reset_reckoning(state: np.record) -> None:
    """Restart with the next estimate."""
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
    matrix, interval = params.sensor_matrix, estimate.interval
    for i in range(2):
        rate = _sensor_value(matrix, i, estimate.absolute_velocity)
        acceleration = _sensor_value(matrix, i, estimate.absolute_acceleration)
        expected = _sensor_value(matrix, i, estimate.absolute_position)
        state.lost[i] = 0.0
        if not state.started:
            state.travel[i], state.allowance[i], state.roughness[i] = expected, 0.0, 0.0
        elif estimate.bridged:
            # The encoder's own increment is all that is known of a gap: r stays what it was.
            state.travel[i] = estimate.fault[i] + expected - state.residual[i]
        else:
            state.travel[i] += 0.5 * interval * (state.rate[i] + rate)
            if interval > params.longest:
                _bridge(state, i, interval, rate, acceleration)
            else:
                _update_roughness(state, i, interval, rate)
        state.residual[i] = estimate.fault[i] + expected - state.travel[i]
        state.allowance[i] += interval * (params.bias + params.scale * abs(rate)) + state.lost[i]
        state.rate[i], state.acceleration[i] = rate, acceleration
    state.started = True


@njit
def _sensor_value(matrix: np.ndarray, sensor: int, absolute: np.ndarray) -> float:
    return row_dot(matrix, sensor, absolute[0], absolute[1])


@njit
def _bridge(state: np.record, i: int, interval: float, rate: float, acceleration: float) -> None:
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
def _update_roughness(state: np.record, i: int, interval: float, rate: float) -> None:
    """A gap is carried on by the two rates at its ends: their noise counts as it is, which may be
    more than stated where the arm is quick."""
    rough = abs(rate - state.rate[i] - interval * state.acceleration[i])
    state.roughness[i] += min(1.0, interval / _SMOOTHING) * (rough - state.roughness[i])
