"""The one place that converts between ROS joints, the model's angles and physical sensors.

Three sets of coordinates occur:

* **joint**: what ``sensor_msgs/JointState`` carries.  q1 is measured from the zero of the robot's
  description, q2 is RELATIVE to link 1; both count counter-clockwise (REP-103).
* **absolute**: what the paper's dynamics use.  Both angles are measured from the upper vertical,
  theta1 = q1 + z, theta2 = q1 + q2 + z, where z is the arm's ``zero_angle`` (-pi/2 for a q1 from
  the x-axis, as in eqs. (32)-(34); pi for an arm that hangs down at q1 = 0).
* **sensor**: what the two physical position sensors read, s = S theta.  S = I for sensors of the
  absolute angles (the paper's Df, eq. (30)) and S = [[1, 0], [-1, 1]] for joint encoders, whose
  fault of encoder 1 shifts both absolute angles.

With theta' = J^-1 q', J = [[1, 0], [-1, 1]], power tau.q' = Q.theta' gives the generalised torques
Q = J^T tau, that is Q1 = tau1 - tau2 and Q2 = tau2.
"""

import numpy as np
from numpy.typing import ArrayLike

from lpv_core.model.arm import ArmParameters
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

J = np.array([[1.0, 0.0], [-1.0, 1.0]])
"""Joint velocities from absolute ones, q' = J theta'."""
J_INVERSE = np.array([[1.0, 0.0], [1.0, 1.0]])

JOINT_MAP = record_type(
    ('zero', 'f8'),
    ('sensor', 'f8', (2, 2)),
    ('angle', 'f8', (2, 2)),
    ('from_joint', 'f8', (2, 2)),
    ('to_joint', 'f8', (2, 2)),
    ('j', 'f8', (2, 2)),
    ('j_inverse', 'f8', (2, 2)),
)
"""Matrices of a `JointMap` for compiled functions: zero angle [rad]; S, S^-1, S J^-1, J S^-1, J,
J^-1."""


@njit
def row_dot(matrix: np.ndarray, row: int, first: float, second: float) -> float:
    """One row of matrix @ (first, second), leaving zero coefficients out as `JointMap` does."""
    if matrix[row, 0] == 0.0:
        return matrix[row, 1] * second
    if matrix[row, 1] == 0.0:
        return matrix[row, 0] * first
    return matrix[row, 0] * first + matrix[row, 1] * second


@njit
def joint_angle(
    params: np.record, matrix: np.ndarray, row: int, first: float, second: float
) -> float:
    """Joint position: one row of matrix @ (first, second), less the zero."""
    return row_dot(matrix, row, first, second) - (params.zero if row == 0 else 0.0)


def _apply(matrix: np.ndarray, values: ArrayLike) -> np.ndarray:
    """matrix @ values over the last axis, leaving zero coefficients out.

    A sensor that delivers NaN must not spoil readings that do not depend on it: 0*NaN is NaN.
    """
    values = np.asarray(values, float)
    rows = []
    for row in matrix:
        terms = [c * values[..., j] for j, c in enumerate(row) if c != 0.0]
        rows.append(sum(terms[1:], terms[0]))
    return np.stack(rows, axis=-1)


class JointMap:
    """Conversions for one arm; every method takes and returns arrays of shape (..., 2).

    Parameters
    ----------
    arm : ArmParameters
        Supplies ``zero_angle`` and the sensor ``arrangement``.

    Attributes
    ----------
    sensor_matrix : ndarray, shape (2, 2)
        S of s = S theta.
    """

    def __init__(self, arm: ArmParameters) -> None:
        self._zero = np.array([arm.zero_angle, 0.0])
        self.sensor_matrix = np.eye(2) if arm.arrangement == 'absolute' else J.copy()
        self._from_joint = self.sensor_matrix @ J_INVERSE
        self._to_joint = J @ np.linalg.inv(self.sensor_matrix)

    def record(self) -> np.record:
        """The matrices for compiled functions."""
        return new_record(
            JOINT_MAP,
            zero=self._zero[0],
            sensor=self.sensor_matrix,
            angle=np.linalg.inv(self.sensor_matrix),
            from_joint=self._from_joint,
            to_joint=self._to_joint,
            j=J,
            j_inverse=J_INVERSE,
        )

    def absolute_position(self, joint: ArrayLike) -> np.ndarray:
        """Absolute angles [rad] from joint positions [rad]."""
        return _apply(J_INVERSE, np.asarray(joint, float) + self._zero)

    def joint_position(self, absolute: ArrayLike) -> np.ndarray:
        """Joint positions [rad] from absolute angles [rad]."""
        return _apply(J, absolute) - self._zero

    def absolute_velocity(self, joint: ArrayLike) -> np.ndarray:
        """Absolute rates from joint rates; also accelerations [rad/s], [rad/s2]."""
        return _apply(J_INVERSE, joint)

    def joint_velocity(self, absolute: ArrayLike) -> np.ndarray:
        """Joint rates from absolute rates; also accelerations [rad/s], [rad/s2]."""
        return _apply(J, absolute)

    def absolute_torque(self, joint: ArrayLike) -> np.ndarray:
        """Generalised torques Q of the absolute angles from joint torques tau [N m]."""
        return _apply(J.T, joint)

    def joint_torque(self, absolute: ArrayLike) -> np.ndarray:
        """Joint torques tau from generalised torques Q of the absolute angles [N m]."""
        return _apply(J_INVERSE.T, absolute)

    def sensor_position(self, joint: ArrayLike) -> np.ndarray:
        """Readings S theta of the physical sensors [rad] from joint positions [rad]."""
        return _apply(self._from_joint, np.asarray(joint, float) + self._zero)

    def joint_from_sensor(self, sensor: ArrayLike) -> np.ndarray:
        """Joint positions [rad] from readings of the physical sensors [rad]."""
        return _apply(self._to_joint, sensor) - self._zero

    def sensor_velocity(self, joint: ArrayLike) -> np.ndarray:
        """Rates S theta' [rad/s] from joint rates [rad/s]."""
        return _apply(self._from_joint, joint)

    def joint_velocity_from_sensor(self, sensor: ArrayLike) -> np.ndarray:
        """Joint rates [rad/s] from rates S theta' [rad/s]."""
        return _apply(self._to_joint, sensor)
