"""The two observers behind one interface: advance over an interval, or take a state as given."""

import numpy as np

from lpv_core.certificate.gains import ExactObserverGains, PaperObserverGains
from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.model.joints import JOINT_MAP, JointMap, row_dot
from lpv_core.observer.exact_observer import EXACT_CONSTANTS, exact_constants, exact_step
from lpv_core.observer.paper_observer import (
    PAPER_CONSTANTS,
    PAPER_STATE,
    paper_constants,
    paper_step,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

RECURSION_CONSTANTS = record_type(
    ('is_exact', '?'),  # the method
    ('joints', JOINT_MAP),
    ('arm', ARM_CONSTANTS),
    ('exact', EXACT_CONSTANTS),  # of method exact
    ('paper', PAPER_CONSTANTS),  # of method paper
)
RECURSION_STATE = record_type(
    ('x', 'f8', (6,)),  # x^ = (theta^, theta^', f^): absolute angles, physical sensors [rad]
    ('held', 'u1', (2,)),  # links whose angle is not corrected
    ('v_old', 'f8', (2,)),  # absolute rates at the start of the interval [rad/s]
    ('v_new', 'f8', (2,)),  # and at its end [rad/s]
    ('paper', PAPER_STATE),  # of method paper
)


def recursion(arm: ArmParameters, observer: ExactObserverGains | PaperObserverGains) -> np.record:
    """Constants of an observer, of type `RECURSION_CONSTANTS`."""
    params = new_record(RECURSION_CONSTANTS, joints=JointMap(arm).record(), arm=arm.constants())
    if isinstance(observer, ExactObserverGains):
        params.is_exact, params.exact = True, exact_constants(arm, observer)
    else:
        params.paper = paper_constants(arm, observer)
    return params


@njit
def advance(
    params: np.record,
    state: np.record,
    y_old: np.ndarray,
    y_new: np.ndarray,
    torque: np.ndarray,
    dt: float,
) -> None:
    """Advance over one interval.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends, sensor coordinates [rad], [rad/s].
    torque : ndarray, shape (2,)
        Generalised torques Q over the interval [N m].
    dt : float
        Its length [s].
    """
    if not params.is_exact:
        paper_step(params.paper, state.paper, state.x, y_old, y_new, torque, dt)
        return
    for i in range(2):
        state.v_old[i] = row_dot(params.joints.angle, i, y_old[2], y_old[3])
        state.v_new[i] = row_dot(params.joints.angle, i, y_new[2], y_new[3])
    exact_step(params.exact, state, torque, dt)
    for i in range(2):
        state.x[4 + i] = y_new[i] - row_dot(params.joints.sensor, i, state.x[0], state.x[1])


@njit
def set_state(params: np.record, state: np.record, y: np.ndarray) -> None:
    """Use ``x`` as it was changed from outside, at outputs y: z = x^ - T2 y, eq. (38)."""
    if params.is_exact:
        return  # there, x is the whole state
    z = state.paper.z
    for i in range(6):
        total = 0.0
        for j in range(4):
            total += params.paper.t2[i, j] * y[j]
        z[i] = state.x[i] - total
