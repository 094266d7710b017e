"""The two observers behind one interface: advance over an interval, or take a state as given."""

import numpy as np

from lpv_core.jit import njit
from lpv_core.joints import JOINT_MAP, JointMap, weigh
from lpv_core.momentum_uio import exact_step
from lpv_core.polytope import slope_range
from lpv_core.records import new_record, record_type
from lpv_core.state_space import Descriptor, output_matrices, vertex_matrices
from lpv_core.uio import paper_step

_PAPER = record_type(
    ('t1', 'f8', (6, 6)), ('t2', 'f8', (6, 4)), ('k', 'f8', (8, 6, 4)), ('box', 'f8', (3, 2)),
    ('c', 'f8', (4, 6)), ('a', 'f8', (8, 6, 6)), ('b', 'f8', (8, 6, 2)))
RECURSION_CONSTANTS = record_type(
    ('exact', '?'), ('joints', JOINT_MAP), ('arm', 'f8', (12,)), ('kappa', 'f8', (2,)),
    ('mu', 'f8', (2,)), ('low', 'f8', (2,)), ('high', 'f8', (2,)), ('paper', _PAPER))
"""Method; conversions; constants of the arm; s*kappa_i and mu_i; certified range of the cosines;
matrices of method ``paper``."""

RECURSION_STATE = record_type(
    ('x', 'f8', (6,)), ('z', 'f8', (6,)), ('held', 'u1', (2,)), ('v_old', 'f8', (2,)),
    ('v_new', 'f8', (2,)), ('scratch', 'f8', (5, 6)), ('k', 'f8', (6, 4)), ('a', 'f8', (6, 6)),
    ('b', 'f8', (6, 2)), ('rho', 'f8', (8,)))
"""x^ = (theta^, theta^', f^): absolute angles and physical sensors; z of method ``paper``; links
that are held; work space."""


def recursion(arm, observer):
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
    c = new_record(RECURSION_CONSTANTS, joints=JointMap(arm).record(), arm=arm.constants())
    if observer.method == 'exact':
        low, high = slope_range(arm)
        c.exact, c.kappa, c.mu = True, arm.sign * np.asarray(observer.kappa), observer.mu
        # The region ends at |cos| = 1; no rounding of the cosine may leave it.
        c.low = np.where(low <= -1.0, -1.0 - 1e-9, low)
        c.high = np.where(high >= 1.0, 1.0 + 1e-9, high)
        return c
    a, b = vertex_matrices(np.ascontiguousarray(observer.box), arm.constants(coriolis=False))
    descriptor = Descriptor(a, b, arm)
    c.paper = new_record(_PAPER, t1=observer.t1, t2=observer.t2, k=observer.k, box=observer.box,
                         c=np.hstack(output_matrices(arm)), a=descriptor.a, b=descriptor.b)
    return c


@njit
def advance(c, s, y_old, y_new, torque, dt):
    """Advance over one interval.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends, sensor coordinates [rad], [rad/s].
    torque : ndarray, shape (2,)
        Generalised torques Q over the interval [N m].
    dt : float
        Its length [s].
    """
    if not c.exact:
        p = c.paper
        paper_step(s.z, y_old, y_new, torque, dt, p.k, p.t1, p.t2, p.c, p.a, p.b, p.box, s.x,
                   s.scratch, s.k, s.a, s.b, s.rho)
        return
    for i in range(2):
        s.v_old[i] = weigh(c.joints.angle, i, y_old[2], y_old[3])
        s.v_new[i] = weigh(c.joints.angle, i, y_new[2], y_new[3])
    exact_step(s.x, s.v_old, s.v_new, torque, dt, c.kappa, c.mu, c.arm, c.low, c.high, s.held)
    for i in range(2):
        s.x[4 + i] = y_new[i] - weigh(c.joints.sensor, i, s.x[0], s.x[1])


@njit
def place(c, s, y):
    """Take ``x`` as it was changed from outside: z follows from x^ = z + T2 y (38).

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.
    y : ndarray, shape (4,)
        Outputs that belong to it.
    """
    if c.exact:
        return  # there, x is the whole state
    for i in range(6):
        total = 0.0
        for j in range(4):
            total += c.paper.t2[i, j] * y[j]
        s.z[i] = s.x[i] - total
