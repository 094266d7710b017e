"""The paper's unknown-input observer, eqs. (38)-(53): algebra and sampled recursion.

With K_i = N_i T2 - L_i (50), N_i = T1 A~_i + K_i C~, L_i = N_i T2 - K_i and G_i = T1 B~_i of
eqs. (51)-(53), the observer (38) written in its estimate x^ = z + T2 y is

    z' = T1 (A~(rho) x^ + B~(rho) u) + K(rho) (C~ x^ - y),

which method ``paper`` takes literally; method ``exact`` is in
:mod:`lpv.core.uio.observer.exact_observer`.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.support.entries import array, entry, positive
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.uio.model.polytope import paper_scheduling, paper_weights


@dataclass(frozen=True)
class PaperObserverGains:
    """Observer of method ``paper``, eqs. (41) and (56), with what its certificate claims."""

    method: str = entry('text', choices=('paper',))
    box: np.ndarray = array(3, 2)  # ranges of phi1, phi2, phi3
    t1: np.ndarray = array(6, 6)  # decoupling matrix T1, eq. (41), row by row
    t2: np.ndarray = array(6, 4)  # decoupling matrix T2, eq. (41), row by row
    k: np.ndarray = array(8, 6, 4)  # K of all vertices, eq. (56), row by row
    lyapunov: np.ndarray = array(6, 6)  # Lyapunov matrix P, row by row
    lmi: str = entry('text', choices=('55', '54+disc'))  # inequalities that hold
    gamma: float = positive()  # attenuation level [1]
    q: float = positive()  # distance of the centre of the poles' disc [1/s]
    r: float = positive()  # radius of that disc [1/s]
    # standard deviations of the fault estimates [rad]
    fault_sigma: np.ndarray = array(2, low=0.0)

    @property
    def decay(self) -> float:
        """Certified decay rate [1/s]."""
        return self.q - self.r


def decoupling(e: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T1, shape (6, 6), and T2, shape (6, 4), with T1 E + T2 C~ = I, eq. (41).

    They are made by the pseudo-inverse of E, shape (6, 6), above C~, shape (4, 6), eqs. (47)-(49).
    """
    delta = np.linalg.pinv(np.vstack([e, c]))
    return delta[:, :6], delta[:, 6:]


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
def add_product(out: np.ndarray, matrix: np.ndarray, vector: np.ndarray, sign: float) -> None:
    """out += sign matrix @ vector, in one fixed order of additions."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i] += sign * matrix[i, j] * vector[j]


@njit
def schedule(params: np.record, state: np.record) -> None:
    """A~, B~ and K of the estimated angles, eqs. (6), (9), (11), (12) and (25): theta is not
    measured without the fault."""
    phi_1, phi_2, phi_3 = paper_scheduling(state.x[0], state.x[1])
    paper_weights(phi_1, phi_2, phi_3, params.box, state.rho)
    blend(state.rho, params.a, state.a)
    blend(state.rho, params.b, state.b)
    blend(state.rho, params.k, state.k)


@njit
def paper_rate(
    params: np.record, state: np.record, y: np.ndarray, torque: np.ndarray, end: int
) -> None:
    """z' = T1 (A~ x^ + B~ u) + K (C~ x^ - y), eq. (38) with (50)-(53), at one end of a step."""
    r, drift, rate = state.r, state.drift, state.rate[end]
    for i in range(4):
        r[i] = -y[i]
    add_product(r, params.c, state.x, 1.0)
    drift[:] = 0.0
    add_product(drift, state.a, state.x, 1.0)
    add_product(drift, state.b, torque, 1.0)
    rate[:] = 0.0
    add_product(rate, params.t1, drift, 1.0)
    add_product(rate, state.k, r, 1.0)
