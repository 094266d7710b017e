"""Vectors between neighbouring joint frames; the workspace's first nine columns hold R_i(q_i),
the last three the origins of the frames."""

import math

from lpv.core.serial_arm.chain import PLACE, Chain, FloatArray
from lpv.core.support.jit import njit_in_place as njit


@njit
def set_frames(chain: Chain, q: FloatArray, work: FloatArray) -> None:
    """Write the rotation from frame i to frame i-1 row by row, and the origin of frame i there.

    R_i = R_i0 Rz(q_i) of a revolute joint; a prismatic one shifts the origin along its axis.

    Parameters
    ----------
    chain : Chain
        The arm.
    q : ndarray, shape (n,)
        Joint positions [rad], [m].
    work : ndarray, shape (n, WORK_COLUMNS)
        Columns 0 to 8 and the last three are written.
    """
    for i in range(q.shape[0]):
        turned, way = (0.0, q[i]) if chain.prismatic[i] else (q[i], 0.0)
        c, s = math.cos(turned), math.sin(turned)
        for row in range(3):
            x, y = chain.rotation[i, row, 0], chain.rotation[i, row, 1]
            work[i, 3 * row] = c * x + s * y
            work[i, 3 * row + 1] = c * y - s * x
            work[i, 3 * row + 2] = chain.rotation[i, row, 2]
            work[i, PLACE + row] = chain.translation[i, row] + way * chain.rotation[i, row, 2]


@njit
def to_parent(work: FloatArray, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Coordinates in frame i-1 of a vector given in frame i."""
    return (
        work[i, 0] * x + work[i, 1] * y + work[i, 2] * z,
        work[i, 3] * x + work[i, 4] * y + work[i, 5] * z,
        work[i, 6] * x + work[i, 7] * y + work[i, 8] * z,
    )


@njit
def to_child(work: FloatArray, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Coordinates in frame i of a vector given in frame i-1."""
    return (
        work[i, 0] * x + work[i, 3] * y + work[i, 6] * z,
        work[i, 1] * x + work[i, 4] * y + work[i, 7] * z,
        work[i, 2] * x + work[i, 5] * y + work[i, 8] * z,
    )


@njit
def along_axis(chain: Chain, i: int, force: float, moment: float) -> float:
    """What a wrench with these z components in frame i is for joint i: its torque, or force."""
    return force if chain.prismatic[i] else moment


@njit
def add_wrench_to_parent(i: int, work: FloatArray, force: int, moment: int) -> None:
    """Add the wrench of body i, about its own origin, to that of body i-1.

    Parameters
    ----------
    i : int
        The body, at least 1.
    work : ndarray, shape (n, WORK_COLUMNS)
        Holds frames and wrenches.
    force, moment : int
        First columns of the two vectors.
    """
    fx, fy, fz = to_parent(work, i, work[i, force], work[i, force + 1], work[i, force + 2])
    nx, ny, nz = to_parent(work, i, work[i, moment], work[i, moment + 1], work[i, moment + 2])
    px, py, pz = work[i, PLACE], work[i, PLACE + 1], work[i, PLACE + 2]
    work[i - 1, force] += fx
    work[i - 1, force + 1] += fy
    work[i - 1, force + 2] += fz
    work[i - 1, moment] += nx + py * fz - pz * fy
    work[i - 1, moment + 1] += ny + pz * fx - px * fz
    work[i - 1, moment + 2] += nz + px * fy - py * fx
