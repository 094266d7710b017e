"""Rigid-body regressors of a serial arm, by Pinocchio."""

import numpy as np
import pinocchio

from lpv_core.serial_arm.description import N_INERTIAL, SerialArm, rotation_from_rpy


def build_model(arm: SerialArm) -> pinocchio.Model:
    """Pinocchio's model of an arm, with the joint frames and link frames of the arm."""
    model = pinocchio.Model()
    model.gravity = pinocchio.Motion(arm.gravity_vector(), np.zeros(3))
    parent = 0
    for joint in arm.joints:
        placement = pinocchio.SE3(rotation_from_rpy(joint.orientation), np.array(joint.position))
        kind = pinocchio.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, placement, joint.name)
        inertia = pinocchio.Inertia.FromDynamicParameters(joint.link.to_vector())
        model.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
    return model


def torque_regressor(
    model: pinocchio.Model, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Regressor Y of the inverse dynamics, tau = Y(q, v, a) phi, shape (samples, n, 10 n).

    Arguments of shape (samples, n) or (n,) [rad], [rad/s], [rad/s2].
    """
    position, velocity, acceleration = np.broadcast_arrays(position, velocity, acceleration)
    data = model.createData()
    result = np.empty((len(position), model.nv, N_INERTIAL * model.nv))
    for k in range(len(position)):
        result[k] = pinocchio.computeJointTorqueRegressor(
            model, data, position[k], velocity[k], acceleration[k]
        )
    return result
