"""From fitted base parameters to the parameters of an arm's links and drives."""

from dataclasses import replace

import numpy as np

from lpv.core.serial_arm.description import (
    N_INERTIAL,
    JointFriction,
    LinkInertia,
    ParameterCovariance,
    SerialArm,
)
from lpv.identify.estimation.regression import Fit
from lpv.identify.estimation.robust import roots
from lpv.identify.model.base_parameters import BaseParameters
from lpv.identify.model.consistency import nearest_consistent
from lpv.identify.model.friction import TERMS, least_viscous
from lpv.identify.model.prior import LOAD_WIDTH, structural_prior
from lpv.identify.model.rigid_body import STANDARD


def _columns(term: str, joints: int) -> np.ndarray:
    """Places of a friction term of all joints in `SerialArm.parameter_vector`."""
    return (STANDARD + TERMS.index(term)) * joints + np.arange(joints)


def parameter_map(base: BaseParameters, joints: int) -> np.ndarray:
    """Matrix T that leads from `SerialArm.parameter_vector` to the parameters of a `Fit`."""
    terms, structural = len(TERMS), STANDARD * joints
    result = np.zeros((base.size + terms * joints, structural + terms * joints))
    result[: base.size, :structural] = base.combination
    for k, term in enumerate(TERMS):
        result[base.size + terms * np.arange(joints) + k, _columns(term, joints)] = 1.0
    return result


def prior_of_all(arm: SerialArm, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Mean and width of all parameters of an arm; friction is as good as free."""
    mean, sigma = structural_prior(arm)
    size = np.maximum(np.abs(fit.friction), 10.0 * np.maximum(fit.scale, 1e-6)[:, None])
    width = 10.0 * size
    width[:, TERMS.index('load')] = LOAD_WIDTH
    return np.append(mean, np.zeros(width.size)), np.append(sigma, width.T)


def consistent_parameters(
    arm: SerialArm, base: BaseParameters, fit: Fit, strength: float
) -> np.ndarray:
    """Physically consistent `SerialArm.parameter_vector` that fits best, shape (15 n,)."""
    n = len(arm.joints)
    mean, sigma = prior_of_all(arm, fit)
    lower, upper = np.full(len(mean), -np.inf), np.full(len(mean), np.inf)
    lower[N_INERTIAL * n :] = 0.0  # rotors and friction
    lower[_columns('offset', n)] = -np.inf
    upper[_columns('load', n)] = np.where(fit.used_load, 1.0, 0.0)
    passive = np.eye(len(mean))
    limits = np.array([joint.limits.velocity for joint in arm.joints])
    passive[_columns('viscous', n), _columns('coulomb', n)] = least_viscous(fit.slope, limits)
    root, inverse = roots(fit.normal / strength)
    root = root @ parameter_map(base, n) @ passive
    target = inverse @ fit.right / strength
    return passive @ nearest_consistent(root, target, mean, sigma, n, (lower, upper))


def with_parameters(arm: SerialArm, values: np.ndarray, slope: np.ndarray) -> SerialArm:
    """Arm with other parameters; ``values`` as `SerialArm.parameter_vector` gives them."""
    n = len(arm.joints)
    links = values[: N_INERTIAL * n].reshape(n, N_INERTIAL)
    drives = values[N_INERTIAL * n :].reshape(-1, n).T.tolist()
    joints = []
    for joint, link, drive, bend in zip(arm.joints, links, drives, slope.tolist()):
        rotor, viscous, coulomb, load, offset = drive
        friction = JointFriction(offset, viscous, coulomb, bend, load)
        body = LinkInertia.from_vector(link)
        joints.append(replace(joint, link=body, friction=friction, rotor_inertia=rotor))
    return replace(arm, joints=tuple(joints))


def covariance_of_all(
    arm: SerialArm, base: BaseParameters, fit: Fit, determined: int
) -> ParameterCovariance:
    """Covariance (T^T Sigma^-1 T + Sigma_0^-1)^-1 of all parameters, of fit and prior."""
    n = len(arm.joints)
    _, sigma = prior_of_all(arm, fit)
    known = np.flatnonzero(np.diag(fit.covariance) > 0.0)
    scale = np.sqrt(np.diag(fit.covariance)[known])
    values, vectors = np.linalg.eigh(fit.covariance[np.ix_(known, known)] / np.outer(scale, scale))
    values = np.maximum(values, 1e-9 * values[-1])
    transform = (parameter_map(base, n) * sigma)[known] / scale[:, None]
    root = (vectors / np.sqrt(values)).T @ transform
    # Not by a Cholesky factor of the sum: squares of what fits far too well hide the prior.
    upper = np.asarray(np.linalg.qr(np.vstack([root, np.eye(len(sigma))]), mode='r'))
    factor = np.linalg.solve(upper.T, np.diag(sigma))
    factor[:, _columns('load', n)[~fit.used_load]] = 0.0
    rounded = (tuple(float(f'{v:.6g}') for v in row) for row in factor)
    return ParameterCovariance(tuple(rounded), determined)


def fit_of(arm: SerialArm, base: BaseParameters, fit: Fit) -> Fit:
    """The fit whose parameters are those of an arm, for predictions."""
    values = parameter_map(base, len(arm.joints)) @ arm.parameter_vector()
    slope = np.array([joint.friction.coulomb_slope for joint in arm.joints])
    return replace(fit, parameters=values, slope=slope)
