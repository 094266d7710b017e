"""Tracking with integral action, eqs. (57)-(66), with reference feed-forward."""

import numpy as np

from lpv.core.control.computed_torque import BANDWIDTH, ComputedTorqueController
from lpv.core.control.latency import tolerated_latency
from lpv.core.control.tracking_law import LawParts, TrackingLaw, apply_limits
from lpv.core.serial_arm.chain import FloatArray, compile_chain, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import memory, new_record, record_type
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.joints import J_INVERSE, JointMap
from lpv.core.uio.planar import planar_model

FEEDBACK_FIELDS = {
    'off': 'measured_position',
    'confirmed': 'compensated_position',
    'always': 'position',
}
"""Field of lpv_msgs/StateEstimate that the loop closes on: as measured, with confirmed faults
removed, or as estimated."""
COMPENSATION = tuple(FEEDBACK_FIELDS)


def tracking_type(joints: int) -> np.dtype:
    """Record type of the designed law: gains and state."""
    return record_type(
        ('gains', 'f8', (joints, 3 * joints)),  # M1, M2 of eq. (65) for the joints
        ('limit', 'f8', (joints,)),  # of the joint torques [N m]
        ('feed_forward', '?'),  # method exact
        ('zero', 'f8', (joints,)),  # joint positions where theta of the design is 0 [rad]
        ('integral', 'f8', (joints,)),  # eps of eq. (59) [rad s]
        ('torque', 'f8', (joints,)),  # of the last command [N m]
        ('saturated', '?'),  # whether they met a limit
        ('x', 'f8', (3 * joints,)),  # work space: what the gains multiply
        ('friction', 'f8', (joints,)),  # work space [N m]
        ('step', 'f8', (joints,)),  # work space: step of eps [rad s]
    )


@njit
def track(
    parts: LawParts,
    reference: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    integrated: FloatArray,
    interval: float,
) -> None:
    """One torque command, see `TrackingController`; into ``parts.state``.

    Arguments are as of `TrackingLaw.answer`; ``integrated`` is y of eq. (59).
    """
    chain, state, n = parts.chain, parts.state[0], position.shape[0]
    torque, x = state.torque, state.x
    torque[:] = 0.0
    if state.feed_forward:
        inverse_dynamics(chain, reference[0], reference[1], reference[2], parts.work, torque)
        friction_torque(chain, reference[1], torque, state.friction)
    for i in range(n):
        state.step[i] = interval * (reference[0, i] - integrated[i])
        x[i], x[n + i] = position[i] - state.zero[i], velocity[i]
        x[2 * n + i] = state.integral[i] + state.step[i]
        if state.feed_forward:
            torque[i] += state.friction[i]
            x[i], x[n + i] = position[i] - reference[0, i], velocity[i] - reference[1, i]
    for i in range(n):
        for j in range(3 * n):
            torque[i] += state.gains[i, j] * x[j]
    apply_limits(state, state.limit)


class TrackingController(TrackingLaw):
    """State feedback u = M1 x + M2 eps (65), eps' = w - y (59).

    Method ``exact`` closes the loop on the deviation from the reference and adds the torque that
    the arm needs along it (inverse dynamics with Coriolis terms and friction):
    u = u_ref(w, w', w'') + M1 (x - x_ref) + M2 eps.  Method ``paper`` is (65) literally.  Gains
    are turned into those of the joints once.

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
        planar, designed = planar_model(arm), gains.controller
        gains.check_arm(planar)
        self.tolerated_latency = tolerated_latency(planar, gains)
        self.integrates_measurement = designed.method == 'paper'
        # Of absolute angles, theta = J^-1 q, to their torques Q = J^T tau.
        to_absolute = np.kron(np.eye(3), J_INVERSE)
        state = new_record(
            tracking_type(len(arm.joints)),
            gains=J_INVERSE.T @ designed.feedback @ to_absolute,
            limit=arm.torque_limit,
            feed_forward=designed.method == 'exact',
            zero=JointMap(planar).joint_position(np.zeros(2)),
        )
        chain = compile_chain(arm)
        super().__init__(track, LawParts(chain, memory(state), workspace(chain)))


def make_controller(
    arm: SerialArm, gains: Gains | None = None, bandwidth: float = BANDWIDTH
) -> ComputedTorqueController | TrackingController:
    """The tracking law of an arm: the designed one where gains are given, else computed torque."""
    if gains is not None:
        return TrackingController(arm, gains)
    return ComputedTorqueController(arm, bandwidth)
