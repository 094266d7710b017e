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

Vertices and their matrices come in floats, or in exact fractions for proofs; so does the paper's
descriptor form of its LPV plant, eqs. (26), (35)-(37).
"""

import math
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.inequalities import NumberType, array_of
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.uio.model.joints import JointMap


@njit
def paper_scheduling(theta_1: float, theta_2: float) -> tuple[float, ...]:
    """Scheduling variables (phi1, phi2, phi3) of eqs. (6) and (9); NumPy's sinc is of pi x."""
    return math.cos(theta_1 - theta_2), np.sinc(theta_1 / math.pi), np.sinc(theta_2 / math.pi)


@njit
def paper_weights(phi: tuple[float, ...], box: np.ndarray, out: np.ndarray) -> None:
    """Vertex weights rho_1..rho_8 of eqs. (11)-(12), written to ``out``.

    Variables outside the box are clipped to it: weights stay in [0, 1] and sum to one.

    The box has a minimum and a maximum of each variable, shape (3, 2); vertex 1 is
    (min, min, min), vertex 8 (max, max, max).
    """
    out[:] = 1.0
    for k in range(3):
        share = min(max((box[k, 1] - phi[k]) / (box[k, 1] - box[k, 0]), 0.0), 1.0)
        for i in range(8):
            out[i] *= share if (i >> (2 - k)) % 2 == 0 else 1.0 - share


def sinc_box(s_min: float) -> np.ndarray:
    """Box with phi1 in [-1, 1] and phi2, phi3 in [s_min, 1], shape (3, 2).

    Eq. (9) has -0.2 for s_min; sinc falls to -0.2172 at 4.49 rad.
    """
    return np.array([(-1.0, 1.0), (s_min, 1.0), (s_min, 1.0)])


def inverse_inertia_quadrangle(params: Any) -> np.ndarray:
    """Quadrangle that contains (1/det Xi, Xi12/det Xi) for every configuration.

    With p = Xi11 Xi22 the arc lies on the conic p x^2 - x = y^2, whose tangents at Xi12 = s and r
    meet in (1, (s + r)/2) / (p - s r).  Corners, shape (4, 2), are in circular order: end of the
    arc, two tangent intersections, other end.  ``params`` are as of `state_spaces`.
    """
    low, high = params.rotor_coupling - params.coupling, params.rotor_coupling + params.coupling
    middle, corners = (low + high) / 2, []
    for s, r in ((low, low), (low, middle), (middle, high), (high, high)):
        det = params.inertia[0] * params.inertia[1] - s * r
        corners.append((1 / det, (s + r) / 2 / det))
    return np.array(corners)


def slope_range(arm: ArmParameters) -> tuple[np.ndarray, ...]:
    """Range of the gravity slopes cos(theta_i) in the arm's operating region."""
    near = np.array(arm.cos_min)
    if arm.orientation == 'upright':
        return near, np.ones(2)
    return -np.ones(2), -near


def exact_vertices(arm: ArmParameters, number: NumberType = float) -> np.ndarray:
    """Vertices of the exact polytope, rows (x, y, cos1, cos2), shape (16, 4)."""
    first, second = ([number(value) for value in pair] for pair in zip(*slope_range(arm)))
    corners = inverse_inertia_quadrangle(arm.numbers(number))
    return np.array(
        [[*corner, *cosines] for corner in corners for cosines in product(first, second)]
    )


def state_spaces(vertices: np.ndarray, params: Any) -> tuple[np.ndarray, np.ndarray]:
    """State matrices at vertices of a polytope, eqs. (5), (8) and (22)-(24), (27), (28).

    Parameters
    ----------
    vertices : ndarray, shape (h, 4)
        Rows of 1/det Xi, Xi12/det Xi, and the slopes of both gravity torques: cos xi_i of the exact
        polytope, phi2 and phi3 of the paper's, eq. (8).
    params : numpy.record or ArmNumbers
        Constants of the arm.

    Returns
    -------
    tuple of ndarray
        A = [[0, I], [-Xi^-1 G^g, 0]], shape (h, 4, 4), and B = [0; Xi^-1], shape (h, 4, 2).
    """
    x, y, *slopes = vertices.T
    inverse = np.array([[params.inertia[1] * x, -y], [-y, params.inertia[0] * x]])
    gravity = np.array([torque * slope for torque, slope in zip(params.gravity, slopes)])
    a, b = (np.zeros((len(x), 4, n), inverse.dtype) for n in (4, 2))
    a[:, :2, 2:] = np.eye(2, dtype=int)
    a[:, 2:, :2], b[:, 2:] = (inverse * gravity).T.swapaxes(1, 2), inverse.T
    return a, b


def vertex_matrices(box: np.ndarray, params: Any) -> tuple[np.ndarray, np.ndarray]:
    """A_i and B_i of eqs. (13)-(24), (27), (28) at the eight vertices of the paper's box.

    Vertices omega_i of eq. (10) are in the order of the weights (11).  The paper lists the gravity
    matrices (17)-(20) with phi2 and phi3 exchanged in vertices 2, 3, 6, 7; the order here is the
    one that the weights imply.  ``box``, shape (3, 2), has the ranges of phi1, phi2, phi3; the rest
    is as of `state_spaces`.
    """
    vertices = []
    for phi_1, phi_2, phi_3 in product(*box):
        off = params.rotor_coupling + params.coupling * phi_1
        det = params.inertia[0] * params.inertia[1] - off * off
        vertices.append((1 / det, off / det, phi_2, phi_3))
    return state_spaces(np.array(vertices), params)


class Descriptor(NamedTuple):
    """Augmented singular system (36) with x~ = [x; f], eqs. (35)-(37), at h vertices.

    Outputs are the two physical position sensors and the matching rates, eqs. (29), (30),
    y = [S theta + f; S theta'].  For sensors of absolute angles S = I and these are the paper's.
    """

    e: np.ndarray  # E, shape (6, 6)
    a: np.ndarray  # A~_i, shape (h, 6, 6)
    b: np.ndarray  # B~_i, shape (h, 6, 2)
    bd: np.ndarray  # Bd~, with Bd of eq. (31), shape (6, 1)
    bf: np.ndarray  # Bf~, shape (6, 2); the paper prints [0; I_n], its identity has the size of f
    c: np.ndarray  # C~ = [C Df] of eqs. (29), (30), shape (4, 6)


def paper_descriptor(arm: ArmParameters, box: np.ndarray, number: NumberType = float) -> Descriptor:
    """`Descriptor` at the vertices of the paper's box, in floats or in exact fractions."""
    array = array_of(number)
    a_i, b_i = vertex_matrices(array(box), arm.numbers(number))
    a, b = np.zeros((len(a_i), 6, 6), a_i.dtype), np.zeros((len(b_i), 6, 2), b_i.dtype)
    a[:, :4, :4], a[:, 4:, 4:], b[:, :4] = a_i, -np.eye(2, dtype=int), b_i
    e, bf = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0]), np.eye(6)[:, 4:]
    bd = np.array([0.0, 0.0, *arm.disturbance_direction, 0.0, 0.0])[:, None]
    c = np.eye(4)[:, [0, 1, 2, 3, 0, 1]]
    c[:2, :2] = c[2:, 2:4] = JointMap(arm).sensor_matrix
    return Descriptor(array(e), a, b, array(bd), array(bf), array(c))
