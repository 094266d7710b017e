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

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import new_record, record_type

J = np.array([[1.0, 0.0], [-1.0, 1.0]])
"""Joint velocities from absolute ones, q' = J theta'."""
J_INVERSE = np.array([[1.0, 0.0], [1.0, 1.0]])

JOINT_MAP = record_type(
    ('zero', 'f8'),  # zero angle [rad]
    ('sensor', 'f8', (2, 2)),  # S
    ('angle', 'f8', (2, 2)),  # S^-1
    ('from_joint', 'f8', (2, 2)),  # S J^-1: joints to sensors
    ('to_joint', 'f8', (2, 2)),  # J S^-1
    ('j', 'f8', (2, 2)),  # J
)
"""Matrices of a `JointMap` for compiled functions."""


@njit
def copy_vector(values: np.ndarray, to: np.ndarray) -> None:
    """Copy element by element: in compiled functions a slice would make an array."""
    for i in range(values.shape[0]):
        to[i] = values[i]


@njit
def row_dot(matrix: np.ndarray, row: int, first: float, second: float) -> float:
    """One row of matrix @ (first, second)."""
    return matrix[row, 0] * first + matrix[row, 1] * second


@njit
def row_size(matrix: np.ndarray, row: int, first: float, second: float) -> float:
    """Largest absolute value of that row for numbers of at most these sizes."""
    return abs(matrix[row, 0]) * first + abs(matrix[row, 1]) * second


class JointMap:
    """Conversions for one arm; every method takes and returns arrays of shape (..., 2).

    Angles are in rad, rates in rad/s (or accelerations in rad/s2), torques in N m.

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

    def record(self) -> np.record:
        """The matrices for compiled functions, of type `JOINT_MAP`."""
        s, inverse = self.sensor_matrix, np.linalg.inv(self.sensor_matrix)
        return new_record(
            JOINT_MAP, zero=self._zero[0], sensor=s, angle=inverse, from_joint=s @ J_INVERSE,
            to_joint=J @ inverse, j=J,
        )  # fmt: skip

    def absolute_position(self, joint: ArrayLike) -> np.ndarray:
        """Absolute angles from joint positions."""
        return (np.asarray(joint, float) + self._zero) @ J_INVERSE.T

    def joint_position(self, absolute: ArrayLike) -> np.ndarray:
        """Joint positions from absolute angles."""
        return np.asarray(absolute, float) @ J.T - self._zero

    def absolute_velocity(self, joint: ArrayLike) -> np.ndarray:
        """Absolute rates from joint rates."""
        return np.asarray(joint, float) @ J_INVERSE.T

    def joint_velocity(self, absolute: ArrayLike) -> np.ndarray:
        """Joint rates from absolute rates."""
        return np.asarray(absolute, float) @ J.T

    def absolute_torque(self, joint: ArrayLike) -> np.ndarray:
        """Generalised torques Q of the absolute angles from joint torques tau."""
        return np.asarray(joint, float) @ J

    def joint_torque(self, absolute: ArrayLike) -> np.ndarray:
        """Joint torques tau from generalised torques Q of the absolute angles."""
        return np.asarray(absolute, float) @ J_INVERSE
