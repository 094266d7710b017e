"""The paper's LPV plant, eqs. (21), (25), (26), (29)-(31), and its descriptor form, (35)-(37)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lpv.core.support.inequalities import array_of
from lpv.core.support.jit import njit
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_scheduling, paper_weights, vertex_matrices


def output_matrices(arm: ArmParameters) -> tuple[np.ndarray, ...]:
    """C, shape (4, 4), and Df, shape (4, 2), of eqs. (29), (30) for the arm's sensors.

    Outputs are the two physical position sensors and the matching rates,
    y = [S theta + f; S theta'].  For sensors of absolute angles S = I and these are the paper's.
    """
    c = np.zeros((4, 4))
    c[:2, :2] = c[2:, 2:] = JointMap(arm).sensor_matrix
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
        self.e = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
        self.a = np.zeros((h, 6, 6), a.dtype)
        self.a[:, :4, :4] = a
        self.a[:, 4:, 4:] = -np.eye(2, dtype=int)
        self.b = np.zeros((h, 6, 2), b.dtype)
        self.b[:, :4] = b
        self.bd = np.vstack([disturbance_matrix(arm), np.zeros((2, 1))])
        self.bf = np.vstack([np.zeros((4, 2)), np.eye(2)])
        self.c = np.hstack(output_matrices(arm))


def paper_descriptor(
    arm: ArmParameters, box: np.ndarray, number: Callable[[Any], Any] = float
) -> Descriptor:
    """`Descriptor` at the vertices of the paper's box, in floats or in exact fractions."""
    array = array_of(number)
    descriptor = Descriptor(*vertex_matrices(array(box), arm.numbers(number)), arm)
    for name in ('e', 'bd', 'bf', 'c'):
        setattr(descriptor, name, array(getattr(descriptor, name)))
    return descriptor


@njit
def lpv_acceleration(
    x: np.ndarray, torque: np.ndarray, vertices: tuple[np.ndarray, ...], out: np.ndarray
) -> None:
    """theta'' of the paper's own LPV plant, eq. (25) without disturbance.

    Parameters
    ----------
    x : ndarray, shape (4,)
        State, eq. (21) [rad], [rad/s].
    torque : ndarray, shape (2,)
        Input u [N m], absolute coordinates.
    vertices : tuple of ndarray
        A_i and B_i of `vertex_matrices`, and the box, to which phi is clipped.
    out : ndarray, shape (2,)
        Receives theta'' [rad/s2]; the upper rows of (25) are theta' itself.
    """
    a, b, box = vertices
    rho = np.empty(8)
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, box, rho)
    for k in range(2):
        total = 0.0
        for i in range(8):
            row, inputs = a[i, 2 + k], b[i, 2 + k]
            driven = row[0] * x[0] + row[1] * x[1] + inputs[0] * torque[0] + inputs[1] * torque[1]
            total += rho[i] * driven
        out[k] = total
