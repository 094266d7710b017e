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
    PLACE,
    Chain,
    FloatArray,
)
from lpv.core.serial_arm.dynamics.frames import (
    Triple,
    Wrench,
    along_axis,
    cross,
    plus,
    read,
    set_frames,
    to_child,
    to_parent,
    wrench_to_parent,
    write,
)
from lpv.core.serial_arm.dynamics.newton_euler import first_moment, inverse_dynamics, turning
from lpv.core.support.jit import njit_in_place as njit

RATE, SPEED, FALL, _COMPOSITE = 9, 12, 15, 9
"""Columns of `workspace` that are used here, behind the orientations."""
Carried = tuple[Wrench, Triple, float]
"""Of what a joint carries, about the origin of its frame: linear and angular momentum, first
moment, mass."""


@njit
def set_velocities(chain: Chain, q: FloatArray, v: FloatArray, work: FloatArray) -> None:
    """Write rotations and, in each joint frame, rates, speed of the origin and free fall."""
    set_frames(chain, q, work)
    w, u = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    g = (chain.gravity[0], chain.gravity[1], chain.gravity[2])
    for i in range(q.shape[0]):
        u = to_child(work, i, plus(u, cross(w, read(work, i, PLACE))))
        w, g = to_child(work, i, w), to_child(work, i, g)
        if not chain.prismatic[i]:
            w = (w[0], w[1], w[2] + v[i])
        else:
            u = (u[0], u[1], u[2] + v[i])
        write(work, i, RATE, w)
        write(work, i, SPEED, u)
        write(work, i, FALL, g)


@njit
def _body_momentum(body: FloatArray, work: FloatArray, i: int) -> Carried:
    """A body that moves as frame i does, where `set_velocities` has been called."""
    w, u, h = read(work, i, RATE), read(work, i, SPEED), first_moment(body)
    linear = plus(cross(w, h), u, body[MASS])
    return (linear, plus(turning(body, w), cross(h, u))), h, body[MASS]


@njit
def _joint_balance(chain: Chain, i: int, carried: Carried, work: FloatArray) -> tuple[float, float]:
    """Momentum of a joint without its rotor, and the force that changes it.

    With L, P angular and linear momentum of all that joint i carries, about its origin, and w, u
    the rates there, d(v^T M v / 2)/dq_i = w_y L_x - w_x L_y + u_y P_x - u_x P_y; of a prismatic
    joint w_y P_x - w_x P_y.
    """
    (linear, angular), h, mass = carried
    w, u, g = read(work, i, RATE), read(work, i, SPEED), read(work, i, FALL)
    if chain.prismatic[i]:
        return linear[2], w[1] * linear[0] - w[0] * linear[1] + mass * g[2]
    moved = w[1] * angular[0] - w[0] * angular[1] + u[1] * linear[0] - u[0] * linear[1]
    return angular[2], moved + h[0] * g[1] - h[1] * g[0]


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

    Both have shape (n,): p [N m s] or [N s], C^T v - g [N m] or [N]; p' = force + tau - friction.
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
    zero = (0.0, 0.0, 0.0)
    carried = (zero, zero), zero, 0.0
    for i in range(v.shape[0] - 1, -1, -1):
        (linear, angular), h, mass = _body_momentum(inertial[i], work, i)
        before, moment, weight = carried
        wrench = plus(linear, before[0]), plus(angular, before[1])
        carried = wrench, plus(h, moment), mass + weight
        momentum[i], force[i] = _joint_balance(chain, i, carried, work)
        for j in range(v.shape[0]):
            momentum[i] += motor[i, j] * v[j]
        if i > 0:
            wrench, moment, weight = carried
            moment = plus(to_parent(work, i, moment), read(work, i, PLACE), weight)
            carried = wrench_to_parent(work, i, wrench), moment, weight


@njit
def mass_matrix(chain: Chain, q: FloatArray, work: FloatArray, matrix: FloatArray) -> None:
    """M(q) by composite rigid bodies, rotors included, shape (n, n) [kg m2], [kg m], [kg]."""
    n = q.shape[0]
    set_frames(chain, q, work)
    for i in range(n):
        for k in range(10):
            work[i, _COMPOSITE + k] = chain.inertial[i, k]
    for i in range(n - 1, -1, -1):
        body = work[i, _COMPOSITE : _COMPOSITE + 10]
        wrench = (-body[MY], body[MX], 0.0), (body[IXZ], body[IYZ], body[IZZ])
        if chain.prismatic[i]:
            wrench = (0.0, 0.0, body[MASS]), (body[MY], -body[MX], 0.0)
        for j in range(i, -1, -1):
            matrix[i, j] = matrix[j, i] = along_axis(chain, j, wrench) + chain.motor[i, j]
            if j > 0:
                wrench = wrench_to_parent(work, j, wrench)
        if i > 0:
            _add_composite_to_parent(i, work)


@njit
def _add_composite_to_parent(i: int, work: FloatArray) -> None:
    """Add the composite inertia that joint i carries to that of joint i-1 (see `moved_body`)."""
    body, into = work[i, _COMPOSITE : _COMPOSITE + 10], work[i - 1, _COMPOSITE : _COMPOSITE + 10]
    h, p, mass = to_parent(work, i, first_moment(body)), read(work, i, PLACE), body[MASS]
    # Columns of R I, then rows of (R I) R^T.
    a = to_parent(work, i, (body[IXX], body[IXY], body[IXZ]))
    b = to_parent(work, i, (body[IXY], body[IYY], body[IYZ]))
    c = to_parent(work, i, (body[IXZ], body[IYZ], body[IZZ]))
    xx, xy, xz = to_parent(work, i, (a[0], b[0], c[0]))
    _, yy, yz = to_parent(work, i, (a[1], b[1], c[1]))
    _, _, zz = to_parent(work, i, (a[2], b[2], c[2]))
    # h p^T + p h^T + m p p^T = s p^T + p s^T with s half way from h to h + m p.
    moved, middle = plus(h, p, mass), plus(h, p, 0.5 * mass)
    x, y, z = p[0] * middle[0], p[1] * middle[1], p[2] * middle[2]
    into[MASS] += mass
    for k in range(3):
        into[MX + k] += moved[k]
    into[IXX] += xx + 2.0 * (y + z)
    into[IXY] += xy - middle[0] * p[1] - middle[1] * p[0]
    into[IYY] += yy + 2.0 * (x + z)
    into[IXZ] += xz - middle[0] * p[2] - middle[2] * p[0]
    into[IYZ] += yz - middle[1] * p[2] - middle[2] * p[1]
    into[IZZ] += zz + 2.0 * (x + y)


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
    """Accelerations that torques less friction [N m] cause, M(q) q'' = tau - C v - g, shape (n,).

    ``matrix``, shape (n, n), is scratch.  False if M(q) is not positive definite: the parameters
    are not those of a physical arm.
    """
    still = matrix[0]
    still[:] = 0.0
    inverse_dynamics(chain, q, v, still, work, acceleration)
    for i in range(q.shape[0]):
        acceleration[i] = torque[i] - acceleration[i]
    mass_matrix(chain, q, work, matrix)
    return solve_positive(matrix, acceleration)
