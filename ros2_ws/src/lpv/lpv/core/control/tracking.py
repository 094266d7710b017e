"""Tracking with integral action, eqs. (57)-(66), with reference feed-forward."""

from typing import NamedTuple

import numpy as np

from lpv.core.control.computed_torque import BANDWIDTH, ComputedTorqueController
from lpv.core.control.latency import tolerated_latency
from lpv.core.control.tracking_law import TrackingLaw, apply_limits
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import memory, new_record, record_type
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.arm import ARM_CONSTANTS, ArmParameters
from lpv.core.uio.model.dynamics import inverse_dynamics
from lpv.core.uio.model.joints import JOINT_MAP, JointMap
from lpv.core.uio.planar import planar_model

FEEDBACK_FIELDS = {
    'off': 'measured_position',
    'confirmed': 'compensated_position',
    'always': 'position',
}
"""Field of lpv_msgs/StateEstimate that the loop closes on: as measured, with confirmed faults
removed, or as estimated."""
COMPENSATION = tuple(FEEDBACK_FIELDS)

TRACKING_CONSTANTS = record_type(
    ('joints', JOINT_MAP),
    ('arm', ARM_CONSTANTS),  # constants of the arm's model
    ('limit', 'f8', (2,)),  # of the joint torques [N m]
    ('m1', 'f8', (2, 4)),  # M1 [N m/rad], [N m s/rad]
    ('m2', 'f8', (2, 2)),  # M2 [N m/(rad s)]
    ('feed_forward', '?'),  # method exact
)
TRACKING_STATE = record_type(
    ('integral', 'f8', (2,)),  # eps of eq. (59) [rad s]
    ('torque', 'f8', (2,)),  # joint torques of the last command [N m]
    ('saturated', '?'),  # whether they met a limit
    ('x', 'f8', (4,)),  # work space: deviation of the absolute state
    ('w', 'f8', (2,)),  # work space: absolute reference [rad]
    ('step', 'f8', (2,)),  # work space: step of eps [rad s]
)


def tracking_constants(arm: ArmParameters, gains: Gains) -> np.record:
    """Constants of `track`, of type `TRACKING_CONSTANTS`; ConfigError for another arm's gains."""
    gains.check_arm(arm)
    controller = gains.controller
    return new_record(
        TRACKING_CONSTANTS,
        joints=JointMap(arm).record(),
        arm=arm.constants(),
        limit=arm.torque_limit,
        m1=controller.m1,
        m2=controller.m2,
        feed_forward=controller.method == 'exact',
    )


class TrackingParts(NamedTuple):
    """Memory of constants and state of a `TrackingController`, shape (1,)."""

    constants: np.ndarray
    state: np.ndarray


@njit
def _absolute(position: np.ndarray) -> tuple[float, float]:
    """Absolute angles without the zero angle, or their rates: J^-1 q."""
    return position[0], position[0] + position[1]


@njit
def track(
    parts: TrackingParts,
    reference: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    integrated: np.ndarray,
    interval: float,
) -> None:
    """One torque command, see `TrackingController`; it is in the state's ``torque``.

    Arguments are as of `TrackingLaw.answer`; ``integrated`` is y of eq. (59).
    """
    params, state = parts.constants[0], parts.state[0]
    x, zero, rate = state.x, params.joints.zero, _absolute(reference[1])
    wanted, angle = _absolute(reference[0]), _absolute(integrated)
    measured, speed = _absolute(position), _absolute(velocity)
    for i in range(2):
        state.w[i] = wanted[i] + zero
        state.step[i] = interval * (state.w[i] - (angle[i] + zero))
        x[i], x[2 + i] = measured[i] + zero, speed[i]
    forward = 0.0, 0.0
    if params.feed_forward:
        forward = inverse_dynamics(state.w, rate, _absolute(reference[2]), params.arm)
        for i in range(2):
            x[i], x[2 + i] = x[i] - state.w[i], x[2 + i] - rate[i]
    q_1 = forward[0] + _feedback(params, state, 0)
    q_2 = forward[1] + _feedback(params, state, 1)
    state.torque[0], state.torque[1] = q_1 + q_2, q_2  # tau = J^-T Q
    apply_limits(state, params.limit)


@njit
def _feedback(params: np.record, state: np.record, i: int) -> float:
    """Row i of M1 x + M2 eps, eq. (65)."""
    total = 0.0
    for j in range(4):
        total += params.m1[i, j] * state.x[j]
    for j in range(2):
        total += params.m2[i, j] * (state.integral[j] + state.step[j])
    return total


class TrackingController(TrackingLaw):
    """State feedback u = M1 x + M2 eps (65), eps' = w - y (59).

    Method ``exact`` closes the loop on the deviation from the reference and adds the torque that
    the arm needs along it (inverse dynamics with Coriolis terms and friction):
    u = u_ref(w, w', w'') + M1 (x - x_ref) + M2 eps.  Method ``paper`` is (65) literally.

    Parameters
    ----------
    arm : SerialArm
        A planar arm.
    gains : Gains
        Designed gains of this arm.

    Attributes
    ----------
    tolerated_latency : float
        Longest constant latency with which the loop is stable [s].
    integrates_measurement : bool
        Whether eq. (59) is taken literally: eps integrates the faulty measurement.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    def __init__(self, arm: SerialArm, gains: Gains) -> None:
        planar = planar_model(arm)
        self.tolerated_latency = tolerated_latency(planar, gains)
        self.integrates_measurement = gains.controller.method == 'paper'
        constants = memory(tracking_constants(planar, gains))
        super().__init__(track, TrackingParts(constants, memory(new_record(TRACKING_STATE))))


def make_controller(
    arm: SerialArm, gains: Gains | None = None, bandwidth: float = BANDWIDTH
) -> ComputedTorqueController | TrackingController:
    """The tracking law of an arm: the designed one where gains are given, else computed torque."""
    if gains is not None:
        return TrackingController(arm, gains)
    return ComputedTorqueController(arm, bandwidth)
