"""Computed torque: tracking control of serial arms by inverse dynamics.

tau = M(q) a + C(q, v) v + g(q) + F(v_r), a = q_r'' + kd (v_r - v) + kp (q_r - q) + ki eps,
eps' = q_r - q.

With the true model the error of every joint has three poles at -w, w the bandwidth: kd = 3 w,
kp = 3 w^2, ki = w^3.  For a wrong model see
`lpv.core.serial_arm.certificate`.
"""

import numpy as np

from lpv.core.control.latency import loop_latency
from lpv.core.control.tracking_law import AT_STATE, TrackingLaw
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError

BANDWIDTH = 10.0
"""Default [rad/s]."""


class ComputedTorqueController(TrackingLaw):
    """Computed torque with PD and integral action.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    bandwidth : float, optional
        Distance of the loop's three poles from zero, with a true model [rad/s].

    Attributes
    ----------
    tolerated_latency, integrates_measurement
        As of `lpv.core.control.tracking.TrackingController`.

    Raises
    ------
    ConfigError
        If the sampled loop with this bandwidth is not stable.
    """

    integrates_measurement = False

    def __init__(self, arm: SerialArm, bandwidth: float = BANDWIDTH) -> None:
        gains = _triple_pole(bandwidth)
        self.tolerated_latency = serial_loop_latency(bandwidth, arm.sample_time)
        if self.tolerated_latency < arm.sample_time:
            raise ConfigError(
                'bandwidth', f'{bandwidth:g} rad/s is unstable at {arm.sample_time:g} s a sample'
            )
        super().__init__(arm, model=AT_STATE, ki=gains[0], kp=gains[1], kd=gains[2])


def serial_loop_latency(bandwidth: float, sample_time: float) -> float:
    """Longest constant latency with which the loop of a joint is stable, with a true model [s]."""
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # of eps, q, v
    b = np.array([[0.0], [0.0], [1.0]])
    return loop_latency([(a, b)], -_triple_pole(bandwidth)[None], sample_time)


def _triple_pole(bandwidth: float) -> np.ndarray:
    """ki, kp, kd."""
    return bandwidth**3 * np.array([1.0, 3.0 / bandwidth, 3.0 / bandwidth**2])
