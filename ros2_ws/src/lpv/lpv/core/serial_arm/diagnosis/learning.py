"""What the monitor has learned of a healthy arm.

Only what sensors cannot have caused is learned: estimates that are joint with the offsets of all
sensors, from balances that no fault or torque from outside contradicted.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.chain import COULOMB, OFFSET, VISCOUS, FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm
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


def learned_of(arm: SerialArm, estimator: OffsetEstimator) -> Learned:
    """What an estimator has learned.

    Before the first balance, these are the arm file's values with the deviations of the prior.
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
