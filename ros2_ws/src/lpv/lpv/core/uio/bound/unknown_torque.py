"""How large the generalised torques are that the model of a healthy arm does not know.

With M = Xi_true(theta), the true inertia at the true angles, and m = M e', the error of the
observer of `lpv.core.uio.observer.exact_observer` obeys, without any linearisation and without any
unknown acceleration,

    m' = M' e' + (M - Xi^) theta^'' - mu Xi^ r - Xi^'(v) r + [O_t(theta, theta') - O(theta^, v)]
         + [g_t(theta) - g(theta^)] + [friction_t(theta') - friction(v)] - M Bd d,

where r = theta^' - v is the measured innovation, theta^'' the observer's own acceleration, and
e' = r + eta with the error eta of the rates.  Errors of the parameters therefore multiply known
signals only; what is linear in the angle errors goes into the matrix of the error system
(`lpv.core.uio.bound.error_bound`), the rest is bounded here.
"""

import numpy as np

from lpv.core.serial_arm.description import RATE_BIAS, SIGMAS
from lpv.core.serial_arm.dynamics.friction import smooth_sign
from lpv.core.serial_arm.dynamics.payload import PAYLOAD_PLACE
from lpv.core.serial_arm.two_links import ARM_CONSTANTS, ArmParameters
from lpv.core.support.inequalities import SAME
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import new_record, record_type
from lpv.core.uio.model.dynamics import COSINE, SINE, Pair, rigid_torque
from lpv.core.uio.model.joints import JOINT_MAP, JointMap, row_dot, row_size

UNKNOWN_TORQUE = record_type(
    ('arm', ARM_CONSTANTS),
    # Errors by masses, places of masses, inertias and payload:
    ('own', 'f8', (2,)),  # of Xi_11 and Xi_22 [kg m2]
    ('constant', 'f8'),  # of the constant part of Xi_12, by the rotor of joint 2 [kg m2]
    ('part', 'f8'),  # of the part of Xi_12 that cos(theta1 - theta2) scales [kg m2]
    ('aside', 'f8'),  # what sin(theta1 - theta2) scales, of masses beside the links [kg m2]
    ('lift', 'f8', (2,)),  # of G_i [N m]
    ('lean', 'f8', (2,)),  # gravity torques of masses beside the links [N m]
    ('friction', 'f8'),  # relative uncertainty of friction
    ('push', 'f8', (2,)),  # mean disturbance Bd2 abs(d) [rad/s2]
    # Stated errors of the measured rates:
    ('joints', JOINT_MAP),
    ('bias', 'f8'),  # of a rate sensor [rad/s]
    ('scale', 'f8'),  # error of a rate, relative to the measured one
    ('joint_noise', 'f8', (2,)),  # noise that a joint rate may show [rad/s]
)
"""What a healthy arm may do that its model does not say."""

MOTION = record_type(
    ('pose', 'f8', (3, 3)),  # of theta^, as of `lpv.core.uio.model.dynamics.set_pose`
    ('rate', 'f8', (2,)),  # v [rad/s]
    ('innovation', 'f8', (2,)),  # r [rad/s]
    ('driven', 'f8', (2, 2)),  # theta^''_j + mu_i r_j [rad/s2]
    ('mu', 'f8', (2,)),  # [1/s]
    ('margin', 'f8', (2,)),  # bound on the angle errors [rad]
    ('load', 'f8', (2,)),  # torques that the joints' gears carry [N m]
    ('rate_error', 'f8', (2,)),  # bound on eta, absolute rates, without noise [rad/s]
    ('joint_error', 'f8', (2,)),  # the same of the joint rates [rad/s]
)
"""The signals that unknown parameters multiply."""


def healthy_arm(arm: ArmParameters, sigmas: float = SIGMAS) -> np.record:
    """What a healthy arm may do that its model does not say, of type `UNKNOWN_TORQUE`."""
    joints, constants, (length_1, length_2) = JointMap(arm).record(), arm.constants(), arm.lengths
    # As of `lpv.core.serial_arm.diagnosis.parameter_set.parameter_set`: links as a whole, and apart
    # from that places of their masses and inertias by half as much.
    error, half = arm.model_error, 0.5 * arm.model_error
    # Errors are relative to true rates, which measured ones may fall short of.
    least = 1.0 - arm.velocity_error
    moment = half * np.array([abs(link.mass * link.center_of_mass) for link in arm.links])
    # First moments of a payload along link 2 and beside it.
    along, beside = arm.payload * (length_2 + PAYLOAD_PLACE), arm.payload * PAYLOAD_PLACE
    reach = length_1**2, (length_2 + PAYLOAD_PLACE) ** 2 + PAYLOAD_PLACE**2
    return new_record(
        UNKNOWN_TORQUE,
        arm=constants,
        own=error * constants.inertia
        + half * np.array([link.inertia for link in arm.links])
        + arm.payload * np.array(reach),
        constant=error * abs(arm.rotor[2]),
        part=error * abs(constants.coupling) + length_1 * (moment[1] + along),
        aside=length_1 * (moment[1] + beside),
        lift=error * np.abs(constants.gravity)
        + arm.gravity * (moment + [arm.payload * length_1, along]),
        lean=arm.gravity * (moment + [0.0, beside]),
        friction=arm.friction_error,
        push=np.abs(arm.disturbance_mean * np.asarray(arm.disturbance_direction)),
        joints=joints,
        bias=RATE_BIAS * arm.velocity_noise / least,
        scale=arm.velocity_error / least,
        joint_noise=sigmas * arm.velocity_noise * np.hypot(*joints.to_joint.T),
    )


