"""What samples that were lost leave unknown of each sensor's angle.

A gap is carried on by the rates at its ends; the trapezoid is corrected by the model's
accelerations at both (Euler and Maclaurin), and what may have been between them is allowed for.
"""

import numpy as np

from lpv.core.serial_arm.diagnosis.sampler import LATE
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import record_type
from lpv.core.uio.model.joints import row_dot

_RESERVE = 4.0
"""What may be between two samples, over what is known of the accelerations at both."""
_SMOOTHING = 0.05
"""Time constant of the average of roughness [s]."""

LOSS_STATE = record_type(
    # Per sensor:
    ('started', '?'),
    ('rate', 'f8', (2,)),  # at the last sample [rad/s]
    ('acceleration', 'f8', (2,)),  # at the last sample [rad/s2]
    ('lost', 'f8', (2,)),  # what samples lost just before this one leave unknown [rad]
    ('roughness', 'f8', (2,)),  # mean change of the rate in a sample beyond acceleration [rad/s]
)


@njit
def note_lost_samples(params: np.record, state: np.record, observer: np.record) -> None:
    """Follow one estimate of an observer with such constants; fills ``lost`` of the state."""
    matrix, interval = params.joints.sensor, observer.interval
    known, speed = observer.acceleration, observer.v_new
    for i in range(2):
        rate = row_dot(matrix, i, speed[0], speed[1])
        acceleration = row_dot(matrix, i, known[0], known[1])
        change, before = abs(rate - state.rate[i]), state.acceleration[i]
        state.lost[i] = 0.0
        if not state.started:
            state.roughness[i] = 0.0
        elif not observer.bridged and interval > LATE * params.sample_time:
            between = abs(before) + abs(acceleration) + change / interval
            state.lost[i] = _RESERVE * interval * interval / 12.0 * between
            state.lost[i] += interval * state.roughness[i]
        elif not observer.bridged:
            # Noise of the two rates at a gap's ends counts as it is, which may be more than stated.
            rough = abs(rate - state.rate[i] - interval * before)
            state.roughness[i] += min(1.0, interval / _SMOOTHING) * (rough - state.roughness[i])
        state.rate[i], state.acceleration[i] = rate, acceleration
    state.started = True
