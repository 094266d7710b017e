"""K(q) = dg/dq: how much a wrong position changes the torque of gravity."""

from lpv.core.serial_arm.chain import MASS, MX, PLACE, Chain, FloatArray
from lpv.core.serial_arm.dynamics.frames import set_frames
from lpv.core.support.jit import njit_in_place as njit

_AXIS, _ORIGIN, _MOMENT, _WEIGHT, _TURN = 9, 12, 15, 18, 19
"""Columns of `workspace` that are used here, behind the orientations."""


@njit
def _set_axes(chain: Chain, q: FloatArray, work: FloatArray) -> None:
    """Write each joint's axis and origin in the base frame, and its orientation there."""
    set_frames(chain, q, work)
    for i in range(q.shape[0]):
        for row in range(3):
            for column in range(3):
                if i == 0:
                    work[0, _TURN + 3 * row + column] = work[0, 3 * row + column]
                else:
                    total = 0.0
                    for k in range(3):
                        total += work[i - 1, _TURN + 3 * row + k] * work[i, 3 * k + column]
                    work[i, _TURN + 3 * row + column] = total
            origin = work[0, PLACE + row]
            if i > 0:
                origin = work[i - 1, _ORIGIN + row]
                for k in range(3):
                    origin += work[i - 1, _TURN + 3 * row + k] * work[i, PLACE + k]
            work[i, _ORIGIN + row] = origin
            work[i, _AXIS + row] = work[i, _TURN + 3 * row + 2]


@njit
def gravity_gradient(chain: Chain, q: FloatArray, work: FloatArray, gradient: FloatArray) -> None:
    """Second derivative of the potential energy.

    For i <= j, K_ij = -(g x z_i) . (z_j x h_j): z axes, h_j the first moment of all that joint j
    carries about its origin, g free fall, all in the base frame.  Where joint j is prismatic, its
    mass times z_j is in place of z_j x h_j; where joint i is, K_ij = 0.

    Parameters
    ----------
    chain : Chain
        The arm.
    q : ndarray, shape (n,)
        Positions [rad].
    work : ndarray
        From `workspace`.
    gradient : ndarray, shape (n, n)
        Written, symmetric [N m/rad], [N m/m], [N/m].
    """
    n = q.shape[0]
    _set_axes(chain, q, work)
    gx, gy, gz = chain.gravity[0], chain.gravity[1], chain.gravity[2]
    for j in range(n - 1, -1, -1):
        for row in range(3):
            moment = 0.0
            for k in range(3):
                moment += work[j, _TURN + 3 * row + k] * chain.inertial[j, MX + k]
            if j + 1 < n:
                arm = work[j + 1, _ORIGIN + row] - work[j, _ORIGIN + row]
                moment += work[j + 1, _MOMENT + row] + work[j + 1, _WEIGHT] * arm
            work[j, _MOMENT + row] = moment
        work[j, _WEIGHT] = chain.inertial[j, MASS] + (work[j + 1, _WEIGHT] if j + 1 < n else 0.0)
        zx, zy, zz = work[j, _AXIS], work[j, _AXIS + 1], work[j, _AXIS + 2]
        hx, hy, hz = work[j, _MOMENT], work[j, _MOMENT + 1], work[j, _MOMENT + 2]
        cx, cy, cz = zy * hz - zz * hy, zz * hx - zx * hz, zx * hy - zy * hx
        if chain.prismatic[j]:
            mass = work[j, _WEIGHT]
            cx, cy, cz = mass * zx, mass * zy, mass * zz
        for i in range(j + 1):
            ax, ay, az = work[i, _AXIS], work[i, _AXIS + 1], work[i, _AXIS + 2]
            gradient[i, j] = (
                0.0
                if chain.prismatic[i]
                else (
                    (gz * ay - gy * az) * cx + (gx * az - gz * ax) * cy + (gy * ax - gx * ay) * cz
                )
            )
            gradient[j, i] = gradient[i, j]
