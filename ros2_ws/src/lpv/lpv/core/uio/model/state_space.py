"""The paper's descriptor form of its LPV plant, eqs. (26), (35)-(37)."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lpv.core.support.inequalities import array_of
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import vertex_matrices


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


def paper_descriptor(
    arm: ArmParameters, box: np.ndarray, number: Callable[[Any], Any] = float
) -> Descriptor:
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
