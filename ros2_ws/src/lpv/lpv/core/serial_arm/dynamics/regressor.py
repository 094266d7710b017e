"""Dynamics as linear functions of the inertial parameters.

tau = Y(q, v, a) phi, p = Y_p(q, v) phi and C^T v - g = Y_f(q, v) phi, with phi = `Chain.inertial`
row by row.  Rotors and friction, which are linear too, are not part of phi.
"""

from lpv.core.serial_arm.chain import MX, PLACE, Chain, FloatArray
from lpv.core.serial_arm.dynamics.frames import along_axis, set_frames, to_child, to_parent
from lpv.core.serial_arm.dynamics.momentum import set_velocities
from lpv.core.support.jit import njit_in_place as njit

_RATE, _SPEED, _FALL = 15, 18, 21  # columns, as in `momentum`
_W, _S, _A = 9, 12, 15
"""Columns of `workspace` that are used here, behind the orientations."""


@njit
def _unit_inertia(k: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """E_k w for the k-th inertia (xx, xy, yy, xz, yz, zz)."""
    if k == 0:
        return x, 0.0, 0.0
    if k == 1:
        return y, x, 0.0
    if k == 2:
        return 0.0, y, 0.0
    if k == 3:
        return z, 0.0, x
    if k == 4:
        return 0.0, z, y
    return 0.0, 0.0, z


@njit
def _cross(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> tuple[float, float, float]:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def _unit(k: int) -> tuple[float, float, float]:
    """The k-th axis."""
    return (1.0 if k == 0 else 0.0), (1.0 if k == 1 else 0.0), (1.0 if k == 2 else 0.0)


@njit
def _unit_wrench(
    k: int,
    w: tuple[float, float, float],
    s: tuple[float, float, float],
    a: tuple[float, float, float],
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Force and moment per unit of a body's k-th parameter."""
    zero = (0.0, 0.0, 0.0)
    if k == 0:
        return a, zero
    if k < 4:
        h = _unit(k - MX)
        twist, swirl = _cross(s, h), _cross(w, _cross(w, h))
        force = (twist[0] + swirl[0], twist[1] + swirl[1], twist[2] + swirl[2])
        return force, _cross(h, a)
    spin = _unit_inertia(k - 4, s[0], s[1], s[2])
    gyro = _cross(w, _unit_inertia(k - 4, w[0], w[1], w[2]))
    return zero, (spin[0] + gyro[0], spin[1] + gyro[1], spin[2] + gyro[2])


@njit
def _wrench_to_parent(
    i: int, work: FloatArray, force: tuple[float, float, float], moment: tuple[float, float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """A wrench about frame i's origin, about that of frame i-1."""
    f = to_parent(work, i, force[0], force[1], force[2])
    m = to_parent(work, i, moment[0], moment[1], moment[2])
    p = (work[i, PLACE], work[i, PLACE + 1], work[i, PLACE + 2])
    lever = _cross(p, f)
    return f, (m[0] + lever[0], m[1] + lever[1], m[2] + lever[2])


@njit
def _set_accelerations(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray
) -> None:
    """Write rates, angular and linear accelerations (less free fall) of each joint frame."""
    set_frames(chain, q, work)
    w, s = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    u = (-chain.gravity[0], -chain.gravity[1], -chain.gravity[2])
    for i in range(q.shape[0]):
        p = (work[i, PLACE], work[i, PLACE + 1], work[i, PLACE + 2])
        twist, swirl = _cross(s, p), _cross(w, _cross(w, p))
        u = to_child(
            work, i, u[0] + twist[0] + swirl[0], u[1] + twist[1] + swirl[1],
            u[2] + twist[2] + swirl[2])  # fmt: skip
        w = to_child(work, i, w[0], w[1], w[2])
        s = to_child(work, i, s[0], s[1], s[2])
        if not chain.prismatic[i]:
            s = (s[0] + w[1] * v[i], s[1] - w[0] * v[i], s[2] + a[i])
            w = (w[0], w[1], w[2] + v[i])
        else:
            u = (u[0] + 2.0 * w[1] * v[i], u[1] - 2.0 * w[0] * v[i], u[2] + a[i])
        for k in range(3):
            work[i, _W + k], work[i, _S + k], work[i, _A + k] = w[k], s[k], u[k]


@njit
def regressor(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray, matrix: FloatArray
) -> None:
    """Y(q, v, a) of tau = Y phi; neither rotors nor friction.

    Parameters
    ----------
    chain : Chain
        The arm; its inertial parameters do not matter.
    q, v, a : ndarray, shape (n,)
        Positions, rates, accelerations [rad], [rad/s], [rad/s2].
    work : ndarray
        From `workspace`.
    matrix : ndarray, shape (n, 10 n)
        Written.
    """
    n = q.shape[0]
    _set_accelerations(chain, q, v, a, work)
    matrix[:, :] = 0.0
    for j in range(n):
        w = (work[j, _W], work[j, _W + 1], work[j, _W + 2])
        s = (work[j, _S], work[j, _S + 1], work[j, _S + 2])
        u = (work[j, _A], work[j, _A + 1], work[j, _A + 2])
        for k in range(10):
            force, moment = _unit_wrench(k, w, s, u)
            for i in range(j, -1, -1):
                matrix[i, 10 * j + k] = along_axis(chain, i, force[2], moment[2])
                if i > 0:
                    force, moment = _wrench_to_parent(i, work, force, moment)


@njit
def _unit_momentum(
    k: int, w: tuple[float, float, float], u: tuple[float, float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Linear and angular momentum per unit of a body's k-th parameter."""
    zero = (0.0, 0.0, 0.0)
    if k == 0:
        return u, zero
    if k < 4:
        h = _unit(k - MX)
        return _cross(w, h), _cross(h, u)
    return zero, _unit_inertia(k - 4, w[0], w[1], w[2])


@njit
def momentum_regressor(
    chain: Chain,
    q: FloatArray,
    v: FloatArray,
    work: FloatArray,
    momentum: FloatArray,
    force: FloatArray,
) -> None:
    """Y_p and Y_f of p = Y_p phi and C^T v - g = Y_f phi; see `momentum_balance`.

    Parameters
    ----------
    chain : Chain
        The arm; its inertial parameters do not matter.
    q, v : ndarray, shape (n,)
        Positions and rates [rad], [rad/s].
    work : ndarray
        From `workspace`.
    momentum, force : ndarray, shape (n, 10 n)
        Written.
    """
    n = q.shape[0]
    set_velocities(chain, q, v, work)
    momentum[:, :] = 0.0
    force[:, :] = 0.0
    for j in range(n):
        w = (work[j, _RATE], work[j, _RATE + 1], work[j, _RATE + 2])
        u = (work[j, _SPEED], work[j, _SPEED + 1], work[j, _SPEED + 2])
        for k in range(10):
            linear, angular = _unit_momentum(k, w, u)
            moment = _unit(k - MX) if 0 < k < 4 else (0.0, 0.0, 0.0)
            mass = 1.0 if k == 0 else 0.0
            for i in range(j, -1, -1):
                momentum[i, 10 * j + k] = along_axis(chain, i, linear[2], angular[2])
                if not chain.prismatic[i]:
                    force[i, 10 * j + k] = (
                        work[i, _RATE + 1] * angular[0]
                        - work[i, _RATE] * angular[1]
                        + work[i, _SPEED + 1] * linear[0]
                        - work[i, _SPEED] * linear[1]
                        + moment[0] * work[i, _FALL + 1]
                        - moment[1] * work[i, _FALL]
                    )
                else:
                    force[i, 10 * j + k] = (
                        work[i, _RATE + 1] * linear[0]
                        - work[i, _RATE] * linear[1]
                        + mass * work[i, _FALL + 2]
                    )
                if i > 0:
                    linear, angular = _wrench_to_parent(i, work, linear, angular)
                    h = to_parent(work, i, moment[0], moment[1], moment[2])
                    p = work[i, PLACE : PLACE + 3]
                    moment = (h[0] + mass * p[0], h[1] + mass * p[1], h[2] + mass * p[2])
