"""Vectors of joint frames as triples, and how they pass from one frame to its neighbours.

Here and in the modules beside, compiled functions take the arm, a `Chain`; positions q, rates v and
accelerations a of its joints, shape (n,), in rad and s, of prismatic ones in m and s; and ``work``
from `workspace`.  What they write comes last.  Row i of ``work`` belongs to frame i: its first nine
columns hold R_i(q_i), the last three the origin of the frame in the one before.
"""

import math

from lpv.core.serial_arm.chain import PLACE, Chain, FloatArray
from lpv.core.support.jit import njit_in_place as njit

Triple = tuple[float, float, float]
Wrench = tuple[Triple, Triple]
"""Force and moment, or linear and angular momentum, about the origin of a frame."""


@njit
def cross(a: Triple, b: Triple) -> Triple:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def plus(a: Triple, b: Triple, factor: float = 1.0) -> Triple:
    """a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@njit
def read(work: FloatArray, i: int, first: int) -> Triple:
    """Vector of frame i in three columns of the workspace."""
    return work[i, first], work[i, first + 1], work[i, first + 2]


@njit
def write(work: FloatArray, i: int, first: int, vector: Triple) -> None:
    """Write a vector of frame i into three columns of the workspace."""
    work[i, first], work[i, first + 1], work[i, first + 2] = vector


@njit
def set_frames(chain: Chain, q: FloatArray, work: FloatArray) -> None:
    """Write the rotation from frame i to frame i-1 row by row, and the origin of frame i there.

    R_i = R_i0 Rz(q_i) of a revolute joint; a prismatic one shifts the origin along its axis.
    """
    for i in range(q.shape[0]):
        turned, way = (0.0, q[i]) if chain.prismatic[i] else (q[i], 0.0)
        c, s = math.cos(turned), math.sin(turned)
        for row in range(3):
            x, y, z = read(chain.rotation[i], row, 0)
            write(work, i, 3 * row, (c * x + s * y, c * y - s * x, z))
            work[i, PLACE + row] = chain.translation[i, row] + way * z


@njit
def to_parent(work: FloatArray, i: int, vector: Triple) -> Triple:
    """Coordinates in frame i-1 of a vector given in frame i."""
    x, y, z = vector
    return (
        work[i, 0] * x + work[i, 1] * y + work[i, 2] * z,
        work[i, 3] * x + work[i, 4] * y + work[i, 5] * z,
        work[i, 6] * x + work[i, 7] * y + work[i, 8] * z,
    )


@njit
def to_child(work: FloatArray, i: int, vector: Triple) -> Triple:
    """Coordinates in frame i of a vector given in frame i-1."""
    x, y, z = vector
    return (
        work[i, 0] * x + work[i, 3] * y + work[i, 6] * z,
        work[i, 1] * x + work[i, 4] * y + work[i, 7] * z,
        work[i, 2] * x + work[i, 5] * y + work[i, 8] * z,
    )


@njit
def along_axis(chain: Chain, i: int, wrench: Wrench) -> float:
    """What a wrench in frame i is for joint i: its torque, or force."""
    return wrench[0][2] if chain.prismatic[i] else wrench[1][2]


@njit
def wrench_to_parent(work: FloatArray, i: int, wrench: Wrench) -> Wrench:
    """A wrench about the origin of frame i, about that of frame i-1."""
    force, moment = to_parent(work, i, wrench[0]), to_parent(work, i, wrench[1])
    return force, plus(moment, cross(read(work, i, PLACE), force))
