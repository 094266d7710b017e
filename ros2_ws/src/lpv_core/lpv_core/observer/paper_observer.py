"""The paper's unknown-input observer, eqs. (38)-(53): algebra and sampled recursion.

With K_i = N_i T2 - L_i (50), the observer (38) written in its estimate x^ = z + T2 y is

    z' = T1 (A~(rho) x^ + B~(rho) u) + K(rho) (C~ x^ - y),

which method ``paper`` integrates literally, by the Heun rule with the torque held and the outputs
of both ends of the step.  Method ``exact`` is in :mod:`lpv_core.observer.exact_observer`.
"""

import numpy as np

from lpv_core.model.polytope import paper_scheduling, paper_weights
from lpv_core.support.jit import njit

N_AUGMENTED = 6
N_OUTPUTS = 4


def decoupling(estimate: np.ndarray, params: np.ndarray) -> tuple[np.ndarray, ...]:
    """T1 and T2 from the pseudo-inverse, eqs. (47)-(49).

    Parameters
    ----------
    estimate : ndarray, shape (6, 6)
        Singular matrix E.
    params : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4), with T1 E + T2 C~ = I, eq. (41).
    """
    delta = np.linalg.pinv(np.vstack([estimate, params]))
    return delta[:, :N_AUGMENTED], delta[:, N_AUGMENTED:]


def fault_feedthrough(params: np.ndarray) -> tuple[np.ndarray, ...]:
    """T1 and T2 of method ``exact``: T2 = [0; I 0], and T1 = [(I - T2 C~) restricted to x, 0].

    Every solution of T1 E + T2 C~ = I has these first two columns of T2, so that no position fault
    reaches z; choosing zeros for the rest keeps the whole torque balance in T1.

    Parameters
    ----------
    params : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4).
    """
    t2 = np.zeros((N_AUGMENTED, N_OUTPUTS))
    t2[4:, :2] = np.eye(2)
    t1 = np.eye(N_AUGMENTED) - t2 @ params
    t1[:, 4:] = 0.0
    return t1, t2


def observer_matrices(
    a: np.ndarray, b: np.ndarray, params: np.ndarray, t1: np.ndarray, t2: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, ...]:
    """N_i, L_i and G_i of eqs. (51)-(53).

    Parameters
    ----------
    a, b : ndarray, shapes (h, 6, 6) and (h, 6, 2)
        Augmented vertices A~_i, B~_i.
    params : ndarray, shape (4, 6)
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
    n = t1 @ a + k @ params
    return n, n @ t2 - k, t1 @ b


@njit
def _multiply(matrix, vector, out) -> None:
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] = total


@njit
def blend(rho: np.ndarray, stack: np.ndarray, out: np.ndarray) -> None:
    """out = sum_i rho_i stack_i, the interpolation of eq. (25).

    Parameters
    ----------
    rho : ndarray, shape (h,)
        Weights of the vertices.
    stack : ndarray, shape (h, r, q)
        A matrix for each vertex.
    out : ndarray, shape (r, q)
        Receives the sum.
    """
    for r in range(out.shape[0]):
        for q in range(out.shape[1]):
            total = 0.0
            for i in range(rho.shape[0]):
                total += rho[i] * stack[i, r, q]
            out[r, q] = total


@njit
def _estimate(z, y, t2, out) -> None:
    """x^ = z + T2 y, eq. (38)."""
    for i in range(6):
        total = z[i]
        for j in range(4):
            total += t2[i, j] * y[j]
        out[i] = total


@njit
def _innovation(x, y, params, out) -> None:
    for i in range(4):
        total = -y[i]
        for j in range(6):
            total += params[i, j] * x[j]
        out[i] = total


@njit
def _paper_rates(x, y, torque, t1, params, a, b, k, drift, r, out) -> None:
    _innovation(x, y, params, r)
    for i in range(6):
        total = b[i, 0] * torque[0] + b[i, 1] * torque[1]
        for j in range(6):
            total += a[i, j] * x[j]
        drift[i] = total
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += t1[i, j] * drift[j]
        for j in range(4):
            total += k[i, j] * r[j]
        out[i] = total


@njit
def paper_step(
    z: np.ndarray,
    y_old: np.ndarray,
    y_new: np.ndarray,
    torque: np.ndarray,
    dt: float,
    gains: np.ndarray,
    t1: np.ndarray,
    t2: np.ndarray,
    params: np.ndarray,
    a_vertices: np.ndarray,
    b_vertices: np.ndarray,
    box: np.ndarray,
    x: np.ndarray,
    scratch: np.ndarray,
    k: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    rho: np.ndarray,
) -> None:
    """Advance the paper's observer (38) over one sample interval, in place.

    The weights come from the estimated angles: theta is not measured without the fault.

    Parameters
    ----------
    z : ndarray, shape (6,)
        Observer state; advanced in place.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends of the interval.
    torque : ndarray, shape (2,)
        Input u [N m], absolute coordinates.
    dt : float
        Length of the interval [s].
    gains : ndarray, shape (8, 6, 4)
        K_i.
    t1, t2, params : ndarray
        T1, T2, C~.
    a_vertices, b_vertices : ndarray, shapes (8, 6, 6) and (8, 6, 2)
        A~_i and B~_i.
    box : ndarray, shape (3, 2)
        Ranges of phi1, phi2, phi3.
    x : ndarray, shape (6,)
        Receives the estimate at the end of the interval.
    scratch : ndarray, shape (5, 6)
        Work space.
    k, a, b, rho : ndarray, shapes (6, 4), (6, 6), (6, 2), (8,)
        Receive the interpolated matrices and the weights.
    """
    first, second, drift, r, trial = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    _estimate(z, y_old, t2, x)
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, box, rho)
    blend(rho, a_vertices, a)
    blend(rho, b_vertices, b)
    blend(rho, gains, k)
    _paper_rates(x, y_old, torque, t1, params, a, b, k, drift, r, first)
    for i in range(6):
        trial[i] = z[i] + dt * first[i]
    _estimate(trial, y_new, t2, x)
    _paper_rates(x, y_new, torque, t1, params, a, b, k, drift, r, second)
    for i in range(6):
        z[i] += 0.5 * dt * (first[i] + second[i])
    _estimate(z, y_new, t2, x)
