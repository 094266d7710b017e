"""From fitted base parameters to the parameters of an arm's links and drives."""

from dataclasses import replace

import numpy as np

from lpv_core.serial_arm.description import (
    N_INERTIAL,
    JointFriction,
    LinkInertia,
    ParameterCovariance,
    SerialArm,
)
from lpv_identify.estimation.regression import Fit
from lpv_identify.model.base_parameters import BaseParameters
from lpv_identify.model.consistency import Quadratic, nearest_consistent
from lpv_identify.model.friction import TERMS
from lpv_identify.model.prior import LOAD_WIDTH, structural_prior

_DRIVE = ('rotor', *TERMS)


def parameter_map(base: BaseParameters, joints: int) -> np.ndarray:
    """Matrix T that leads from `SerialArm.parameter_vector` to the parameters of a `Fit`."""
    terms = len(TERMS)
    result = np.zeros((base.size + terms * joints, (N_INERTIAL + len(_DRIVE)) * joints))
    structural = (N_INERTIAL + 1) * joints
    result[: base.size, :structural] = base.combination
    for k in range(terms):
        for j in range(joints):
            result[base.size + terms * j + k, structural + joints * k + j] = 1.0
    return result


def prior_of_all(arm: SerialArm, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Mean and width of all parameters of an arm; friction is as good as free."""
    mean, sigma = structural_prior(arm)
    size = np.maximum(np.abs(fit.friction), 10.0 * np.maximum(fit.scale, 1e-6)[:, None])
    width = 10.0 * size
    width[:, TERMS.index('load')] = LOAD_WIDTH
    friction = width.T.ravel()
    return (np.concatenate([mean, np.zeros(friction.size)]), np.concatenate([sigma, friction]))


def consistent_parameters(
    arm: SerialArm, base: BaseParameters, fit: Fit, strength: float
) -> np.ndarray:
    """Physically consistent parameters that fit the data as well as those can.

    As `SerialArm.parameter_vector`, shape (15 n,).  Of ``fit`` the rows are used, not the
    parameters; ``strength`` is the weight of the prior, which ``arm`` has, against the data.
    """
    n = len(arm.joints)
    mean, sigma = prior_of_all(arm, fit)
    lower, upper = np.full(len(mean), -np.inf), np.full(len(mean), np.inf)
    lower[N_INERTIAL * n : (N_INERTIAL + 1) * n] = 0.0  # rotors
    for k, name in enumerate(TERMS):
        part = slice((N_INERTIAL + 1 + k) * n, (N_INERTIAL + 2 + k) * n)
        if name != 'offset':
            lower[part] = 0.0
        if name == 'load':
            upper[part] = np.where(fit.used_load, 1.0, 0.0)
    passive = np.eye(len(mean))
    viscous = (N_INERTIAL + 1 + TERMS.index('viscous')) * n + np.arange(n)
    coulomb = (N_INERTIAL + 1 + TERMS.index('coulomb')) * n + np.arange(n)
    # Friction may fall with speed, but drives at none up to the limit.
    passive[viscous, coulomb] = [-1.0 / joint.limits.velocity for joint in arm.joints]
    data = Quadratic(parameter_map(base, n) @ passive, fit.normal / strength, fit.right / strength)
    return passive @ nearest_consistent(data, mean, sigma, n, (lower, upper))


def with_parameters(arm: SerialArm, values: np.ndarray, slope: np.ndarray) -> SerialArm:
    """Arm with other parameters; ``values`` as `SerialArm.parameter_vector` gives them."""
    n = len(arm.joints)
    links = values[: N_INERTIAL * n].reshape(n, N_INERTIAL)
    rotor, viscous, coulomb, load, offset = values[N_INERTIAL * n :].reshape(len(_DRIVE), n)
    joints = []
    for j, joint in enumerate(arm.joints):
        friction = JointFriction(
            float(offset[j]), float(viscous[j]), float(coulomb[j]), float(slope[j]), float(load[j])
        )
        joints.append(
            replace(
                joint,
                link=LinkInertia.from_vector(links[j]),
                friction=friction,
                rotor_inertia=float(rotor[j]),
            )
        )
    return replace(arm, joints=tuple(joints))


def covariance_of_all(
    arm: SerialArm, base: BaseParameters, fit: Fit, determined: int
) -> ParameterCovariance:
    """Covariance of all parameters: of the data where they say more than the prior.

    (T^T Sigma^-1 T + Sigma_0^-1)^-1 with the fit's covariance Sigma and the prior's Sigma_0.
    """
    n = len(arm.joints)
    _, sigma = prior_of_all(arm, fit)
    transform = parameter_map(base, n) * sigma
    known = np.flatnonzero(np.diag(fit.covariance) > 0.0)
    scale = np.sqrt(np.diag(fit.covariance)[known])
    correlation = fit.covariance[np.ix_(known, known)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(correlation)
    values = np.maximum(values, 1e-9 * values[-1])
    root = (vectors / np.sqrt(values)).T @ (transform[known] / scale[:, None])
    information = root.T @ root + np.eye(len(sigma))
    lower = np.linalg.cholesky(information)
    factor = np.linalg.solve(lower, np.diag(sigma))
    held = np.ones(len(sigma), bool)
    held[(N_INERTIAL + 1 + TERMS.index('load')) * n :][:n] = fit.used_load
    factor[:, ~held] = 0.0
    rounded = [[float(f'{v:.6g}') for v in row] for row in factor]
    return ParameterCovariance(tuple(tuple(row) for row in rounded), determined)


def fit_of(arm: SerialArm, base: BaseParameters, fit: Fit) -> Fit:
    """The fit whose parameters are those of an arm, for predictions."""
    values = parameter_map(base, len(arm.joints)) @ arm.parameter_vector()
    slope = np.array([joint.friction.coulomb_slope for joint in arm.joints])
    return replace(fit, parameters=values, slope=slope)
