"""Dynamics as linear functions of the inertial parameters.

tau = Y(q, v, a) phi, p = Y_p(q, v) phi and C^T v - g = Y_f(q, v) phi, with phi = `Chain.inertial`
row by row.  Rotors and friction, which are linear too, are not part of phi, and the inertial
parameters of the arm do not matter.

What link j adds to joint i is the power of its wrench, or momentum, along the axis of that joint:
with the twist (u, w) of frame j as joint i alone moves it at unit rate, u . force + w . moment.
"""

from lpv.core.serial_arm.chain import IXX, MASS, MX, PLACE, Chain, FloatArray
from lpv.core.serial_arm.dynamics.frames import Triple, Wrench, cross, plus, read, to_child
from lpv.core.serial_arm.dynamics.momentum import FALL, RATE, SPEED, set_velocities
from lpv.core.serial_arm.dynamics.newton_euler import PUSH, SPIN, set_accelerations
from lpv.core.support.jit import njit_in_place as njit

_ZERO, _AXIS = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
"""No vector; the axis of a joint in its own frame."""


@njit
def _twist_in_child(work: FloatArray, j: int, twist: Wrench) -> Wrench:
    """Twist of frame j from that of the frame before, whose joint it turns and shifts alike."""
    linear, angular = twist
    linear = plus(linear, cross(angular, read(work, j, PLACE)))
    return to_child(work, j, linear), to_child(work, j, angular)


@njit
def _add_linear(row: FloatArray, first: int, mass: float, moment: Triple) -> None:
    """Add coefficients of a link's mass and first moment, whose columns begin at ``first``."""
    row[first + MASS] += mass
    for k in range(3):
        row[first + MX + k] += moment[k]


@njit
def _add_products(row: FloatArray, first: int, a: Triple, b: Triple) -> None:
    """Add coefficients of a link's inertia I in a . I b."""
    column = first + IXX
    row[column] += a[0] * b[0]
    row[column + 1] += a[0] * b[1] + a[1] * b[0]
    row[column + 2] += a[1] * b[1]
    row[column + 3] += a[0] * b[2] + a[2] * b[0]
    row[column + 4] += a[1] * b[2] + a[2] * b[1]
    row[column + 5] += a[2] * b[2]


@njit
def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def regressor(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray, matrix: FloatArray
) -> None:
    """Y(q, v, a) of tau = Y phi, shape (n, 10 n); neither rotors nor friction."""
    set_accelerations(chain, q, v, a, work)
    matrix[:, :] = 0.0
    for i in range(q.shape[0]):
        twist = (_AXIS, _ZERO) if chain.prismatic[i] else (_ZERO, _AXIS)
        for j in range(i, q.shape[0]):
            if j > i:
                twist = _twist_in_child(work, j, twist)
            (u, w), row, first = twist, matrix[i], 10 * j
            rate, spin, push = read(work, j, RATE), read(work, j, SPIN), read(work, j, PUSH)
            # Of h in u . (s x h + r x (r x h)) + w . (h x a).
            swirl = plus(cross(rate, cross(rate, u)), cross(push, w))
            _add_linear(row, first, _dot(u, push), plus(swirl, cross(u, spin)))
            _add_products(row, first, w, spin)
            _add_products(row, first, cross(w, rate), rate)


@njit
def _add_momentum(row: FloatArray, j: int, twist: Wrench, work: FloatArray) -> None:
    """Add coefficients of the momentum of link j along a twist."""
    (u, w), rate, speed = twist, read(work, j, RATE), read(work, j, SPEED)
    _add_linear(row, 10 * j, _dot(u, speed), plus(cross(u, rate), cross(speed, w)))
    _add_products(row, 10 * j, w, rate)


@njit
def momentum_regressor(
    chain: Chain,
    q: FloatArray,
    v: FloatArray,
    work: FloatArray,
    momentum: FloatArray,
    force: FloatArray,
) -> None:
    """Y_p and Y_f of p = Y_p phi and C^T v - g = Y_f phi, shape (n, 10 n).

    The force is the momentum along the rate of the twist (see `momentum_balance`), and weight.
    """
    set_velocities(chain, q, v, work)
    momentum[:, :] = 0.0
    force[:, :] = 0.0
    for i in range(q.shape[0]):
        turn, shift = cross(read(work, i, RATE), _AXIS), cross(read(work, i, SPEED), _AXIS)
        twist, change = (_ZERO, _AXIS), (shift, turn)
        if chain.prismatic[i]:
            twist, change = (_AXIS, _ZERO), (turn, _ZERO)
        for j in range(i, q.shape[0]):
            if j > i:
                twist, change = _twist_in_child(work, j, twist), _twist_in_child(work, j, change)
            fall = read(work, j, FALL)
            _add_momentum(momentum[i], j, twist, work)
            _add_momentum(force[i], j, change, work)
            _add_linear(force[i], 10 * j, _dot(twist[0], fall), cross(fall, twist[1]))
