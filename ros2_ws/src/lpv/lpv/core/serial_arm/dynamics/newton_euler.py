"""Inverse dynamics of a serial chain by the recursive Newton-Euler algorithm.

tau = M(q) q'' + C(q, q') q' + g(q), rotors included, friction not (see `friction`).
"""

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
    Triple,
    Wrench,
    along_axis,
    cross,
    plus,
    read,
    set_frames,
    to_child,
    wrench_to_parent,
    write,
)
from lpv.core.support.jit import njit_in_place as njit

RATE, SPIN, PUSH = 9, 12, 15
"""Columns of `workspace` that are used here, behind the orientations."""


@njit
def first_moment(body: FloatArray) -> Triple:
    """m c of a row of `Chain.inertial`."""
    return body[MX], body[MY], body[MZ]


@njit
def turning(body: FloatArray, rate: Triple) -> Triple:
    """Inertia of a row of `Chain.inertial` times a rate: the momentum of its own rotation."""
    x, y, z = rate
    return (
        body[IXX] * x + body[IXY] * y + body[IXZ] * z,
        body[IXY] * x + body[IYY] * y + body[IYZ] * z,
        body[IXZ] * x + body[IYZ] * y + body[IZZ] * z,
    )


@njit
def set_accelerations(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray
) -> None:
    """Write rates, angular and linear accelerations (less free fall) of each joint frame."""
    set_frames(chain, q, work)
    w, s = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    # The base accelerates upwards instead of the bodies falling.
    u = (-chain.gravity[0], -chain.gravity[1], -chain.gravity[2])
    for i in range(q.shape[0]):
        p = read(work, i, PLACE)
        u = to_child(work, i, plus(plus(u, cross(s, p)), cross(w, cross(w, p))))
        w, s = to_child(work, i, w), to_child(work, i, s)
        if not chain.prismatic[i]:
            s = (s[0] + w[1] * v[i], s[1] - w[0] * v[i], s[2] + a[i])
            w = (w[0], w[1], w[2] + v[i])
        else:
            u = (u[0] + 2.0 * w[1] * v[i], u[1] - 2.0 * w[0] * v[i], u[2] + a[i])
        write(work, i, RATE, w)
        write(work, i, SPIN, s)
        write(work, i, PUSH, u)


@njit
def _body_wrench(body: FloatArray, work: FloatArray, i: int) -> Wrench:
    """Newton's and Euler's equations of a body about the origin of frame i, as it moves there."""
    w, s, u, h = read(work, i, RATE), read(work, i, SPIN), read(work, i, PUSH), first_moment(body)
    force = plus(plus(cross(s, h), cross(w, cross(w, h))), u, body[MASS])
    own = plus(turning(body, s), cross(w, turning(body, w)))
    return force, plus(own, cross(h, u))


@njit
def inverse_dynamics(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray, torque: FloatArray
) -> None:
    """Torques that produce a motion, without friction, shape (n,) [N m], [N]."""
    set_accelerations(chain, q, v, a, work)
    wrench = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(q.shape[0] - 1, -1, -1):
        force, moment = _body_wrench(chain.inertial[i], work, i)
        wrench = plus(force, wrench[0]), plus(moment, wrench[1])
        torque[i] = along_axis(chain, i, wrench)
        for j in range(q.shape[0]):
            torque[i] += chain.motor[i, j] * a[j]
        if i > 0:
            wrench = wrench_to_parent(work, i, wrench)
