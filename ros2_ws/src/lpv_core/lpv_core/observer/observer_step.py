"""The two observers behind one interface: advance over an interval, or take a state as given."""

import numpy as np

from lpv_core.model.arm import ARM_CONSTANTS
from lpv_core.model.joints import JOINT_MAP, JointMap, row_dot
from lpv_core.model.polytope import slope_range
from lpv_core.model.state_space import Descriptor, output_matrices, vertex_matrices
from lpv_core.observer.exact_observer import exact_step
from lpv_core.observer.paper_observer import paper_step
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

_PAPER = record_type(
    ('t1', 'f8', (6, 6)),
    ('t2', 'f8', (6, 4)),
    ('k', 'f8', (8, 6, 4)),
    ('box', 'f8', (3, 2)),
    ('c', 'f8', (4, 6)),
    ('a', 'f8', (8, 6, 6)),
    ('b', 'f8', (8, 6, 2)),
)
RECURSION_CONSTANTS = record_type(
    ('exact', '?'),
    ('joints', JOINT_MAP),
    ('arm', ARM_CONSTANTS),
    ('kappa', 'f8', (2,)),
    ('mu', 'f8', (2,)),
    ('low', 'f8', (2,)),
    ('high', 'f8', (2,)),
    ('paper', _PAPER),
)
"""Method; conversions; constants of the arm; s*kappa_i and mu_i; certified range of the cosines;
matrices of method ``paper``."""

RECURSION_STATE = record_type(
    ('x', 'f8', (6,)),
    ('z', 'f8', (6,)),
    ('held', 'u1', (2,)),
    ('v_old', 'f8', (2,)),
    ('v_new', 'f8', (2,)),
    ('scratch', 'f8', (5, 6)),
    ('k', 'f8', (6, 4)),
    ('a', 'f8', (6, 6)),
    ('b', 'f8', (6, 2)),
    ('rho', 'f8', (8,)),
)
"""x^ = (theta^, theta^', f^): absolute angles and physical sensors; z of method ``paper``; links
that are held; work space."""


def recursion(arm, observer) -> np.record:
    """Constants of an observer.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    observer : ExactObserverGains or PaperObserverGains
        Its gains.

    Returns
    -------
    numpy.record
        Of type `RECURSION_CONSTANTS`.
    """
    params = new_record(RECURSION_CONSTANTS, joints=JointMap(arm).record(), arm=arm.constants())
    if observer.method == 'exact':
        low, high = slope_range(arm)
        params.exact, params.kappa, params.mu = (
            True,
            arm.sign * np.asarray(observer.kappa),
            observer.mu,
        )
        # The region ends at |cos| = 1; no rounding of the cosine may leave it.
        params.low = np.where(low <= -1.0, -1.0 - 1e-9, low)
        params.high = np.where(high >= 1.0, 1.0 + 1e-9, high)
        return params
    a, b = vertex_matrices(np.ascontiguousarray(observer.box), arm.constants(coriolis=False))
    descriptor = Descriptor(a, b, arm)
    params.paper = new_record(
        _PAPER,
        t1=observer.t1,
        t2=observer.t2,
        k=observer.k,
        box=observer.box,
        c=np.hstack(output_matrices(arm)),
        a=descriptor.a,
        b=descriptor.b,
    )
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
    if not params.exact:
        p = params.paper
        paper_step(
            state.z,
            y_old,
            y_new,
            torque,
            dt,
            p.k,
            p.t1,
            p.t2,
            p.c,
            p.a,
            p.b,
            p.box,
            state.x,
            state.scratch,
            state.k,
            state.a,
            state.b,
            state.rho,
        )
        return
    for i in range(2):
        state.v_old[i] = row_dot(params.joints.angle, i, y_old[2], y_old[3])
        state.v_new[i] = row_dot(params.joints.angle, i, y_new[2], y_new[3])
    exact_step(
        state.x,
        state.v_old,
        state.v_new,
        torque,
        dt,
        params.kappa,
        params.mu,
        params.arm,
        params.low,
        params.high,
        state.held,
    )
    for i in range(2):
        state.x[4 + i] = y_new[i] - row_dot(params.joints.sensor, i, state.x[0], state.x[1])


@njit
def set_state(params: np.record, state: np.record, y: np.ndarray) -> None:
    """Take ``x`` as it was changed from outside: z follows from x^ = z + T2 y (38).

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    y : ndarray, shape (4,)
        Outputs that belong to it.
    """
    if params.exact:
        return  # there, x is the whole state
    for i in range(6):
        total = 0.0
        for j in range(4):
            total += params.paper.t2[i, j] * y[j]
        state.z[i] = state.x[i] - total
