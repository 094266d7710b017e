"""FilterPy's extended and unscented Kalman filters with random-walk faults, as peers.

Six states: two absolute angles, two rates, two faults of the position sensors.  Noise as the arm
file states it; the random walk of the faults is what a careful user would choose by trial.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from lpv_core.dynamics import acceleration
from lpv_core.joints import JointMap

FAULT_WALK = 0.02
"""Random walk of the faults [rad/sqrt(s)]."""


class _Model:
    """Equation of motion and measurement of one arm, sampled by Euler's rule."""

    def __init__(self, arm):
        self._constants, self._dt = arm.constants(), arm.sample_time
        self._s = JointMap(arm).sensor_matrix
        self.h = np.block([[self._s, np.zeros((2, 2)), np.eye(2)],
                           [np.zeros((2, 2)), self._s, np.zeros((2, 2))]])
        push = np.sqrt(arm.disturbance_variance) * np.abs(arm.disturbance_direction) + 0.05
        self.q = np.diag([1e-10, 1e-10, *(push**2 * self._dt**2),
                          *[FAULT_WALK**2 * self._dt] * 2])
        self.r = np.diag([arm.position_noise**2] * 2 + [arm.velocity_noise**2] * 2)

    def move(self, x, torque):
        """State one sample later."""
        rate = np.array(acceleration(*x[:4], *torque, self._constants))
        return np.concatenate([x[:2] + self._dt * x[2:4], x[2:4] + self._dt * rate, x[4:]])

    def start(self, arm, position):
        """State without faults."""
        return np.concatenate([JointMap(arm).absolute_position(position), np.zeros(4)])


class Ekf(ExtendedKalmanFilter):
    """Extended filter; Jacobian by differences."""

    def __init__(self, model):
        super().__init__(dim_x=6, dim_z=4)
        self._model = model
        self.Q, self.R = model.q, model.r
        self.P = np.diag([1e-6] * 4 + [1e-6] * 2)

    def predict_x(self, u=0):
        """As FilterPy asks."""
        x = self.x.ravel()
        moved = self._model.move(x, u)
        self.F = np.eye(6)
        for j in range(4):
            step = np.zeros(6)
            step[j] = 1e-6
            self.F[:, j] = (self._model.move(x + step, u) - moved) / 1e-6
        self.x = moved

    def take(self, y, torque):
        """One measurement; the fault estimates [rad]."""
        self.predict(torque)
        self.update(y, lambda _: self._model.h, lambda x: self._model.h @ x)
        return self.x[4:]


class Ukf(UnscentedKalmanFilter):
    """Unscented filter."""

    def __init__(self, model, dt):
        super().__init__(6, 4, dt, lambda x: model.h @ x,
                         lambda x, dt, torque: model.move(x, torque),
                         MerweScaledSigmaPoints(6, 0.1, 2.0, -3.0))
        self.Q, self.R = model.q, model.r
        self.P = np.diag([1e-6] * 4 + [1e-6] * 2)

    def take(self, y, torque):
        """One measurement; the fault estimates [rad]."""
        self.predict(torque=torque)
        self.update(y)
        return self.x[4:]


def make_ekf(arm, position):
    """Extended filter, started without faults at a joint position."""
    model = _Model(arm)
    found = Ekf(model)
    found.x = model.start(arm, position)
    return found


def make_ukf(arm, position):
    """Unscented filter, started without faults at a joint position."""
    model = _Model(arm)
    found = Ukf(model, arm.sample_time)
    found.x = model.start(arm, position)
    return found
