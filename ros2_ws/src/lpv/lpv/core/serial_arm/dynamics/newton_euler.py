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
    add_wrench_to_parent,
    along_axis,
    set_frames,
    to_child,
)
from lpv.core.support.jit import njit_in_place as njit

_FORCE, _MOMENT = 9, 12
"""Columns of `workspace` that are used here, behind the orientations."""


@njit
def _body_wrench(
    chain: Chain,
    i: int,
    rate: tuple[float, float, float],
    spin: tuple[float, float, float],
    acceleration: tuple[float, float, float],
    work: FloatArray,
) -> None:
    """Write force and moment that move body i: Newton's and Euler's equations about its origin."""
    body = chain.inertial[i]
    wx, wy, wz = rate
    sx, sy, sz = spin
    ax, ay, az = acceleration
    hx, hy, hz = body[MX], body[MY], body[MZ]
    # w x h and I w: momenta of the body's own rotation.
    ux, uy, uz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
    lx = body[IXX] * wx + body[IXY] * wy + body[IXZ] * wz
    ly = body[IXY] * wx + body[IYY] * wy + body[IYZ] * wz
    lz = body[IXZ] * wx + body[IYZ] * wy + body[IZZ] * wz
    work[i, _FORCE] = body[MASS] * ax + sy * hz - sz * hy + wy * uz - wz * uy
    work[i, _FORCE + 1] = body[MASS] * ay + sz * hx - sx * hz + wz * ux - wx * uz
    work[i, _FORCE + 2] = body[MASS] * az + sx * hy - sy * hx + wx * uy - wy * ux
    work[i, _MOMENT] = (
        body[IXX] * sx + body[IXY] * sy + body[IXZ] * sz + wy * lz - wz * ly + hy * az - hz * ay
    )
    work[i, _MOMENT + 1] = (
        body[IXY] * sx + body[IYY] * sy + body[IYZ] * sz + wz * lx - wx * lz + hz * ax - hx * az
    )
    work[i, _MOMENT + 2] = (
        body[IXZ] * sx + body[IYZ] * sy + body[IZZ] * sz + wx * ly - wy * lx + hx * ay - hy * ax
    )


@njit
def inverse_dynamics(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray, torque: FloatArray
) -> None:
    """Torques that produce a motion.

    Parameters
    ----------
    chain : Chain
        The arm.
    q, v, a : ndarray, shape (n,)
        Positions, rates, accelerations [rad], [rad/s], [rad/s2]; of prismatic joints with m.
    work : ndarray
        From `workspace`.
    torque : ndarray, shape (n,)
        Written: tau without friction [N m], [N].
    """
    n = q.shape[0]
    set_frames(chain, q, work)
    wx, wy, wz, sx, sy, sz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # The base accelerates upwards instead of the bodies falling.
    ax, ay, az = -chain.gravity[0], -chain.gravity[1], -chain.gravity[2]
    for i in range(n):
        px, py, pz = work[i, PLACE], work[i, PLACE + 1], work[i, PLACE + 2]
        cx, cy, cz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
        ax, ay, az = to_child(
            work, i,
            ax + sy * pz - sz * py + wy * cz - wz * cy,
            ay + sz * px - sx * pz + wz * cx - wx * cz,
            az + sx * py - sy * px + wx * cy - wy * cx)  # fmt: skip
        wx, wy, wz = to_child(work, i, wx, wy, wz)
        sx, sy, sz = to_child(work, i, sx, sy, sz)
        if not chain.prismatic[i]:
            sx, sy, sz = sx + wy * v[i], sy - wx * v[i], sz + a[i]
            wz += v[i]
        else:
            ax, ay, az = ax + 2.0 * wy * v[i], ay - 2.0 * wx * v[i], az + a[i]
        _body_wrench(chain, i, (wx, wy, wz), (sx, sy, sz), (ax, ay, az), work)
    for i in range(n - 1, -1, -1):
        torque[i] = along_axis(chain, i, work[i, _FORCE + 2], work[i, _MOMENT + 2])
        for j in range(n):
            torque[i] += chain.motor[i, j] * a[j]
        if i > 0:
            add_wrench_to_parent(i, work, _FORCE, _MOMENT)
