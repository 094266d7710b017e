"""How large the generalised torques are that the model of a healthy arm does not know."""

import math

import numpy as np

from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.model.dynamics import coupling
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

UNKNOWN_TORQUE = record_type(
    ('arm', ARM_CONSTANTS),
    ('model_error', 'f8'),  # relative error of masses and inertias
    ('payload', 'f8'),  # largest unknown mass at the tip [kg]
    ('lengths', 'f8', (2,)),  # L1, L2 [m]
    ('gravity', 'f8'),  # g [m/s2]
    ('friction', 'f8'),  # relative uncertainty of Coulomb friction at speed; unknown at rest
    ('push', 'f8', (2,)),  # mean disturbance Bd2 abs(d) [rad/s2]
)
"""What a healthy arm may do that its model does not say."""


def healthy_arm(arm: ArmParameters, friction_uncertainty: float) -> np.record:
    """What a healthy arm may do that its model does not say."""
    return new_record(
        UNKNOWN_TORQUE,
        arm=arm.constants(),
        model_error=arm.model_error,
        payload=arm.payload,
        lengths=arm.lengths,
        gravity=arm.gravity,
        friction=friction_uncertainty,
        push=np.abs(arm.disturbance_mean * np.asarray(arm.disturbance_direction)),
    )


@njit
def unknown_torque(
    params: np.record,
    theta: np.ndarray,
    rate: np.ndarray,
    acc: np.ndarray,
    margin: np.ndarray,
    out: np.ndarray,
) -> None:
    """Bound on the unknown generalised torques abs(q_i).

    Parameters
    ----------
    params : numpy.record
        `healthy_arm`.
    theta, rate, acc : ndarray, shape (2,)
        Absolute angles, rates, accelerations [rad], [rad/s], [rad/s2].
    margin : ndarray, shape (2,)
        Bound on the angle errors, for what is quadratic in them [rad].
    out : ndarray, shape (2,)
        Receives the bounds [N m].
    """
    arm, model_error, payload = params.arm, params.model_error, params.payload
    cosine, sine = abs(math.cos(theta[0] - theta[1])), abs(math.sin(theta[0] - theta[1]))
    off = abs(coupling(theta[0], theta[1], arm))
    # The model's own accelerations are wrong by as much as the model is.
    a_1, a_2 = abs(acc[0]) * (1.0 + 2.0 * model_error), abs(acc[1]) * (1.0 + 2.0 * model_error)
    s_1, s_2 = rate[0] * rate[0], rate[1] * rate[1]
    lift_1 = min(1.0, abs(math.sin(theta[0])) + margin[0])
    lift_2 = min(1.0, abs(math.sin(theta[1])) + margin[1])
    swing_1, swing_2 = cosine * a_2 + sine * s_2, cosine * a_1 + sine * s_1
    # Every entry of Xi, h and g is a sum of products with one mass or inertia each.
    wrong_1 = arm.inertia[0] * a_1 + arm.coupling * swing_1 + arm.gravity[0] * lift_1
    wrong_2 = arm.inertia[1] * a_2 + arm.coupling * swing_2 + arm.gravity[1] * lift_2
    l_1, l_2 = params.lengths[0], params.lengths[1]
    load_1 = l_1 * (l_1 * a_1 + l_2 * swing_1 + params.gravity * lift_1)
    load_2 = l_2 * (l_2 * a_2 + l_1 * swing_2 + params.gravity * lift_2)
    relative = rate[1] - rate[0]
    # A joint at rest sticks: its friction is anything up to the Coulomb torque.
    slip_1 = abs(math.atan(arm.coulomb_slope * rate[0])) * 2.0 / math.pi
    slip_2 = abs(math.atan(arm.coulomb_slope * relative)) * 2.0 / math.pi
    rub_1 = arm.coulomb[0] * (1.0 - slip_1 * (1.0 - params.friction))
    rub_2 = arm.coulomb[1] * (1.0 - slip_2 * (1.0 - params.friction))
    out[0] = (
        model_error * wrong_1
        + payload * load_1
        + rub_1
        + rub_2
        + arm.inertia[0] * params.push[0]
        + off * params.push[1]
    )
    out[1] = (
        model_error * wrong_2
        + payload * load_2
        + rub_2
        + off * params.push[0]
        + arm.inertia[1] * params.push[1]
    )
    # What linearised gravity, inertia and Coriolis terms leave out (Taylor's theorem).
    both = 0.5 * arm.coupling * (margin[0] + margin[1]) * (margin[0] + margin[1])
    out[0] += 0.5 * arm.gravity[0] * lift_1 * margin[0] * margin[0] + both * (s_2 + a_2)
    out[1] += 0.5 * arm.gravity[1] * lift_2 * margin[1] * margin[1] + both * (s_1 + a_1)
