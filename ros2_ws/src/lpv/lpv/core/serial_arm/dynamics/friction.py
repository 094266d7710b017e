"""Joint friction: viscous, Coulomb (constant and growing with load), and a torque offset.

F_i(v) = viscous v + (coulomb + load abs(tau_i)) s(v) + offset, s(v) = (2/pi) atan(slope v).
"""

import math

from lpv.core.serial_arm.chain import COULOMB, LOAD, OFFSET, SLOPE, VISCOUS, Chain, FloatArray
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
