"""Whether the values of an estimate can be an arm's at all, before anything else is made of it."""

import math
from enum import IntEnum

import numpy as np

from lpv_core.support.jit import njit

ROWS = ('position', 'compensated_position', 'measured_position', 'velocity', 'measured_velocity')
"""Fields of lpv_msgs/StateEstimate in the order in which `check_values` takes them."""
_POSITIONS = 3
_FARTHEST, _FASTEST = 100.0, 1e6
"""Positions [rad] and rates [rad/s] that no arm has: sixteen turns; rates above the velocity limit
are judged by the watchdog."""


class ValueFault(IntEnum):
    """What is wrong with the values of an estimate."""

    NONE = 0
    NOT_FINITE = 1
    IMPOSSIBLE = 2


_NONE, _NOT_FINITE, _IMPOSSIBLE = (int(fault) for fault in ValueFault)


@njit
def check_values(values: np.ndarray) -> int:
    """`ValueFault` of positions and rates, shape (5, n), in the order of `ROWS`."""
    found = _NONE
    for k in range(values.shape[0]):
        limit = _FARTHEST if k < _POSITIONS else _FASTEST
        for i in range(values.shape[1]):
            if not math.isfinite(values[k, i]):
                return _NOT_FINITE
            if abs(values[k, i]) > limit:
                found = _IMPOSSIBLE
    return found
