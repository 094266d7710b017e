"""Motions of a planar arm as joint-space samples."""

import math

import numpy as np

from lpv.core.uio.model.dynamics import coupling, inverse_dynamics
from lpv.core.uio.model.joints import JointMap


def energy(theta_1, theta_2, rate_1, rate_2, params):
    """Kinetic plus potential energy [J]; conserved without torque, friction and disturbance."""
    off = coupling(theta_1, theta_2, params)
    kinetic = 0.5 * (params.inertia[0] * rate_1**2 + params.inertia[1] * rate_2**2)
    potential = params.gravity[0] * math.cos(theta_1) + params.gravity[1] * math.cos(theta_2)
    return kinetic + off * rate_1 * rate_2 + potential


class Swing:
    """A smooth motion about the vertical as joint-space samples with their exact torques."""

    def __init__(self, arm):
        self.joints, self.c = JointMap(arm), arm.constants()
        self.rest = 0.0 if arm.orientation == 'upright' else math.pi

    def absolute(self, t):
        return (
            self.rest + np.array([0.5 * math.sin(1.1 * t), 0.3 * math.sin(1.7 * t)]),
            np.array([0.55 * math.cos(1.1 * t), 0.51 * math.cos(1.7 * t)]),
            np.array([-0.605 * math.sin(1.1 * t), -0.867 * math.sin(1.7 * t)]),
        )

    def torque(self, t):
        """Of both links, such that the arm moves as it does."""
        return np.array(inverse_dynamics(*np.concatenate(self.absolute(t)), self.c))

    def outputs(self, t, fault=(0.0, 0.0)):
        """Readings and rates of both sensors."""
        theta, rate, _ = self.absolute(t)
        s = self.joints.sensor_matrix
        return np.concatenate([s @ theta + fault, s @ rate])

    def sample(self, t, dt=0.002, fault=(0.0, 0.0)):
        """Positions, rates and efforts of the joints; the effort acted over the interval before."""
        theta, rate, _ = self.absolute(t)
        wrong = np.linalg.solve(self.joints.sensor_matrix, fault)
        return (
            self.joints.joint_position(theta + wrong),
            self.joints.joint_velocity(rate),
            self.joints.joint_torque(self.torque(t - dt / 2)),
        )

    def position(self, t):
        return self.joints.joint_position(self.absolute(t)[0])
