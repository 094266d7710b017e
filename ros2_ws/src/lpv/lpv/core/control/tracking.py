"""Tracking with integral action, eqs. (57)-(66), with reference feed-forward."""

import numpy as np

from lpv.core.control.computed_torque import BANDWIDTH, ComputedTorqueController
from lpv.core.control.latency import tolerated_latency
from lpv.core.control.tracking_law import AT_REFERENCE, NO_MODEL, TrackingLaw
from lpv.core.serial_arm.description import SerialArm
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
        super().__init__(
            arm,
            model=NO_MODEL if self.integrates_measurement else AT_REFERENCE,
            gains=J_INVERSE.T @ designed.feedback @ to_absolute,
            zero=JointMap(planar).joint_position(np.zeros(2)),
        )


def make_controller(
    arm: SerialArm, gains: Gains | None = None, bandwidth: float = BANDWIDTH
) -> ComputedTorqueController | TrackingController:
    """The tracking law of an arm: the designed one where gains are given, else computed torque."""
    if gains is not None:
        return TrackingController(arm, gains)
    return ComputedTorqueController(arm, bandwidth)
