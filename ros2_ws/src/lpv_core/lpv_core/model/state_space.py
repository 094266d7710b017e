"""The paper's polytopic LPV model, eqs. (13)-(31), and its descriptor augmentation, (35)-(37)."""

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.model.polytope import paper_scheduling, paper_vertices, paper_weights
from lpv_core.model.runge_kutta import State, ahead, weighted
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type

LPV_PLANT = record_type(
    ('box', 'f8', (3, 2)),  # ranges of phi1, phi2, phi3
    ('a', 'f8', (8, 4, 4)),  # A of the vertices
    ('b', 'f8', (8, 4, 2)),  # B of the vertices
)
"""The paper's plant, eq. (25)."""


def inertia_matrix(phi_1: float, params: np.record) -> np.ndarray:
    """Xi(phi1) of eq. (5), with m2*L1^2 in its (1, 1) element.

    Parameters
    ----------
    phi_1 : float
        cos(theta1 - theta2).
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    ndarray, shape (2, 2)
        Inertia [kg m2].
    """
    off = params.rotor_coupling + params.coupling * phi_1
    return np.array([[params.inertia[0], off], [off, params.inertia[1]]])


def gravity_matrix(phi_2: float, phi_3: float, params: np.record) -> np.ndarray:
    """G^g of eq. (8), with g(theta) = G^g theta.

    Parameters
    ----------
    phi_2, phi_3 : float
        sinc(theta1), sinc(theta2).
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    ndarray, shape (2, 2)
        [N m/rad].
    """
    return -np.diag([params.gravity[0] * phi_2, params.gravity[1] * phi_3])


def vertex_matrices(box: np.ndarray, params: np.record) -> tuple[np.ndarray, ...]:
    """A_i and B_i of eqs. (22)-(24), (27), (28) at the eight vertices.

    Parameters
    ----------
    box : array_like, shape (3, 2)
        Ranges of phi1, phi2, phi3.
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of ndarray
        A, shape (8, 4, 4), and B, shape (8, 4, 2).
    """
    a, b = np.zeros((8, 4, 4)), np.zeros((8, 4, 2))
    w_b = np.vstack([np.zeros((2, 2)), np.eye(2)])
    for i, (phi_1, phi_2, phi_3) in enumerate(paper_vertices(box)):
        pi = np.eye(4)
        pi[2:, 2:] = inertia_matrix(phi_1, params)
        right = np.zeros((4, 4))
        right[:2, 2:] = np.eye(2)
        right[2:, :2] = -gravity_matrix(phi_2, phi_3, params)
        a[i] = np.linalg.solve(pi, right)
        b[i] = np.linalg.solve(pi, w_b)
    return a, b


def output_matrices(arm: ArmParameters) -> tuple[np.ndarray, ...]:
    """C and Df of eqs. (29), (30) for the arm's sensor arrangement.

    Outputs are the two physical position sensors and the matching rates,
    y = [S theta + f; S theta'].  For sensors of absolute angles S = I and these are the paper's.

    Parameters
    ----------
    arm : ArmParameters
        Supplies the arrangement.

    Returns
    -------
    tuple of ndarray
        C, shape (4, 4), and Df, shape (4, 2).
    """
    s = JointMap(arm).sensor_matrix
    c = np.zeros((4, 4))
    c[:2, :2] = s
    c[2:, 2:] = s
    return c, np.vstack([np.eye(2), np.zeros((2, 2))])


def disturbance_matrix(arm: ArmParameters) -> np.ndarray:
    """Bd of eq. (31), shape (4, 1)."""
    return np.array([[0.0], [0.0], *[[v] for v in arm.disturbance_direction]])


class Descriptor:
    """Augmented singular system (36) with x~ = [x; f], eqs. (35)-(37).

    Parameters
    ----------
    a : ndarray, shape (h, 4, 4)
        A_i at the vertices.
    b : ndarray, shape (h, 4, 2)
        B_i at the vertices.
    arm : ArmParameters
        Supplies C, Df and Bd.

    Attributes
    ----------
    e, a, b, bd, bf, c : ndarray
        E (6, 6), A~ (h, 6, 6), B~ (h, 6, 2), Bd~ (6, 1), Bf~ (6, 2) and C~ (4, 6).  The paper
        prints Bf~ = [0; I_n]; its identity has the size of f.
    """

    def __init__(self, a: np.ndarray, b: np.ndarray, arm: ArmParameters) -> None:
        h = len(a)
        c, df = output_matrices(arm)
        self.e = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
        self.a = np.zeros((h, 6, 6))
        self.a[:, :4, :4] = a
        self.a[:, 4:, 4:] = -np.eye(2)
        self.b = np.zeros((h, 6, 2))
        self.b[:, :4] = b
        self.bd = np.vstack([disturbance_matrix(arm), np.zeros((2, 1))])
        self.bf = np.vstack([np.zeros((4, 2)), np.eye(2)])
        self.c = np.hstack([c, df])


@njit
def lpv_rates(
    x: State, torque: tuple[float, float], plant: np.record, rho: np.ndarray
) -> tuple[float, float]:
    """Right side of the paper's own LPV plant, eq. (25) without disturbance.

    Parameters
    ----------
    x : tuple of float
        State, eq. (21) [rad], [rad/s].
    torque : tuple of float
        Input u [N m], absolute coordinates.
    plant : numpy.record
        Vertices and box, of type `LPV_PLANT`; phi is clipped to the box.
    rho : ndarray, shape (8,)
        Scratch for the weights.

    Returns
    -------
    tuple of float
        theta'' [rad/s2]; the upper rows of (25) are theta' itself.
    """
    a, b = plant.a, plant.b
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, plant.box, rho)
    acc_1, acc_2 = 0.0, 0.0
    for i in range(8):
        acc_1 += rho[i] * (
            a[i, 2, 0] * x[0] + a[i, 2, 1] * x[1] + b[i, 2, 0] * torque[0] + b[i, 2, 1] * torque[1]
        )
        acc_2 += rho[i] * (
            a[i, 3, 0] * x[0] + a[i, 3, 1] * x[1] + b[i, 3, 0] * torque[0] + b[i, 3, 1] * torque[1]
        )
    return acc_1, acc_2


@njit
def _slope(
    x: State,
    torque: tuple[float, float],
    push: tuple[float, float],
    plant: np.record,
    rho: np.ndarray,
) -> State:
    acc_1, acc_2 = lpv_rates(x, torque, plant, rho)
    return x[2], x[3], acc_1 + push[0], acc_2 + push[1]


@njit
def lpv_rk4_step(
    x: State,
    torque: tuple[float, float],
    push: tuple[float, float],
    dt: float,
    plant: np.record,
    rho: np.ndarray,
) -> State:
    """Advance the LPV plant (25) by one Runge-Kutta step with torques held.

    Parameters
    ----------
    x, torque, plant, rho
        As `lpv_rates`.
    push : tuple of float
        Bd*d [rad/s2].
    dt : float
        Step [s].

    Returns
    -------
    tuple of float
        The state after ``dt``.
    """
    k1 = _slope(x, torque, push, plant, rho)
    k2 = _slope(ahead(x, k1, 0.5 * dt), torque, push, plant, rho)
    k3 = _slope(ahead(x, k2, 0.5 * dt), torque, push, plant, rho)
    k4 = _slope(ahead(x, k3, dt), torque, push, plant, rho)
    return weighted(x, k1, k2, k3, k4, dt)
