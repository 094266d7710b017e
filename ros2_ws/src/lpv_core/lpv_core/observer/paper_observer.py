"""The paper's unknown-input observer, eqs. (38)-(53): algebra and sampled recursion.

With K_i = N_i T2 - L_i (50), the observer (38) written in its estimate x^ = z + T2 y is

    z' = T1 (A~(rho) x^ + B~(rho) u) + K(rho) (C~ x^ - y),

which method ``paper`` integrates literally, by the Heun rule with the torque held and the outputs
of both ends of the step.  Method ``exact`` is in :mod:`lpv_core.observer.exact_observer`.
"""

import numpy as np

from lpv_core.certificate.gains import PaperObserverGains
from lpv_core.model.arm import ArmParameters
from lpv_core.model.polytope import paper_scheduling, paper_weights
from lpv_core.model.state_space import Descriptor, output_matrices, vertex_matrices
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

N_AUGMENTED = 6
N_OUTPUTS = 4


def decoupling(e: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T1 and T2 from the pseudo-inverse, eqs. (47)-(49).

    Parameters
    ----------
    e : ndarray, shape (6, 6)
        Singular matrix E.
    c : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4), with T1 E + T2 C~ = I, eq. (41).
    """
    delta = np.linalg.pinv(np.vstack([e, c]))
    return delta[:, :N_AUGMENTED], delta[:, N_AUGMENTED:]


def fault_feedthrough(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T1 and T2 of method ``exact``: T2 = [0; I 0], and T1 = [(I - T2 C~) restricted to x, 0].

    Every solution of T1 E + T2 C~ = I has these first two columns of T2, so that no position fault
    reaches z; choosing zeros for the rest keeps the whole torque balance in T1.

    Parameters
    ----------
    c : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4).
    """
    t2 = np.zeros((N_AUGMENTED, N_OUTPUTS))
    t2[4:, :2] = np.eye(2)
    t1 = np.eye(N_AUGMENTED) - t2 @ c
    t1[:, 4:] = 0.0
    return t1, t2


def observer_matrices(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, t1: np.ndarray, t2: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """N_i, L_i and G_i of eqs. (51)-(53).

    Parameters
    ----------
    a, b : ndarray, shapes (h, 6, 6) and (h, 6, 2)
        Augmented vertices A~_i, B~_i.
    c : ndarray, shape (4, 6)
        C~.
    t1, t2 : ndarray
        Decoupling matrices.
    k : ndarray, shape (h, 6, 4)
        K_i.

    Returns
    -------
    tuple of ndarray
        N (h, 6, 6), L (h, 6, 4), G (h, 6, 2).
    """
    n = t1 @ a + k @ c
    return n, n @ t2 - k, t1 @ b


PAPER_CONSTANTS = record_type(
    ('t1', 'f8', (6, 6)),  # T1
    ('t2', 'f8', (6, 4)),  # T2
    ('c', 'f8', (4, 6)),  # C~
    ('box', 'f8', (3, 2)),  # ranges of phi1, phi2, phi3
    ('k', 'f8', (8, 6, 4)),  # K_i
    ('a', 'f8', (8, 6, 6)),  # A~_i
    ('b', 'f8', (8, 6, 2)),  # B~_i
)
PAPER_STATE = record_type(
    ('z', 'f8', (6,)),  # state of eq. (38)
    ('rho', 'f8', (8,)),  # weights of the vertices
    ('k', 'f8', (6, 4)),  # K(rho)
    ('a', 'f8', (6, 6)),  # A~(rho)
    ('b', 'f8', (6, 2)),  # B~(rho)
    ('start', 'f8', (6,)),  # z at the start of the interval
    ('r', 'f8', (4,)),  # C~ x^ - y
    ('drift', 'f8', (6,)),  # A~ x^ + B~ u
    ('rate', 'f8', (2, 6)),  # z' at both ends of the interval
)


def paper_constants(arm: ArmParameters, gains: PaperObserverGains) -> np.record:
    """Constants of `paper_step`, of type `PAPER_CONSTANTS`."""
    a, b = vertex_matrices(np.ascontiguousarray(gains.box), arm.constants(coriolis=False))
    descriptor = Descriptor(a, b, arm)
    return new_record(
        PAPER_CONSTANTS,
        t1=gains.t1,
        t2=gains.t2,
        c=np.hstack(output_matrices(arm)),
        box=gains.box,
        k=gains.k,
        a=descriptor.a,
        b=descriptor.b,
    )


@njit
def blend(rho: np.ndarray, stack: np.ndarray, out: np.ndarray) -> None:
    """out = sum_i rho_i stack_i, the interpolation of eq. (25); shapes (h,), (h, r, q), (r, q)."""
    for r in range(out.shape[0]):
        for q in range(out.shape[1]):
            total = 0.0
            for i in range(rho.shape[0]):
                total += rho[i] * stack[i, r, q]
            out[r, q] = total


@njit
def add_product(out: np.ndarray, matrix: np.ndarray, vector: np.ndarray) -> None:
    """out += matrix @ vector, in one fixed order of additions."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i] += matrix[i, j] * vector[j]


@njit
def _estimate(params: np.record, z: np.ndarray, y: np.ndarray, x: np.ndarray) -> None:
    """x^ = z + T2 y, eq. (38)."""
    x[:] = z
    add_product(x, params.t2, y)


@njit
def _schedule(params: np.record, state: np.record, x: np.ndarray) -> None:
    """A~, B~ and K at the estimated angles, eqs. (6), (9), (11), (12) and (25)."""
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, params.box, state.rho)
    blend(state.rho, params.a, state.a)
    blend(state.rho, params.b, state.b)
    blend(state.rho, params.k, state.k)


@njit
def _rate(
    params: np.record, state: np.record, x: np.ndarray, y: np.ndarray, u: np.ndarray, end: int
) -> None:
    """z' = T1 (A~ x^ + B~ u) + K (C~ x^ - y), eq. (38) with (50)-(53)."""
    r, drift, rate = state.r, state.drift, state.rate[end]
    for i in range(4):
        r[i] = -y[i]
    add_product(r, params.c, x)  # C~ x^ - y
    drift[:] = 0.0
    add_product(drift, state.b, u)
    add_product(drift, state.a, x)  # A~ x^ + B~ u
    rate[:] = 0.0
    add_product(rate, params.t1, drift)
    add_product(rate, state.k, r)


@njit
def paper_step(
    params: np.record,
    state: np.record,
    x: np.ndarray,
    y_old: np.ndarray,
    y_new: np.ndarray,
    torque: np.ndarray,
    dt: float,
) -> None:
    """Advance the paper's observer (38) over one sample interval by the Heun rule.

    The weights come from the estimated angles: theta is not measured without the fault.

    Parameters
    ----------
    params, state : numpy.record
        Of types `PAPER_CONSTANTS` and `PAPER_STATE`; ``z`` is advanced.
    x : ndarray, shape (6,)
        Receives the estimate at the end of the interval.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends of the interval.
    torque : ndarray, shape (2,)
        Input u [N m], absolute coordinates.
    dt : float
        Length of the interval [s].
    """
    z, start, rate = state.z, state.start, state.rate
    start[:] = z
    _estimate(params, z, y_old, x)
    _schedule(params, state, x)
    _rate(params, state, x, y_old, torque, 0)
    for i in range(6):
        z[i] = start[i] + dt * rate[0, i]
    _estimate(params, z, y_new, x)
    _rate(params, state, x, y_new, torque, 1)
    for i in range(6):
        z[i] = start[i] + 0.5 * dt * (rate[0, i] + rate[1, i])
    _estimate(params, z, y_new, x)
