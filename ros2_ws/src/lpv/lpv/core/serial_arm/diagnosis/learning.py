"""What the monitor has learned of a healthy arm, and the arm file that knows it.

Only what sensors cannot have caused is learned: estimates that are joint with the offsets of all
sensors, from balances that no fault or torque from outside contradicted.
"""

from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.chain import COULOMB, OFFSET, VISCOUS, FloatArray, compile_chain
from lpv.core.serial_arm.description import LinkInertia, SerialArm, TorqueTolerance
from lpv.core.serial_arm.diagnosis.balance import COULOMB_PART, OFFSET_PART, VISCOUS_PART
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator
from lpv.core.serial_arm.dynamics.payload import payload_parameters


@dataclass(frozen=True)
class Learned:
    """State of the learning; joints from the base to the tip."""

    # mass at the tip beyond the arm file's; may be an error of the links' masses [kg]
    payload: float
    payload_sigma: float  # its standard deviation [kg]
    offset: FloatArray  # (n,) of friction [N m]
    viscous: FloatArray  # (n,) of friction [N m s]
    coulomb: FloatArray  # (n,) of friction [N m]
    sigma: FloatArray  # standard deviations of these three, shape (3, n)
    noise: FloatArray  # (n,) usual torque that the model misses, mean over a balance [N m]
    seconds: float  # length of the horizon [s]

    def values(self) -> dict[str, str]:
        """Keys and values for a diagnostic message."""
        result = {
            'learned_payload': f'{self.payload:.4g}',
            'learned_payload_sigma': f'{self.payload_sigma:.4g}',
            'learned_seconds': f'{self.seconds:.4g}',
        }
        for name in ('offset', 'viscous', 'coulomb', 'noise'):
            result[f'learned_{name}'] = ' '.join(f'{value:.4g}' for value in getattr(self, name))
        return result


def learned_of(arm: SerialArm, estimator: OffsetEstimator) -> Learned:
    """What an estimator has learned.

    Parameters
    ----------
    arm : SerialArm
        Its arm.
    estimator : OffsetEstimator
        After any number of balances.

    Returns
    -------
    Learned
        The arm file's values with the prior's deviations, if there were none.
    """
    n, chain, null = estimator.joints, compile_chain(arm), estimator.level
    inverse = np.linalg.inv(np.triu(null.factor))
    along = estimator.balance.drives[:, :, [OFFSET_PART, VISCOUS_PART, COULOMB_PART]]
    along = along.transpose(2, 1, 0).reshape(3 * n, -1)
    sigma = np.linalg.norm(inverse[n : 4 * n] + along @ inverse[4 * n :], axis=1)
    change = (null.mean[n : 4 * n] + along @ null.mean[4 * n :]).reshape(3, n)
    share = payload_share(estimator)
    mass = float(share @ null.mean[4 * n :])
    spread = np.linalg.norm(share @ inverse[4 * n :]) if share.any() else np.inf
    return Learned(
        mass, float(spread), chain.friction[:, OFFSET] + change[0],
        chain.friction[:, VISCOUS] + change[1], chain.friction[:, COULOMB] + change[2],
        sigma.reshape(3, n), null.noise / estimator.plan.interval,
        len(estimator) * estimator.plan.interval)  # fmt: skip


def payload_share(estimator: OffsetEstimator) -> FloatArray:
    """Mass at the tip by the inertial directions [kg], shape (k,); zero if they do not show it."""
    n, chain = estimator.joints, estimator.balance.chain
    directions = estimator.balance.directions.reshape(-1, 10 * n)
    load = np.zeros((n, 10))
    load[-1] = payload_parameters(chain, 1.0)
    share = np.linalg.pinv(directions).T @ load.ravel() if len(directions) else np.zeros(0)
    power = float(share @ share)
    return share / power if power > 0.0 else np.zeros(len(share))


def learned_arm(arm: SerialArm, learned: Learned) -> SerialArm:
    """The arm with what was learned, for `arm_file.save_arm`.

    Parameters
    ----------
    arm : SerialArm
        The arm before.
    learned : Learned
        Of the same arm.

    Returns
    -------
    SerialArm
        Payload (where it is three standard deviations or more) added to the last link; friction,
        torque offset and noise of the joints.  Friction that would drive a joint is not taken
        over.
    """
    joints = []
    for i, joint in enumerate(arm.joints):
        friction = replace(
            joint.friction,
            offset=float(learned.offset[i]),
            viscous=float(learned.viscous[i]),
            coulomb=max(float(learned.coulomb[i]), 0.0),
        )
        if not friction.is_dissipative(joint.limits.velocity):
            friction = joint.friction
        tolerance = TorqueTolerance((0.0,), (4.0 * float(learned.noise[i]),))
        joints.append(replace(joint, friction=friction, torque_tolerance=tolerance))
    if learned.payload > 3.0 * learned.payload_sigma:
        joints[-1] = replace(joints[-1], link=_loaded(arm, learned.payload))
    return replace(arm, joints=tuple(joints))


def _loaded(arm: SerialArm, mass: float) -> LinkInertia:
    """Last link with a point mass at the tip, in the joint's own frame."""
    place, link = np.array(arm.tip, dtype=float), arm.joints[-1].link.to_vector()
    x, y, z = place
    squares = np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    return LinkInertia.from_vector(link + mass * np.concatenate([[1.0], place, squares]))
