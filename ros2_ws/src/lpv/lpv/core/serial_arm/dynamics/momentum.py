"""Generalised momentum and its balance, mass matrix, forward dynamics.

p = M(q) v changes by p' = tau - F(v) + C(q, v)^T v - g(q): no acceleration is needed to test it.
"""

import math

from lpv.core.serial_arm.chain import (
    IXX,
    IXY,
    IXZ,
    IYY,
    IYZ,
    IZZ,
    MASS,
    MX,
    MY,
    MZ,
    PLACE,
    Chain,
    FloatArray,
)
from lpv.core.serial_arm.dynamics.frames import (
    add_wrench_to_parent,
    along_axis,
    set_frames,
    to_child,
    to_parent,
)
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit_in_place as njit

_LINEAR, _ANGULAR, _RATE, _SPEED, _FALL, _MOMENT, _WEIGHT = 9, 12, 15, 18, 21, 24, 27  # columns
_COMPOSITE = 9
"""Columns of `workspace` that are used here, behind the orientations."""


@njit
def _set_body_momentum(body: FloatArray, i: int, work: FloatArray) -> None:
    """Write linear and angular momentum of body i, and its first moment, about its origin."""
    wx, wy, wz = work[i, _RATE], work[i, _RATE + 1], work[i, _RATE + 2]
    ux, uy, uz = work[i, _SPEED], work[i, _SPEED + 1], work[i, _SPEED + 2]
    hx, hy, hz = body[MX], body[MY], body[MZ]
    work[i, _LINEAR] = body[MASS] * ux + wy * hz - wz * hy
    work[i, _LINEAR + 1] = body[MASS] * uy + wz * hx - wx * hz
    work[i, _LINEAR + 2] = body[MASS] * uz + wx * hy - wy * hx
    work[i, _ANGULAR] = body[IXX] * wx + body[IXY] * wy + body[IXZ] * wz + hy * uz - hz * uy
    work[i, _ANGULAR + 1] = body[IXY] * wx + body[IYY] * wy + body[IYZ] * wz + hz * ux - hx * uz
    work[i, _ANGULAR + 2] = body[IXZ] * wx + body[IYZ] * wy + body[IZZ] * wz + hx * uy - hy * ux
    work[i, _MOMENT] = hx
    work[i, _MOMENT + 1] = hy
    work[i, _MOMENT + 2] = hz
    work[i, _WEIGHT] = body[MASS]


@njit
def set_velocities(chain: Chain, q: FloatArray, v: FloatArray, work: FloatArray) -> None:
    """Write rotations and, in each joint frame, rates, speed of the origin and free fall.

    Parameters
    ----------
    chain : Chain
        The arm.
    q, v : ndarray, shape (n,)
        Positions and rates [rad], [rad/s]; of prismatic joints [m], [m/s].
    work : ndarray
        From `workspace`; columns 0 to 8, 15 to 23 and 40 to 42 are written.
    """
    set_frames(chain, q, work)
    wx, wy, wz, ux, uy, uz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gx, gy, gz = chain.gravity[0], chain.gravity[1], chain.gravity[2]
    for i in range(q.shape[0]):
        px, py, pz = work[i, PLACE], work[i, PLACE + 1], work[i, PLACE + 2]
        ux, uy, uz = to_child(
            work, i, ux + wy * pz - wz * py, uy + wz * px - wx * pz, uz + wx * py - wy * px
        )
        wx, wy, wz = to_child(work, i, wx, wy, wz)
        gx, gy, gz = to_child(work, i, gx, gy, gz)
        if not chain.prismatic[i]:
            wz += v[i]
        else:
            uz += v[i]
        work[i, _RATE], work[i, _RATE + 1], work[i, _RATE + 2] = wx, wy, wz
        work[i, _SPEED], work[i, _SPEED + 1], work[i, _SPEED + 2] = ux, uy, uz
        work[i, _FALL], work[i, _FALL + 1], work[i, _FALL + 2] = gx, gy, gz


