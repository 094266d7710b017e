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

J = np.array([[1.0, 0.0], [-1.0, 1.0]])
"""Joint velocities from absolute ones, q' = J theta'."""
J_INVERSE = np.array([[1.0, 0.0], [1.0, 1.0]])


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

    def __init__(self, arm):
        self._zero = np.array([arm.zero_angle, 0.0])
        self.sensor_matrix = np.eye(2) if arm.arrangement == 'absolute' else J.copy()
        self._sensor_inverse = np.linalg.inv(self.sensor_matrix)

    def absolute_position(self, joint):
        """Absolute angles [rad] from joint positions [rad]."""
        return (np.asarray(joint, float) + self._zero) @ J_INVERSE.T

    def joint_position(self, absolute):
        """Joint positions [rad] from absolute angles [rad]."""
        return np.asarray(absolute, float) @ J.T - self._zero

    def absolute_velocity(self, joint):
        """Absolute rates from joint rates; also accelerations [rad/s], [rad/s2]."""
        return np.asarray(joint, float) @ J_INVERSE.T

    def joint_velocity(self, absolute):
        """Joint rates from absolute rates; also accelerations [rad/s], [rad/s2]."""
        return np.asarray(absolute, float) @ J.T

    def absolute_torque(self, joint):
        """Generalised torques Q of the absolute angles from joint torques tau [N m]."""
        return np.asarray(joint, float) @ J

    def joint_torque(self, absolute):
        """Joint torques tau from generalised torques Q of the absolute angles [N m]."""
        return np.asarray(absolute, float) @ J_INVERSE

    def sensor_position(self, joint):
        """Readings S theta of the physical sensors [rad] from joint positions [rad]."""
        return self.absolute_position(joint) @ self.sensor_matrix.T

    def joint_from_sensor(self, sensor):
        """Joint positions [rad] from readings of the physical sensors [rad]."""
        return self.joint_position(np.asarray(sensor, float) @ self._sensor_inverse.T)

    def sensor_velocity(self, joint):
        """Rates S theta' [rad/s] from joint rates [rad/s]."""
        return self.absolute_velocity(joint) @ self.sensor_matrix.T

    def joint_velocity_from_sensor(self, sensor):
        """Joint rates [rad/s] from rates S theta' [rad/s]."""
        return self.joint_velocity(np.asarray(sensor, float) @ self._sensor_inverse.T)
