"""Directions in which the parameters of an arm may be wrong.

The errors F^T z, z ~ N(0, I), of all parameters have many components that no motion shows.  What
torques show of them is found from sampled motions: E F^T = U S V^T with E the regressors of the
momentum's forces and of friction; rows of V^T F are independent directions of unit weight, largest
effect first.  An identification knows masses and friction better together than each for itself.
"""

import numpy as np

from lpv.core.serial_arm.chain import COULOMB as DRY
from lpv.core.serial_arm.chain import MASS, MX, SLOPE, VISCOUS, Chain, FloatArray, joint_count
from lpv.core.serial_arm.description import SerialArm, inertia_matrix
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import DELAY_PART, READINGS_AT_EDGES
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import PAYLOAD_PLACE, payload_parameters

LOAD_ROWS = 4
"""Of the unknown payload: its mass, and its place along three axes."""
_SAMPLES = 300
"""Poses, or motions, over which root mean squares are taken: these are right within 3 %."""
NEGLIGIBLE = 0.001
"""Directions with a smaller effect on the torques of all joints, relative to them, are left out: in
a horizon of balances, sensors of 0.1 mrad show 0.1 % of a wrist's torque."""


def parameter_factor(arm: SerialArm, chain: Chain) -> FloatArray:
    """Square root F of the covariance F^T F of inertial parameters, friction and gains of drives.

    The covariance is that of the identification, if there was one, else `MODEL_ERROR` without
    friction.  The 15 n columns are 10 inertial parameters of each link; viscous, Coulomb and
    load-dependent friction, offsets and relative gains of all joints.  Rows of the unknown payload
    are its mass, and its place by `PAYLOAD_PLACE`.  Where efforts are no torques, gains of drives
    are known as well as masses are; those that were identified hold for the arm as it was, not for
    its load.  Rows of the payload are the last `LOAD_ROWS`.
    """
    n = joint_count(chain)
    if arm.covariance is not None:
        factor = np.array(arm.covariance.factor)
        identified = np.delete(factor, np.arange(10 * n, 11 * n), 1)  # all but the rotors
        rows = [_with_drives(identified, n)]
    else:
        rows = [_with_drives(relative_factor(chain, model_error(arm)), n)]
    if arm.effort_unit != 'N m':
        rows.append(np.hstack([np.zeros((n, 14 * n)), model_error(arm) * np.eye(n)]))
    mass = usual_load(arm)
    if mass > 0.0:
        load = np.zeros((LOAD_ROWS, n, 10))
        at_tip = payload_parameters(chain, mass)
        load[0, -1] = at_tip
        for k in range(3):
            load[1 + k, -1, MX + k] = PAYLOAD_PLACE * mass
        rows.append(_with_drives(load.reshape(LOAD_ROWS, -1), n))
    return np.vstack(rows)


def model_error(arm: SerialArm) -> float:
    """Relative standard deviation of masses and inertias; that of the file, if it states one."""
    return arm.uncertainty.model_error or priors.MODEL_ERROR


def usual_load(arm: SerialArm) -> float:
    """Standard deviation of the mass that the arm carries: as the file states, if it does [kg]."""
    if arm.uncertainty.payload is not None:
        return arm.uncertainty.payload
    return priors.UNSTATED_LOAD * sum(joint.link.mass for joint in arm.joints)


def typical_torque(chain: Chain, scale: FloatArray) -> FloatArray:
    """Torques that move the arm, whatever its drives could give, shape (n,) [N m].

    They are the root mean square over poses of gravity's torque, with that of a usual acceleration
    of the joint and its friction.  ``scale``, shape (n,), is that of the joints.
    """
    model, poses = SerialModel(chain), np.pi * scale * _spread(len(scale))
    gravity = np.mean(model.gravity(poses) ** 2, axis=0)
    inertia = np.mean([np.diag(model.mass_matrix(q)) for q in poses], axis=0)
    friction = np.abs(chain.friction[:, VISCOUS]) * priors.USUAL_RATE * scale
    friction += np.abs(chain.friction[:, DRY])
    return np.sqrt(gravity + (priors.USUAL_ACCELERATION * scale * inertia) ** 2 + friction**2)


def change_noise(arm: SerialArm, interval: float) -> FloatArray:
    """Variances that the sensors' noise gives the difference of two neighbouring mean rates.

    A derived rate is, in the mean of an interval, the difference of the readings at its ends; the
    reading between two intervals counts twice.  Shape (n,) [rad2/s2]; rates are averaged over
    ``interval`` [s].
    """
    (noise, step, own, independent), samples = arm.sensors(), interval / arm.sample_time
    difference = READINGS_AT_EDGES * (noise**2 + step**2 / 12.0) / interval**2
    return np.asarray(np.where(independent, 2.0 / samples * own**2, difference))


