"""What drives the tracking error: torques that the model misses, in the norm of M^^-1.

With y^T delta <= D sqrt(y^T M^ y) for every y, D bounds abs(M^^(-1/2) delta).  Of a link whose
pseudo-inertia is wrong by at most d in the matrix order, D = d sqrt(int abs(acc)^2 dm) over its
mass (Cauchy-Schwarz), acc the acceleration of each point less free fall.
"""

import math

import numpy as np

from lpv.core.serial_arm.certificate.model_bounds import ModelBounds
from lpv.core.serial_arm.chain import (
    COULOMB,
    IXX,
    IYY,
    IZZ,
    LOAD,
    MASS,
    OFFSET,
    VISCOUS,
    Chain,
    FloatArray,
    compile_chain,
)
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.healthy_balance import tolerated
from lpv.core.support.inequalities import SAME


def missed_torque(
    arm: SerialArm, bounds: ModelBounds, model_error: float, rates: FloatArray, acceleration: float
) -> dict[str, float]:
    """Bounds D of all that the model misses, by cause [kg^(1/2) m/s2].

    Parameters
    ----------
    arm : SerialArm
        The arm.
    bounds : ModelBounds
        Of its mass matrix.
    model_error : float
        d: relative error of each link's pseudo-inertia, in the matrix order, and of each entry of
        the rotors' matrix.
    rates : ndarray, shape (n,)
        Largest of each joint of the arm, and of its reference [rad/s].
    acceleration : float
        Largest of every joint's reference [rad/s2].
    """
    chain, turning = compile_chain(arm), _turning(rates, acceleration)
    free_fall = math.sqrt(float(chain.gravity @ chain.gravity))
    mass, moving = float(chain.inertial[:, MASS].sum()), _moving_mass(chain, turning)
    load = math.sqrt(bounds.payload * arm.uncertainty.largest_payload)
    tip = float(turning @ _distances(chain, len(chain.translation)))
    change, friction = arm.uncertainty.friction, chain.friction
    viscous, offset = friction[:, VISCOUS], np.abs(friction[:, OFFSET])
    # Negative viscous friction is no damping: all of it counts, besides its error.
    missed = (change * np.abs(viscous) + 2.0 * np.maximum(-viscous, 0.0)) * rates
    rotors = model_error * acceleration * np.abs(chain.motor).sum(1)
    dry = (2.0 + change) * friction[:, COULOMB] + change * offset
    # Torques of the model and of the arm are below the limit; while friction helps the drive to
    # hold the load, a gear carries both.
    other = (1.0 + change) * (np.abs(viscous) * rates + friction[:, COULOMB] + offset)
    left = np.maximum(1.0 - (1.0 + change) * friction[:, LOAD], SAME)
    loaded = (2.0 + change) * friction[:, LOAD] * (np.array(arm.torque_limit) + other) / left
    parts = [joint.torque_tolerance for joint in arm.joints]
    points = (np.array([part.speed, part.torque]) for part in parts)
    stated = np.array([tolerated(*one) for one in zip(points, np.zeros_like(rates), rates)])
    return {
        'model error': model_error * (free_fall * math.sqrt(mass) + moving),
        'model error of rotors': _norm(rotors, bounds),
        'payload': load * (free_fall + tip),
        'viscous friction': _norm(missed, bounds),
        'dry friction, opposed at every joint': _norm(dry + loaded, bounds),
        'torque_tolerance': _norm(stated, bounds),
    }


def _norm(torque: FloatArray, bounds: ModelBounds) -> float:
    """D of torques of any sign up to these."""
    return float(np.sqrt((torque**2 / bounds.inertia).sum()))


def _turning(rates: FloatArray, acceleration: float) -> FloatArray:
    """Acceleration at distance 1 from axis k, by joint k with those before it [1/s2].

    abs(acc) <= sum_k d_k (abs(q_k'') + v_k^2 + 2 sum_(j<k) abs(v_j v_k)), d_k the distance
    from axis k.
    """
    before = np.concatenate([[0.0], np.cumsum(rates)[:-1]])
    return acceleration + rates * (rates + 2.0 * before)


def _distances(chain: Chain, link: int) -> FloatArray:
    """Largest distance from axis k of the origin of frame ``link`` [m].

    ``link`` = n is the tip.  Of the way from frame k to frame k + 1 only what is across the axis
    counts.
    """
    ways = [*chain.translation, chain.tip_translation]
    lengths = [float(np.linalg.norm(way)) for way in ways]
    result = np.zeros(len(chain.translation))
    for k in range(min(link + 1, len(result))):
        across = math.hypot(ways[k + 1][0], ways[k + 1][1]) if k < link else 0.0
        result[k] = across + sum(lengths[k + 2 : link + 1])
    return result


def _moving_mass(chain: Chain, turning: FloatArray) -> float:
    """Bound of sqrt(int abs(acc)^2 dm) without gravity (Minkowski's inequality) [kg^(1/2) m/s2]."""
    total = 0.0
    for i, body in enumerate(chain.inertial):
        spread = math.sqrt(max(0.5 * (body[IXX] + body[IYY] + body[IZZ]), 0.0))
        root = math.sqrt(max(body[MASS], 0.0))
        parts = root * _distances(chain, i)
        parts[: i + 1] += spread
        total += float(turning @ parts) ** 2
    return math.sqrt(total)
