"""The paper's unknown-input observer, eqs. (38)-(53): algebra and sampled recursion.

With K_i = N_i T2 - L_i (50), N_i = T1 A~_i + K_i C~, L_i = N_i T2 - K_i and G_i = T1 B~_i of
eqs. (51)-(53), the observer (38) written in its estimate x^ = z + T2 y is

    z' = N(rho) x^ - K(rho) y + G(rho) u,

which method ``paper`` takes literally; method ``exact`` is in
:mod:`lpv.core.uio.observer.exact_observer`.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.config import Section
from lpv.core.support.entries import array, entry, positive
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.uio.model.polytope import paper_descriptor, paper_scheduling, paper_weights


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

    def check(self, section: Section) -> None:
        """ConfigError for a box without width, or a disc that reaches unstable poles."""
        if np.any(self.box[:, 0] >= self.box[:, 1]):
            raise section.error('box', 'must have lower ends below upper ends')
        if not self.r < self.q:
            raise section.error('r', 'must be below q')

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


def observer_matrices(arm: ArmParameters, gains: PaperObserverGains) -> np.ndarray:
    """N_i, -K_i and G_i of eqs. (50)-(53) side by side, shape (8, 6, 12): z' from x^, y and u."""
    d = paper_descriptor(arm, gains.box)
    n = gains.t1 @ d.a + gains.k @ d.c
    return np.concatenate([n, -gains.k, gains.t1 @ d.b], axis=2)


@njit
def paper_rate(params: np.record, state: np.record, y: np.ndarray, end: int) -> None:
    """z' = N x^ - K y + G u, eq. (38) with (50), at one end of a step.

    The matrices are those of the angles at the first end, eqs. (6), (9), (11), (12) and (25), as
    estimated: theta is not measured without the fault.
    """
    matrix, rate, rho, torque = state.matrix, state.rate[end], state.rho, state.torque
    if end == 0:
        paper_weights(paper_scheduling(state.x[0], state.x[1]), params.box, rho)
        matrix[:] = 0.0
        for i in range(8):
            for r in range(6):
                for q in range(12):
                    matrix[r, q] += rho[i] * params.matrices[i, r, q]
    for r in range(6):
        rate[r] = matrix[r, 10] * torque[0] + matrix[r, 11] * torque[1]
        for q in range(6):
            rate[r] += matrix[r, q] * state.x[q]
        for q in range(4):
            rate[r] += matrix[r, 6 + q] * y[q]