def balance_noise(
    arm: SerialArm, chain: Chain, directions: FloatArray, rates: FloatArray, missed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Noise of a balance's rows by all but the readings [N2 m2 s2], and by all [N m s].

    A row is without what those before it tell of the noise of the readings' rates, by the nominal
    masses: what these are off in ``directions``, shape (k, n, 10), is left.  ``missed`` are
    variances by missed torques [N2 m2 s2], ``rates`` as of `change_noise`; shape (n,).  Returned
    are variances and standard deviations, means over poses, shape (n,).
    """
    model, to_joints = SerialModel(chain), arm.sensors_to_joints()
    poses = np.pi * arm.scales() * _spread(len(rates))
    along = directions.reshape(len(directions), -1).T
    wrong = np.array([
        [model.momentum_regressor(q, one)[0] @ along for one in to_joints.T] for q in poses
    ])  # fmt: skip
    other = missed + np.einsum('qjik,qjik,j->i', wrong, wrong, rates) / len(poses)
    other = np.maximum(other, np.finfo(float).eps * other.max())  # of joints without inertia
    momenta = np.array([model.mass_matrix(q) for q in poses]) @ to_joints
    noise = (momenta * rates) @ momenta.swapaxes(1, 2) + np.diag(other)
    pivots = np.diagonal(np.linalg.cholesky(noise), axis1=1, axis2=2)
    return other, np.asarray(np.sqrt((pivots**2).mean(axis=0)))


def _with_drives(factor: FloatArray, n: int) -> FloatArray:
    """The same rows, with columns of the drives that they leave as they are."""
    return np.hstack([factor, np.zeros((len(factor), 15 * n - factor.shape[1]))])


def relative_factor(chain: Chain, relative: float) -> FloatArray:
    """Independent relative errors: mass of each link, place of its mass, and its inertias.

    ``relative`` is the standard deviation of each; F^T F is the covariance, F has 10 n columns.
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
            size = body[MASS] * reach if k < 4 else np.trace(inertia_matrix(body[4:])) / 2.0
            part = np.zeros((n, 10))
            part[i, k] = relative * size / 2.0
            rows.append(part)
    return np.array(rows).reshape(len(rows), -1)


def parameter_directions(
    chain: Chain, factor: FloatArray, speed: FloatArray, scale: FloatArray, limit: int = 16
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The directions that matter most, at most ``limit``: independent, of standard deviation one.

    ``factor`` is F of `parameter_factor`; ``speed`` and ``scale``, shape (n,), are usual rates of
    the joints and their `SerialJoint.scale` [rad/s], [rad].  Returned are the directions' inertial
    parameters, shape (k, n, 10), and what belongs to them as of `Balance.drives`, shape (k, n, 6),
    without delays; and each row of ``factor`` by the directions, shape (rows, k).
    """
    n = joint_count(chain)
    model, motions = SerialModel(chain), _spread(2 * n)
    forces, frictions = [], []
    for q, rate in zip(np.pi * scale * motions[:, :n], speed * motions[:, n:]):
        force = model.momentum_regressor(q, rate)[1]
        forces.append(force)
        load = force @ chain.inertial.ravel()
        sign = 2.0 / np.pi * np.arctan(chain.friction[:, SLOPE] * rate)
        drives = rate, sign, np.abs(load) * sign, 1.0 + 0.0 * rate, load
        frictions.append(-np.hstack([np.diag(one) for one in drives]))
    usual = np.sqrt(np.mean([(force @ chain.inertial.ravel()) ** 2 for force in forces], axis=0))
    usual = np.maximum(usual, (0.01 * (usual * scale).max() + 1e-9) / scale)
    effects = np.array([
        (np.hstack(both) / usual[:, None]) @ factor.T for both in zip(forces, frictions)
    ])  # fmt: skip
    right = np.linalg.svd(effects.reshape(-1, len(factor)), full_matrices=False)[2]
    sizes = np.sqrt(((effects @ right.T) ** 2).mean(0)).max(0)
    kept = right[:limit][sizes[:limit] > NEGLIGIBLE]
    found = kept @ factor
    along = np.zeros((len(found), n, 6))
    along[:, :, :DELAY_PART] = found[:, 10 * n :].reshape(-1, 5, n).transpose(0, 2, 1)
    return np.ascontiguousarray(found[:, : 10 * n].reshape(-1, n, 10)), along, kept.T


def _spread(dimensions: int) -> FloatArray:
    """Points that fill the cube from -1 to 1 evenly, shape (samples, dimensions).

    They are multiples of powers of the root of x^(d + 1) = x + 1, the golden ratio of d = 1, but
    for whole ones (Roberts 2018).
    """
    ratio = 2.0
    for _ in range(50):
        ratio = (1.0 + ratio) ** (1.0 / (1.0 + dimensions))
    steps = ratio ** -np.arange(1.0, 1.0 + dimensions)
    return np.asarray(2.0 * ((0.5 + np.arange(_SAMPLES)[:, None] * steps) % 1.0) - 1.0)
