"""The paper's unknown-input observer, eqs. (38)-(53): algebra and sampled recursion.

With K_i = N_i T2 - L_i (50), N_i = T1 A~_i + K_i C~, L_i = N_i T2 - K_i and G_i = T1 B~_i of
eqs. (51)-(53), the observer (38) written in its estimate x^ = z + T2 y is

    z' = T1 (A~(rho) x^ + B~(rho) u) + K(rho) (C~ x^ - y),

which method ``paper`` integrates literally, by the Heun rule with the torque held and the outputs
of both ends of the step.  Method ``exact`` is in :mod:`lpv.core.uio.observer.exact_observer`.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.support.entries import array, entry, positive
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import new_record, record_type
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import copy_vector
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


PAPER_CONSTANTS = record_type(
    ('t1', 'f8', (6, 6)),  # T1
    ('t2', 'f8', (6, 4)),  # T2
    ('c', 'f8', (4, 6)),  # C~
    ('box', 'f8', (3, 2)),  # ranges of phi1, phi2, phi3
    ('k', 'f8', (8, 6, 4)),  # K_i
    ('ab', 'f8', (8, 6, 8)),  # [A~_i B~_i]
)
PAPER_STATE = record_type(
    ('rho', 'f8', (8,)),  # weights of the vertices
    ('k', 'f8', (6, 4)),  # K(rho)
    ('ab', 'f8', (6, 8)),  # [A~(rho) B~(rho)]
    ('xu', 'f8', (8,)),  # x^ and u
    ('r', 'f8', (4,)),  # C~ x^ - y
    ('drift', 'f8', (6,)),  # A~ x^ + B~ u
    ('start', 'f8', (6,)),  # z of eq. (38) at the start of the interval
    ('rate', 'f8', (2, 6)),  # z' at both ends of the interval
)


def paper_constants(arm: ArmParameters, gains: PaperObserverGains) -> np.record:
    """Constants of `paper_step`, of type `PAPER_CONSTANTS`."""
    d = paper_descriptor(arm, gains.box)
    return new_record(
        PAPER_CONSTANTS, t1=gains.t1, t2=gains.t2, c=d.c, box=gains.box, k=gains.k,
        ab=np.dstack([d.a, d.b]),
    )  # fmt: skip


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
def _add_product(out: np.ndarray, matrix: np.ndarray, vector: np.ndarray, sign: float) -> None:
    """out += sign matrix @ vector, in one fixed order of additions."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i] += sign * matrix[i, j] * vector[j]


@njit
def _rate(params: np.record, state: np.record, y: np.ndarray, end: int) -> None:
    """z' = T1 (A~ x^ + B~ u) + K (C~ x^ - y), eq. (38) with (50)-(53)."""
    r, drift, rate = state.r, state.drift, state.rate[end]
    for i in range(4):
        r[i] = -y[i]
    _add_product(r, params.c, state.xu, 1.0)
    drift[:] = 0.0
    _add_product(drift, state.ab, state.xu, 1.0)
    rate[:] = 0.0
    _add_product(rate, params.t1, drift, 1.0)
    _add_product(rate, state.k, r, 1.0)


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

    The weights come from the estimated angles, eqs. (6), (9), (11), (12) and (25): theta is not
    measured without the fault.

    The estimate ``x`` = z + T2 y is advanced from the outputs at both ends of the interval and the
    input u held over it [N m], absolute coordinates.
    """
    start, rate, xu = state.start, state.rate, state.xu
    copy_vector(x, start)
    _add_product(start, params.t2, y_old, -1.0)
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, params.box, state.rho)
    blend(state.rho, params.ab, state.ab)
    blend(state.rho, params.k, state.k)
    copy_vector(x, xu)
    xu[6], xu[7] = torque[0], torque[1]
    _rate(params, state, y_old, 0)
    for i in range(6):
        xu[i] = start[i] + dt * rate[0, i]
    _add_product(xu, params.t2, y_new, 1.0)
    _rate(params, state, y_new, 1)
    for i in range(6):
        x[i] = start[i] + 0.5 * dt * (rate[0, i] + rate[1, i])
    _add_product(x, params.t2, y_new, 1.0)
