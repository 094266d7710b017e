"""Directions in which the inertial parameters of an arm may be wrong.

The errors F^T z, z ~ N(0, I), of all parameters have many components that no motion shows.  What
torques show of them is found from sampled motions: E F^T = U S V^T with E the regressors of the
momentum's forces; rows of V^T F are independent directions of unit weight, largest effect first.
"""

import numpy as np

from lpv_core.serial_arm.chain import MASS, MX, Chain, FloatArray, joint_count
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.serial_arm.dynamics.payload import payload_parameters

MODEL_ERROR = 0.05
"""Relative standard deviation of masses and inertias that were not identified."""
_SAMPLES = 100
_NEGLIGIBLE = 0.005
"""Directions with a smaller effect on the torques of all joints, relative to them, are left out."""


def inertial_factor(arm: SerialArm, chain: Chain) -> FloatArray:
    """Square root F of the covariance F^T F of the inertial parameters.

    Parameters
    ----------
    arm : SerialArm
        Its covariance is taken where it was identified, else `MODEL_ERROR`.
    chain : Chain
        The same arm, compiled.

    Returns
    -------
    ndarray, shape (rows, 10 n)
        The last four rows are the unknown payload: mass, and its place by 0.1 m.
    """
    n = joint_count(chain)
    if arm.covariance is not None:
        rows = [np.array(arm.covariance.factor)[:, : 10 * n]]
    else:
        rows = [relative_factor(chain, MODEL_ERROR)]
    mass = arm.uncertainty.payload
    if mass > 0.0:
        load = np.zeros((4, n, 10))
        at_tip = payload_parameters(chain, mass)
        load[0, -1] = at_tip
        for k in range(3):
            load[1 + k, -1, MX + k] = 0.1 * mass
        rows.append(load.reshape(4, -1))
    return np.vstack(rows)


def relative_factor(chain: Chain, relative: float) -> FloatArray:
    """Independent relative errors: mass of each link, place of its mass, and its inertias.

    Parameters
    ----------
    chain : Chain
        The arm.
    relative : float
        Standard deviation of each.

    Returns
    -------
    ndarray, shape (rows, 10 n)
        Rows F of the covariance F^T F.
    """
    n = joint_count(chain)
    rows = []
    for i in range(n):
        body = chain.inertial[i]
        whole = np.zeros((n, 10))
        whole[i] = relative * body
        rows.append(whole)
        reach = np.linalg.norm(body[MX : MX + 3]) / max(body[MASS], 1e-9)
        for k in range(MX, 10):
            size = body[MASS] * reach if k < 4 else np.trace(_inertia(body)) / 2.0
            part = np.zeros((n, 10))
            part[i, k] = relative * size / 2.0
            rows.append(part)
    return np.array(rows).reshape(len(rows), -1)


def _inertia(body: FloatArray) -> FloatArray:
    xx, xy, yy, xz, yz, zz = body[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertial_directions(
    chain: Chain, factor: FloatArray, speed: FloatArray, limit: int = 16
) -> FloatArray:
    """The directions that matter most.

    Parameters
    ----------
    chain : Chain
        The arm.
    factor : ndarray, shape (rows, 10 n)
        F of the covariance F^T F of the inertial parameters.
    speed : ndarray, shape (n,)
        Usual rates [rad/s].
    limit : int, optional
        At most so many directions.

    Returns
    -------
    ndarray, shape (k, n, 10)
        Independent, of standard deviation one.
    """
    n = joint_count(chain)
    model, rng = SerialModel(chain), np.random.default_rng(0)
    forces = []
    for q in _poses(rng, n):
        forces.append(model.momentum_regressor(q, speed * rng.uniform(-1.0, 1.0, n))[1])
    usual = np.sqrt(np.mean([(force @ chain.inertial.ravel()) ** 2 for force in forces], axis=0))
    usual = np.maximum(usual, 0.01 * usual.max() + 1e-9)
    effects = np.array([(force / usual[:, None]) @ factor.T for force in forces])
    right = np.linalg.svd(effects.reshape(-1, len(factor)), full_matrices=False)[2]
    sizes = np.sqrt(((effects @ right.T) ** 2).mean(0)).max(0)
    kept = right[:limit][sizes[:limit] > _NEGLIGIBLE]
    return np.ascontiguousarray((kept @ factor).reshape(len(kept), n, 10))


def _poses(rng: np.random.Generator, joints: int) -> FloatArray:
    return rng.uniform(-np.pi, np.pi, (_SAMPLES, joints))
