"""Vectors between neighbouring joint frames; the workspace's first nine columns hold R_i(q_i)."""

import math

from lpv_core.serial_arm.chain import Chain, FloatArray
from lpv_core.support.jit import njit_in_place as njit


@njit
def set_rotations(chain: Chain, q: FloatArray, work: FloatArray) -> None:
    """Write the rotation from frame i to frame i-1, R_i = R_i0 Rz(q_i), row by row.

    Parameters
    ----------
    chain : Chain
        The arm.
    q : ndarray, shape (n,)
        Joint positions [rad].
    work : ndarray, shape (n, WORK_COLUMNS)
        Columns 0 to 8 are written.
    """
    for i in range(q.shape[0]):
        c, s = math.cos(q[i]), math.sin(q[i])
        for row in range(3):
            x, y = chain.rotation[i, row, 0], chain.rotation[i, row, 1]
            work[i, 3 * row] = c * x + s * y
            work[i, 3 * row + 1] = c * y - s * x
            work[i, 3 * row + 2] = chain.rotation[i, row, 2]


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
def add_wrench_to_parent(chain: Chain, i: int, work: FloatArray, force: int, moment: int) -> None:
    """Add the wrench of body i, about its own origin, to that of body i-1.

    Parameters
    ----------
    chain : Chain
        The arm.
    i : int
        The body, at least 1.
    work : ndarray, shape (n, WORK_COLUMNS)
        Holds rotations and wrenches.
    force, moment : int
        First columns of the two vectors.
    """
    fx, fy, fz = to_parent(work, i, work[i, force], work[i, force + 1], work[i, force + 2])
    nx, ny, nz = to_parent(work, i, work[i, moment], work[i, moment + 1], work[i, moment + 2])
    px, py, pz = chain.translation[i, 0], chain.translation[i, 1], chain.translation[i, 2]
    work[i - 1, force] += fx
    work[i - 1, force + 1] += fy
    work[i - 1, force + 2] += fz
    work[i - 1, moment] += nx + py * fz - pz * fy
    work[i - 1, moment + 1] += ny + pz * fx - px * fz
    work[i - 1, moment + 2] += nz + px * fy - py * fx