@njit
def momentum_balance(
    chain: Chain,
    q: FloatArray,
    v: FloatArray,
    work: FloatArray,
    momentum: FloatArray,
    force: FloatArray,
) -> None:
    """Momentum p = M(q) v and the force C(q, v)^T v - g(q) that changes it, in one pass.

    With L, P angular and linear momentum of all that joint i carries, about its origin, and w, u
    the rates there, d(v^T M v / 2)/dq_i = w_y L_x - w_x L_y + u_y P_x - u_x P_y; of a prismatic
    joint w_y P_x - w_x P_y.

    Parameters
    ----------
    chain : Chain
        The arm.
    q, v : ndarray, shape (n,)
        Positions and rates [rad], [rad/s]; of prismatic joints [m], [m/s].
    work : ndarray
        From `workspace`.
    momentum, force : ndarray, shape (n,)
        Written: p [N m s] or [N s], C^T v - g [N m] or [N]; p' = force + tau - friction.
    """
    set_velocities(chain, q, v, work)
    carried_momentum(chain, chain.inertial, chain.motor, v, work, momentum, force)


@njit
def carried_momentum(
    chain: Chain,
    inertial: FloatArray,
    motor: FloatArray,
    v: FloatArray,
    work: FloatArray,
    momentum: FloatArray,
    force: FloatArray,
) -> None:
    """As `momentum_balance`, of any bodies, where `set_velocities` has been called."""
    n = v.shape[0]
    for i in range(n):
        _set_body_momentum(inertial[i], i, work)
    for i in range(n - 1, -1, -1):
        hx, hy = work[i, _MOMENT], work[i, _MOMENT + 1]
        momentum[i] = along_axis(chain, i, work[i, _LINEAR + 2], work[i, _ANGULAR + 2])
        for j in range(n):
            momentum[i] += motor[i, j] * v[j]
        if not chain.prismatic[i]:
            force[i] = (
                work[i, _RATE + 1] * work[i, _ANGULAR]
                - work[i, _RATE] * work[i, _ANGULAR + 1]
                + work[i, _SPEED + 1] * work[i, _LINEAR]
                - work[i, _SPEED] * work[i, _LINEAR + 1]
                + hx * work[i, _FALL + 1]
                - hy * work[i, _FALL]
            )
        else:
            force[i] = (
                work[i, _RATE + 1] * work[i, _LINEAR]
                - work[i, _RATE] * work[i, _LINEAR + 1]
                + work[i, _WEIGHT] * work[i, _FALL + 2]
            )
        if i > 0:
            add_wrench_to_parent(i, work, _LINEAR, _ANGULAR)
            _add_moment_to_parent(i, work)


@njit
def _add_moment_to_parent(i: int, work: FloatArray) -> None:
    """Add mass and first moment of what joint i carries to that of joint i-1."""
    hx, hy, hz = to_parent(work, i, work[i, _MOMENT], work[i, _MOMENT + 1], work[i, _MOMENT + 2])
    mass = work[i, _WEIGHT]
    work[i - 1, _MOMENT] += hx + mass * work[i, PLACE]
    work[i - 1, _MOMENT + 1] += hy + mass * work[i, PLACE + 1]
    work[i - 1, _MOMENT + 2] += hz + mass * work[i, PLACE + 2]
    work[i - 1, _WEIGHT] += mass


@njit
def mass_matrix(chain: Chain, q: FloatArray, work: FloatArray, matrix: FloatArray) -> None:
    """M(q) by composite rigid bodies, rotors included.

    Parameters
    ----------
    chain : Chain
        The arm.
    q : ndarray, shape (n,)
        Positions [rad].
    work : ndarray
        From `workspace`.
    matrix : ndarray, shape (n, n)
        Written [kg m2], [kg m], [kg].
    """
    n = q.shape[0]
    set_frames(chain, q, work)
    for i in range(n):
        for k in range(10):
            work[i, _COMPOSITE + k] = chain.inertial[i, k]
    for i in range(n - 1, -1, -1):
        body = work[i, _COMPOSITE : _COMPOSITE + 10]
        fx, fy, fz = -body[MY], body[MX], 0.0
        nx, ny, nz = body[IXZ], body[IYZ], body[IZZ]
        if chain.prismatic[i]:
            fx, fy, fz = 0.0, 0.0, body[MASS]
            nx, ny, nz = body[MY], -body[MX], 0.0
        matrix[i, i] = along_axis(chain, i, fz, nz) + chain.motor[i, i]
        for j in range(i - 1, -1, -1):
            fx, fy, fz = to_parent(work, j + 1, fx, fy, fz)
            nx, ny, nz = to_parent(work, j + 1, nx, ny, nz)
            p = work[j + 1, PLACE : PLACE + 3]
            nx, ny, nz = (
                nx + p[1] * fz - p[2] * fy,
                ny + p[2] * fx - p[0] * fz,
                nz + p[0] * fy - p[1] * fx,
            )
            matrix[i, j] = along_axis(chain, j, fz, nz) + chain.motor[i, j]
            matrix[j, i] = matrix[i, j]
        if i > 0:
            _add_composite_to_parent(i, work)


