"""FilterPy's extended and unscented Kalman filters with random-walk faults, as peers.

Six states: two absolute angles, two rates, two faults of the position sensors.  Noise and mean
disturbance as the arm file states them; the random walk of the faults and the margin of the
disturbance, for errors of the model, are what a careful user would choose by trial.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from lpv_campaign.limit.fault_prior import FAULT_WALK
from lpv_core.model.arm import ArmParameters
from lpv_core.model.dynamics import acceleration
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import Run
from lpv_core.support.errors import LpvError
from lpv_core.support.jit import njit

_MARGIN = 0.05
"""Standard deviation of accelerations in addition to the disturbance [rad/s2]."""
_NOTHING = 1e6
"""Variance of a reading that is not there."""
_STEP = 1e-6


@njit
def _move(
    x: np.ndarray, torque: np.ndarray, push: np.ndarray, dt: float, constants: np.ndarray
) -> np.ndarray:
    """State one sample later, by Euler's rule."""
    a_1, a_2 = acceleration(x[0], x[1], x[2], x[3], torque[0], torque[1], constants)
    out = x.copy()
    out[0] += dt * x[2]
    out[1] += dt * x[3]
    out[2] += dt * (a_1 + push[0])
    out[3] += dt * (a_2 + push[1])
    return out


@njit
def _jacobian(
    x: np.ndarray, torque: np.ndarray, push: np.ndarray, dt: float, constants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of `_move` by differences."""
    moved, f = _move(x, torque, push, dt, constants), np.eye(6)
    for j in range(4):
        step = x.copy()
        step[j] += _STEP
        f[:, j] = (_move(step, torque, push, dt, constants) - moved) / _STEP
    return moved, f


class _Model:
    """Equation of motion and measurement of one arm, sampled by Euler's rule."""

    def __init__(self, arm: ArmParameters) -> None:
        direction, dt = np.asarray(arm.disturbance_direction, float), arm.sample_time
        self._fixed = arm.disturbance_mean * direction, dt, arm.constants()
        self._s = JointMap(arm).sensor_matrix
        self.h = np.block(
            [[self._s, np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 2)), self._s, np.zeros((2, 2))]]
        )
        push = np.sqrt(arm.disturbance_variance) * np.abs(direction) + _MARGIN
        self.q = np.diag([1e-10, 1e-10, *(push**2 * dt**2), *[FAULT_WALK**2 * dt] * 2])
        self.r = np.diag([arm.position_noise**2] * 2 + [arm.velocity_noise**2] * 2)

    def move(self, x: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """State one sample later."""
        return _move(x, torque, *self._fixed)

    def move_and_derive(self, x: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same with its Jacobian."""
        return _jacobian(x, torque, *self._fixed)

    def start(self, arm: ArmParameters, position: np.ndarray) -> np.ndarray:
        """State without faults."""
        return np.concatenate([JointMap(arm).absolute_position(position), np.zeros(4)])

    def present(self, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings, and their variance; what is missing is as predicted and weighs nothing."""
        missing = ~np.isfinite(y)
        if not missing.any():
            return y, self.r
        r = self.r.copy()
        r[missing, missing] = _NOTHING
        return np.where(missing, self.h @ x, y), r


class Ekf(ExtendedKalmanFilter):
    """Extended filter; Jacobian by differences."""

    def __init__(self, model: _Model) -> None:
        super().__init__(dim_x=6, dim_z=4)
        self._model = model
        self.Q, self.R = model.q, model.r
        self.P = np.diag([1e-6] * 4 + [1e-6] * 2)

    def predict_x(self, u: Any = 0) -> None:
        """As FilterPy asks."""
        self.x: np.ndarray
        self.x, self.F = self._model.move_and_derive(self.x.ravel(), u)

    def take(self, y: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """One measurement; the fault estimates [rad]."""
        self.predict(torque)
        y, r = self._model.present(y, self.x)
        self.update(y, lambda _: self._model.h, lambda x: self._model.h @ x, R=r)
        return self.x[4:]


class Ukf(UnscentedKalmanFilter):
    """Unscented filter."""

    def __init__(self, model: _Model, dt: float) -> None:
        super().__init__(
            6,
            4,
            dt,
            lambda x: model.h @ x,
            lambda x, dt, torque: model.move(x, torque),
            MerweScaledSigmaPoints(6, 0.1, 2.0, -3.0),
        )
        self._model = model
        self.Q, self.R = model.q, model.r
        self.P = np.diag([1e-6] * 4 + [1e-6] * 2)

    def take(self, y: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """One measurement; the fault estimates [rad]."""
        self.predict(torque=torque)
        y, r = self._model.present(y, self.x)
        self.update(y, R=r)
        return self.x[4:]


def make_ekf(arm: ArmParameters, position: np.ndarray) -> Ekf:
    """Extended filter, started without faults at a joint position.

    Parameters
    ----------
    arm : ArmParameters
        Its model.
    position : ndarray, shape (2,)
        [rad].

    Returns
    -------
    Ekf
        The filter.
    """
    model = _Model(arm)
    found = Ekf(model)
    found.x = model.start(arm, position)
    return found


def make_ukf(arm: ArmParameters, position: np.ndarray) -> Ukf:
    """Unscented filter, started without faults at a joint position."""
    model = _Model(arm)
    found = Ukf(model, arm.sample_time)
    found.x = model.start(arm, position)
    return found


def filter_run(make: Callable[..., Any], arm: ArmParameters, run: Run) -> tuple[np.ndarray, ...]:
    """Let a filter see what the observer of a run saw.

    Parameters
    ----------
    make : callable
        `make_ekf` or `make_ukf`.
    arm : ArmParameters
        Nominal arm.
    run : Run
        The run.

    Returns
    -------
    tuple of ndarray
        Estimated faults of the position sensors and absolute angles, each (n, 2) [rad].

    Raises
    ------
    LpvError
        If the filter broke down.
    """
    joints, n = JointMap(arm), len(run.time)
    torques = joints.absolute_torque(run.torque)
    y = np.hstack(
        [joints.sensor_position(run.measured), joints.sensor_velocity(run.measured_velocity)]
    )
    y[run.lost] = np.nan
    kalman, states = make(arm, run.measured[0]), np.zeros((n, 6))
    states[0] = kalman.x
    try:
        for k in range(1, n):
            kalman.take(y[k], torques[k - 1])
            states[k] = kalman.x
    except np.linalg.LinAlgError as error:
        raise LpvError(f'the Kalman filter broke down at {run.time[k]:.3f} s: {error}') from error
    if not np.isfinite(states).all():
        raise LpvError('the Kalman filter diverged')
    return states[:, 4:], states[:, :2]
