"""Polytopic descriptions of the arm: the paper's box and an exact polytope.

**Paper** (eqs. (6), (9)-(20)): three scheduling variables phi1 = cos(theta1 - theta2),
phi2 = sinc(theta1), phi3 = sinc(theta2) in a box of 2^3 = 8 vertices.  Interpolating
A_i = pi_i^-1 [...] over that box does not reproduce Xi(theta)^-1: at phi1 = 0 the interpolated
input matrix of the paper's arm is 1.83 times the true one.

**Exact**: the pair (x, y) = (1/det Xi, Xi12/det Xi) gives Xi^-1 = [[Xi22 x, -y], [-y, Xi11 x]]
linearly.  It runs on a convex arc, which a quadrangle of two end points and two tangent
intersections contains.  With the two slopes of gravity, cos(xi_1) and cos(xi_2) in the mean-value
form sin(theta) - sin(w) = cos(xi) (theta - w), A and B are multi-affine, and 4 x 2 x 2 = 16
vertices contain the arm of eq. (4), without Coriolis terms, for the design of the controller.
"""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.support.jit import njit

PHI_1_RANGE = (-1.0, 1.0)
PUBLISHED_SINC_RANGE = (-0.2, 1.0)
"""Box of phi2 and phi3 in eq. (9); sinc falls to -0.2172 at 4.49 rad, the paper rounds."""

# ------------------------------------------------------------------ the paper's box


@njit
def sinc(angle: float) -> float:
    """sin(angle)/angle with its limit 1 at 0, eq. (9)."""
    if abs(angle) < 1e-4:
        return 1.0 - angle * angle / 6.0
    return math.sin(angle) / angle


@njit
def paper_scheduling(theta_1: float, theta_2: float) -> tuple[float, ...]:
    """Scheduling variables (phi1, phi2, phi3) of eqs. (6) and (9)."""
    return math.cos(theta_1 - theta_2), sinc(theta_1), sinc(theta_2)


@njit
def paper_weights(
    phi_1: float, phi_2: float, phi_3: float, box: np.ndarray, out: np.ndarray
) -> None:
    """Vertex weights rho_1..rho_8 of eqs. (11)-(12), written to ``out``.

    Variables outside the box are clipped to it: weights stay in [0, 1] and sum to one.

    Parameters
    ----------
    phi_1, phi_2, phi_3 : float
        Scheduling variables.
    box : ndarray, shape (3, 2)
        Minimum and maximum of each variable.
    out : ndarray, shape (8,)
        Receives the weights; vertex 1 is (min, min, min), vertex 8 (max, max, max).
    """
    a1 = min(max((box[0, 1] - phi_1) / (box[0, 1] - box[0, 0]), 0.0), 1.0)
    a2 = min(max((box[1, 1] - phi_2) / (box[1, 1] - box[1, 0]), 0.0), 1.0)
    a3 = min(max((box[2, 1] - phi_3) / (box[2, 1] - box[2, 0]), 0.0), 1.0)
    out[0] = a1 * a2 * a3
    out[1] = a1 * a2 * (1.0 - a3)
    out[2] = a1 * (1.0 - a2) * a3
    out[3] = a1 * (1.0 - a2) * (1.0 - a3)
    out[4] = (1.0 - a1) * a2 * a3
    out[5] = (1.0 - a1) * a2 * (1.0 - a3)
    out[6] = (1.0 - a1) * (1.0 - a2) * a3
    out[7] = (1.0 - a1) * (1.0 - a2) * (1.0 - a3)


def paper_vertices(box: np.ndarray) -> np.ndarray:
    """Vertices omega_i of eq. (10) in the order of the weights (11).

    The paper lists the gravity matrices (17)-(20) with phi2 and phi3 exchanged in vertices 2, 3,
    6, 7; the order here is the one that the weights (11) imply.

    Parameters
    ----------
    box : array_like, shape (3, 2)
        Minimum and maximum of phi1, phi2, phi3.

    Returns
    -------
    ndarray, shape (8, 3)
        One vertex a row.
    """
    return np.array(list(product(*np.asarray(box, float))))


def sinc_box(s_min: float, s_max: float = 1.0) -> np.ndarray:
    """Return the box with phi2, phi3 in [s_min, s_max] and phi1 in [-1, 1]."""
    return np.array([PHI_1_RANGE, (s_min, s_max), (s_min, s_max)])


# ------------------------------------------------------------------ the exact polytope


def inverse_inertia_quadrangle(params: np.record) -> np.ndarray:
    """Quadrangle that contains (1/det Xi, Xi12/det Xi) for every configuration.

    Parameters
    ----------
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    ndarray, shape (4, 2)
        Corners in circular order: end of the arc, two tangent intersections, other end.
    """
    low, high = params.rotor_coupling - params.coupling, params.rotor_coupling + params.coupling
    middle = 0.5 * (low + high)

    def point(state: float) -> np.ndarray:
        det = params.inertia[0] * params.inertia[1] - state * state
        return np.array([1.0 / det, state / det])

    def tangent(state: float) -> np.ndarray:
        det = params.inertia[0] * params.inertia[1] - state * state
        return np.array([2.0 * state / det**2, (det + 2.0 * state * state) / det**2])

    def intersection(state: float, r: float) -> np.ndarray:
        p, q = point(state), point(r)
        step = np.linalg.solve(np.column_stack([tangent(state), -tangent(r)]), q - p)
        return p + step[0] * tangent(state)

    return np.array(
        [point(low), intersection(low, middle), intersection(middle, high), point(high)]
    )


def slope_range(arm: ArmParameters) -> tuple[np.ndarray, ...]:
    """Range of the gravity slopes cos(theta_i) in the arm's operating region."""
    near = np.array(arm.cos_min)
    if arm.orientation == 'upright':
        return near, np.ones(2)
    return -np.ones(2), -near


def exact_vertices(arm: ArmParameters) -> np.ndarray:
    """Vertices of the exact polytope.

    Parameters
    ----------
    arm : ArmParameters
        The arm and its region.

    Returns
    -------
    ndarray, shape (16, 4)
        Rows (x, y, cos1, cos2).
    """
    low, high = slope_range(arm)
    corners = inverse_inertia_quadrangle(arm.constants())
    return np.array(
        [[x, y, c1, c2] for x, y in corners for c1 in (low[0], high[0]) for c2 in (low[1], high[1])]
    )


def exact_state_space(vertex: Sequence[float], params: np.record) -> tuple[np.ndarray, ...]:
    """State matrices of the error dynamics at one vertex of the exact polytope.

    Parameters
    ----------
    vertex : sequence of four floats
        (1/det Xi, Xi12/det Xi, cos xi_1, cos xi_2).
    params : numpy.record
        Constants of the arm.

    Returns
    -------
    tuple of ndarray
        A, shape (4, 4), and B, shape (4, 2); cf. eqs. (27), (28).
    """
    x, y, cos_1, cos_2 = vertex
    inverse = np.array([[params.inertia[1] * x, -y], [-y, params.inertia[0] * x]])
    a = np.zeros((4, 4))
    a[:2, 2:] = np.eye(2)
    a[2:, :2] = inverse @ np.diag([params.gravity[0] * cos_1, params.gravity[1] * cos_2])
    b = np.zeros((4, 2))
    b[2:] = inverse
    return a, b
