"""Joint friction: viscous, Coulomb (constant and growing with load), and a torque offset.

F_i(v) = viscous v + (coulomb + load abs(tau_i)) s(v) + offset, s(v) = (2/pi) atan(slope v), tau_i
the torque that the gear carries: what friction leaves of the drive's.
"""

import math

from lpv.core.serial_arm.chain import COULOMB, LOAD, OFFSET, SLOPE, VISCOUS, Chain, FloatArray
from lpv.core.support.inequalities import SAME
from lpv.core.support.jit import njit_in_place as njit


@njit
def smooth_sign(rate: float, slope: float) -> float:
    """Sign of a rate, (2/pi) atan(slope v), without its jump."""
    return math.atan(slope * rate) * (2.0 / math.pi)


@njit
def friction_torque(chain: Chain, v: FloatArray, load: FloatArray, torque: FloatArray) -> None:
    """Friction of every joint, shape (n,) [N m]; positive against positive rates.

    ``load``, shape (n,), has torques that the gears carry [N m]; their size counts.
    """
    for i in range(v.shape[0]):
        row = chain.friction[i]
        dry = row[COULOMB] + row[LOAD] * abs(load[i])
        sign = smooth_sign(v[i], row[SLOPE]) if dry != 0.0 else 0.0
        torque[i] = row[VISCOUS] * v[i] + dry * sign + row[OFFSET]


@njit
def acting_share(row: FloatArray, left: float, sign: float) -> float:
    """Share of a change of torque or friction that reaches the link; friction by load has the rest.

    ``left`` is a drive's torque less its friction without load, of which the gear carries the same
    share.  ``row`` is one of `Chain.friction`, ``sign`` the smoothed sign of the rate.
    """
    return 1.0 / max(1.0 + row[LOAD] * (sign if left > 0.0 else -sign), SAME)


@njit
def drive_friction(chain: Chain, v: FloatArray, drive: FloatArray, torque: FloatArray) -> None:
    """As `friction_torque`, of joints whose drives have torques ``drive``, shape (n,) [N m]."""
    for i in range(v.shape[0]):
        row = chain.friction[i]
        torque[i] = drive[i]
        if row[LOAD] > 0.0:
            sign = smooth_sign(v[i], row[SLOPE])
            left = drive[i] - row[VISCOUS] * v[i] - row[COULOMB] * sign - row[OFFSET]
            torque[i] = left * acting_share(row, left, sign)
    friction_torque(chain, v, torque, torque)
