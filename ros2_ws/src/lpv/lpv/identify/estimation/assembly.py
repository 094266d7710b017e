"""From fitted base parameters to the parameters of an arm's links and drives."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from lpv.core.serial_arm.description import (
    N_INERTIAL,
    JointFriction,
    LinkInertia,
    ParameterCovariance,
    SerialArm,
)
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.regression import Fit
from lpv.identify.estimation.robust import roots
from lpv.identify.model.friction import TERMS, least_viscous
from lpv.identify.model.prior import parameter_map
from lpv.identify.model.rigid_body import STANDARD, BaseParameters

_MARGIN = 1e-7  # smallest eigenvalue of a pseudo-inertia: ten times the tolerance of the solver


def _columns(term: str, joints: int) -> np.ndarray:
    """Places of a friction term of all joints in `SerialArm.parameter_vector`."""
    return (STANDARD + TERMS.index(term)) * joints + np.arange(joints)


def consistent_parameters(arm: SerialArm, base: BaseParameters, fit: Fit) -> np.ndarray:
    """Physically consistent `SerialArm.parameter_vector` that fits best, shape (15 n,)."""
    n, (mean, sigma) = len(arm.joints), fit.prior.whole
    lower, upper = np.full(len(mean), -np.inf), np.full(len(mean), np.inf)
    lower[N_INERTIAL * n :] = 0.0  # rotors and friction
    lower[_columns('offset', n)] = -np.inf
    upper[_columns('load', n)] = 1.0
    passive = np.eye(len(mean))
    limits = np.array(arm.velocity_limit)
    passive[_columns('viscous', n), _columns('coulomb', n)] = least_viscous(fit.slope, limits)
    root, inverse = roots(fit.normal)
    root = root @ parameter_map(base, n) @ passive
    target = inverse @ fit.right
    mean = np.linalg.solve(passive, mean)
    held = sigma / np.sqrt(fit.prior.strength)
    return passive @ _nearest_consistent(root, target, mean, held, n, (lower, upper))


def _nearest_consistent(
    root: np.ndarray,
    target: np.ndarray,
    mean: np.ndarray,
    sigma: np.ndarray,
    joints: int,
    bounds: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Parameters x of bodies of positive mass whose root @ x is nearest to a target, with a prior;
    IdentificationError without."""
    # Each link's pseudo-inertia is positive semidefinite (Wensing, Kim, Slotine 2018, equation 12).
    size = max(1.0, float(np.linalg.norm(root * sigma)))  # solvers like costs of moderate size
    rows, count = root.shape[0], len(mean)
    # Variables are x in units of the prior, and the residuals of the data.
    cost = sparse.diags(np.append(np.full(count, 2.0 / size**2), np.full(rows, 2.0)))
    lower, upper = ((b - mean) / sigma for b in bounds)
    above, below, eye = np.isfinite(lower), np.isfinite(upper), np.eye(count)
    matrices, rights = [-eye[above], eye[below]], [-lower[above], upper[below]]
    for part in np.split(np.arange(N_INERTIAL * joints), joints):
        matrix, right = _pseudo_inertia(mean[part], sigma[part])
        matrices.append(-matrix @ eye[part])
        rights.append(right)
    bounded = np.vstack(matrices)
    fit = np.hstack([root * sigma / size, -np.eye(rows)])
    left = np.vstack([fit, np.hstack([bounded, np.zeros((len(bounded), rows))])])
    right = np.concatenate([(target - root @ mean) / size, *rights])
    cones = [
        clarabel.ZeroConeT(rows),
        clarabel.NonnegativeConeT(int(above.sum() + below.sum())),
        *(clarabel.PSDTriangleConeT(4) for _ in range(joints)),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.static_regularization_constant = 1e-10  # 1e-8 may go round in circles, and is slower
    programme = sparse.csc_matrix(cost), np.zeros(count + rows), sparse.csc_matrix(left), right
    solution = clarabel.DefaultSolver(*programme, cones, settings).solve()
    if str(solution.status) not in ('Solved', 'AlmostSolved'):
        raise IdentificationError(
            f'no physically consistent inertias were found ({solution.status})'
        )
    return np.clip(mean + sigma * np.array(solution.x[:count]), *bounds)


def _pseudo_inertia(mean: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pseudo-inertia M x + b of a link less a margin, in the solver's form, scaled to 1."""
    length_unit = sigma[1] / sigma[0]
    unit = sigma[0] * np.array([1.0] + [length_unit] * 3 + [length_unit**2] * 6)
    return _PSEUDO @ np.diag(sigma / unit), _PSEUDO @ (mean / unit) - _MARGIN * _UNIT


def _triangle(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle by columns, entries off the diagonal times sqrt(2): norms stay."""
    return np.array(
        [matrix[i, j] * (1.0 if i == j else np.sqrt(2.0)) for j in range(4) for i in range(j + 1)]
    )


_PSEUDO = np.stack(
    [_triangle(LinkInertia.from_vector(row).pseudo_inertia()) for row in np.eye(N_INERTIAL)], axis=1
)
_UNIT = _triangle(np.eye(4))


def with_parameters(arm: SerialArm, values: np.ndarray, slope: np.ndarray) -> SerialArm:
    """Arm with other parameters; ``values`` as `SerialArm.parameter_vector` gives them."""
    n = len(arm.joints)
    links = values[: N_INERTIAL * n].reshape(n, N_INERTIAL)
    rotors, viscous, coulomb, load, offset = values[N_INERTIAL * n :].reshape(-1, n).tolist()
    terms = zip(offset, viscous, coulomb, slope.tolist(), load)
    return with_joint_values(
        arm,
        link=[LinkInertia.from_vector(link) for link in links],
        friction=[JointFriction(*one) for one in terms],
        rotor_inertia=rotors,
    )


def with_joint_values(arm: SerialArm, **values: Iterable[Any]) -> SerialArm:
    """Arm with other values of some fields of `SerialJoint`, one for each joint."""
    changes = [dict(zip(values, row)) for row in zip(*values.values(), strict=True)]
    joints = zip(arm.joints, changes, strict=True)
    return replace(arm, joints=tuple(replace(joint, **change) for joint, change in joints))


def covariance_of_all(
    arm: SerialArm, base: BaseParameters, fit: Fit, determined: int
) -> ParameterCovariance:
    """Covariance of all parameters: what the fit says of its own ones, and the prior beside."""
    _, sigma = fit.prior.whole
    size = len(fit.parameters)
    turn, upper = np.linalg.qr((parameter_map(base, len(arm.joints)) * sigma).T, mode='complete')
    fitted, others = turn[:, :size], turn[:, size:]  # directions in units of sigma
    spread = np.sqrt(np.diag(fit.covariance)) + 1e-300
    values, vectors = np.linalg.eigh(fit.covariance / np.outer(spread, spread))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * spread
    inverse = np.linalg.solve(upper[:size], fitted.T)
    factor = sigma * np.vstack([root @ inverse, others.T])
    rounded = (tuple(float(f'{v:.6g}') for v in row) for row in factor)
    return ParameterCovariance(tuple(rounded), determined)


def fit_of(arm: SerialArm, base: BaseParameters, fit: Fit) -> Fit:
    """The fit whose parameters are those of an arm, for predictions."""
    values = parameter_map(base, len(arm.joints)) @ arm.parameter_vector()
    slope = np.array([joint.friction.coulomb_slope for joint in arm.joints])
    return replace(fit, parameters=values, slope=slope)