@njit
def bound_rate_errors(params: np.record, motion: np.record) -> None:
    """Fill ``rate_error`` and ``joint_error`` of a motion: bias and relative error."""
    s, v = params.joints.sensor, motion.rate
    error_1 = params.bias + params.scale * abs(row_dot(s, 0, v[0], v[1]))
    error_2 = params.bias + params.scale * abs(row_dot(s, 1, v[0], v[1]))
    for i in range(2):
        motion.rate_error[i] = row_size(params.joints.angle, i, error_1, error_2)
        motion.joint_error[i] = row_size(params.joints.to_joint, i, error_1, error_2)


@njit
def inertia_errors(params: np.record, motion: np.record) -> tuple[float, ...]:
    """Bounds at the true angles on the error of Xi_12, on that of its change with the angle between
    the links [kg m2], and on sine and cosine of this angle."""
    away = motion.margin[0] + motion.margin[1]
    sine = min(1.0, abs(motion.pose[SINE, 2]) + away)
    cosine = min(1.0, abs(motion.pose[COSINE, 2]) + away)
    part, aside = params.part, params.aside
    cross, swirl = params.constant + part * cosine + aside * sine, part * sine + aside * cosine
    return cross, swirl, sine, cosine


@njit
def unknown_torque(params: np.record, motion: np.record, out: np.ndarray) -> None:
    """Bounds [N m], into ``out``, on the generalised torques of a `MOTION` that neither the model
    nor the linear error explains."""
    arm, b = params.arm, params.arm.coupling
    cross, swirl, sine, cosine = inertia_errors(params, motion)
    away, off = motion.margin[0] + motion.margin[1], abs(arm.rotor_coupling) + b * cosine
    joint_1 = _friction_error(params, motion, 0, motion.rate[0])
    joint_2 = _friction_error(params, motion, 1, motion.rate[1] - motion.rate[0])
    turning = abs(motion.rate[0] - motion.rate[1])
    turning_error = motion.rate_error[0] + motion.rate_error[1]
    for i in range(2):
        j = 1 - i
        own = params.own[i]
        speed, slip, error = abs(motion.rate[j]), abs(motion.innovation[j]), motion.rate_error[j]
        driven = abs(motion.driven[i, i]) + motion.mu[i] * motion.rate_error[i]
        driven_by_other = abs(motion.driven[i, j]) + motion.mu[i] * error
        level = min(1.0, abs(motion.pose[SINE, i]) + motion.margin[i])
        steep = min(1.0, abs(motion.pose[COSINE, i]) + motion.margin[i])
        # (M - Xi^)(theta^'' + mu e'), gravity, centrifugal terms and M' e' with wrong parameters.
        total = own * driven + cross * driven_by_other
        total += params.lift[i] * level + params.lean[i] * steep
        total += swirl * ((speed + error) ** 2 + (turning + turning_error) * (slip + error))
        # The same terms of the model at wrong rates.
        wrong = error * (2.0 * speed + error) + turning_error * (slip + error) + turning * error
        total += b * sine * wrong
        total += b * sine * away * motion.mu[i] * error
        # What is quadratic in the angle errors (Taylor's theorem).
        total += 0.5 * b * away * away * (speed * speed + driven_by_other + turning * slip)
        total += joint_1 + joint_2 if i == 0 else joint_2
        # M Bd d.
        total += (arm.inertia[i] + own) * params.push[i] + (off + cross) * params.push[j]
        out[i] = total


@njit
def carry_load(params: np.record, motion: np.record, acc: Pair) -> None:
    """Fill ``load`` of a motion with absolute accelerations of the model [rad/s2]."""
    first, second = rigid_torque(motion.pose, motion.rate, acc, params.arm)
    motion.load[0], motion.load[1] = abs(first + second), abs(second)


@njit
def _friction_error(params: np.record, motion: np.record, i: int, rate: float) -> float:
    """Bound on true less modelled friction of a joint, with the noise of the rate averaged out."""
    # Coulomb friction of a joint that may stand still is set-valued: anything within its limits.
    arm, share, error = params.arm, params.friction, motion.joint_error[i]
    dry, slope = arm.coulomb[i] + arm.load[i] * motion.load[i], arm.coulomb_slope[i]
    total = abs(arm.viscous[i]) * (share * abs(rate) + (1.0 + share) * error)
    total += share * abs(arm.offset[i])
    most = (1.0 + share) * dry
    slowest = abs(rate) - error - params.joint_noise[i]
    if dry == 0.0:
        pass
    elif slowest <= 0.0:
        total += most + dry * smooth_sign(error, slope)
    else:
        modelled = dry * smooth_sign(abs(rate), slope)
        least = (1.0 - share) * dry * smooth_sign(slowest, slope)
        total += max(most - modelled, modelled - least)
    # The gear carries what friction leaves of the drive's torque, and is wrong by the same error.
    return total / max(1.0 - (1.0 + share) * arm.load[i], SAME)