@njit
def _add_composite_to_parent(i: int, work: FloatArray) -> None:
    """Add the composite inertia that joint i carries to that of joint i-1 (see `moved_body`)."""
    body, into = work[i, _COMPOSITE : _COMPOSITE + 10], work[i - 1, _COMPOSITE : _COMPOSITE + 10]
    p, mass = work[i, PLACE : PLACE + 3], body[MASS]
    hx, hy, hz = to_parent(work, i, body[MX], body[MY], body[MZ])
    # Columns of R I, then rows of (R I) R^T.
    ax, ay, az = to_parent(work, i, body[IXX], body[IXY], body[IXZ])
    bx, by, bz = to_parent(work, i, body[IXY], body[IYY], body[IYZ])
    cx, cy, cz = to_parent(work, i, body[IXZ], body[IYZ], body[IZZ])
    xx, xy, xz = to_parent(work, i, ax, bx, cx)
    _, yy, yz = to_parent(work, i, ay, by, cy)
    _, _, zz = to_parent(work, i, az, bz, cz)
    diagonal = 2.0 * (p[0] * hx + p[1] * hy + p[2] * hz) + mass * (
        p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    )
    into[MASS] += mass
    into[MX] += hx + mass * p[0]
    into[MY] += hy + mass * p[1]
    into[MZ] += hz + mass * p[2]
    into[IXX] += xx + diagonal - 2.0 * hx * p[0] - mass * p[0] * p[0]
    into[IXY] += xy - hx * p[1] - hy * p[0] - mass * p[0] * p[1]
    into[IYY] += yy + diagonal - 2.0 * hy * p[1] - mass * p[1] * p[1]
    into[IXZ] += xz - hx * p[2] - hz * p[0] - mass * p[0] * p[2]
    into[IYZ] += yz - hy * p[2] - hz * p[1] - mass * p[1] * p[2]
    into[IZZ] += zz + diagonal - 2.0 * hz * p[2] - mass * p[2] * p[2]


@njit
def solve_positive(matrix: FloatArray, right: FloatArray) -> bool:
    """Solve A x = b in place by Cholesky's factorisation.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        A, symmetric; its lower triangle is overwritten by the factor.
    right : ndarray, shape (n,)
        b, overwritten by x.

    Returns
    -------
    bool
        False if A is not positive definite; ``right`` is then meaningless.
    """
    n = right.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total / matrix[j, j]
            elif total <= 0.0 or not math.isfinite(total):
                return False
            else:
                matrix[i, i] = math.sqrt(total)
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True


@njit
def forward_dynamics(
    chain: Chain,
    q: FloatArray,
    v: FloatArray,
    torque: FloatArray,
    work: FloatArray,
    matrix: FloatArray,
    acceleration: FloatArray,
) -> bool:
    """Accelerations that torques cause, M(q) q'' = tau - C v - g.

    Parameters
    ----------
    chain : Chain
        The arm.
    q, v, torque : ndarray, shape (n,)
        Positions, rates, torques less friction [rad], [rad/s], [N m].
    work : ndarray
        From `workspace`.
    matrix : ndarray, shape (n, n)
        Scratch.
    acceleration : ndarray, shape (n,)
        Written [rad/s2].

    Returns
    -------
    bool
        False if M(q) is not positive definite: the parameters are not those of a physical arm.
    """
    still = matrix[0]
    still[:] = 0.0
    inverse_dynamics(chain, q, v, still, work, acceleration)
    for i in range(q.shape[0]):
        acceleration[i] = torque[i] - acceleration[i]
    mass_matrix(chain, q, work, matrix)
    return solve_positive(matrix, acceleration)
