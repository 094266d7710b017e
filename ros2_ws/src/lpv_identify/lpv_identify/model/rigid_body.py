"""Rigid-body regressors of a serial arm, by Pinocchio."""

import numpy as np
import pinocchio

from lpv_core.serial_arm.description import N_INERTIAL, SerialArm, rotation_from_rpy

_STEP = 1e-5  # of the central difference along the motion [s]


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


def momentum_regressor(
    model: pinocchio.Model, position: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Regressor P of the momentum, p = M(q) v = P phi.

    Parameters
    ----------
    model : pinocchio.Model
        Of the arm, with n joints.
    position, velocity : ndarray, shape (samples, n)
        [rad], [rad/s].

    Returns
    -------
    ndarray, shape (samples, n, 10 n)
        phi holds the standard inertial parameters of all links.
    """
    still = np.zeros(model.nv)
    return torque_regressor(model, position, still, velocity) - torque_regressor(
        model, position, still, still
    )


def motion_regressor(
    model: pinocchio.Model, position: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Regressor S of the momentum balance tau = d/dt p + S phi: S phi = g(q) - C(q, v)^T v.

    From the property dM/dt = C + C^T: S = Y(q, v, 0) - (dM/dt) v, the latter by a central
    difference along the motion.  Shapes as those of `momentum_regressor`.
    """
    ahead = momentum_regressor(model, position + _STEP * velocity, velocity)
    behind = momentum_regressor(model, position - _STEP * velocity, velocity)
    still = np.zeros(model.nv)
    return torque_regressor(model, position, velocity, still) - (ahead - behind) / (2.0 * _STEP)


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
