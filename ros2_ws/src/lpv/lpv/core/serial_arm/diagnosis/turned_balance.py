"""What balances of an arm become where one of its sensors reads more than is true.

Other sensors may be off a little while a threshold is compared: the torques of the nominal arm, and
of all that may differ from it, are then those of another pose.  Means of intervals are enough here.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray, workspace
from lpv.core.serial_arm.diagnosis.hat import Hat, close_hat, new_hat, put
from lpv.core.serial_arm.dynamics.regressor import momentum_regressor
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place


class TurnedBalance(NamedTuple):
    """Balances at the readings, and with more of each."""

    chain: Chain
    to_joints: FloatArray  # (n, n) S^-1 of y = S q + f
    more: FloatArray  # (n,) of each reading [rad]
    hat: Hat  # regressors, at the readings and then with more of each: (n + 1) n rows of 10 n
    work: FloatArray  # scratch: workspace
    first: FloatArray  # (n, 10 n) scratch: regressor
    second: FloatArray  # (n, 10 n) scratch: regressor
    means: FloatArray  # (2, n) scratch: readings and rates
    motion: FloatArray  # (2, n) scratch: joint positions and rates


def new_turned_balance(chain: Chain, to_joints: FloatArray, more: FloatArray) -> TurnedBalance:
    """Balances without samples."""
    n = len(more)
    return TurnedBalance(
        chain, to_joints, more, new_hat((n + 1) * n, 10 * n), workspace(chain),
        *np.zeros((2, n, 10 * n)), *np.zeros((2, 2, n)))  # fmt: skip


@njit_in_place
def add_turned_interval(balance: TurnedBalance, blocks: FloatArray, changes: FloatArray) -> None:
    """Add an interval; with one before it, write how the regressors of its balance change.

    ``blocks`` are as those of `Sampler`, ``changes``, shape (n, 10 n^2), by reading and parameter.
    """
    n, length, hat = balance.more.shape[0], 0.0, balance.hat
    y, v = balance.means
    y[:] = v[:] = 0.0
    for block in blocks:
        length += block[3 * n + 1]
        for i in range(n):
            y[i] += block[3 * n + 1] * block[i]
            v[i] += block[3 * n + 1] * block[n + i]
    for i in range(n):
        y[i] /= length
        v[i] /= length
    map_vector(balance.to_joints, v, balance.motion[1])
    for j in range(n + 1):
        map_vector(balance.to_joints, y, balance.motion[0])
        if j > 0:
            for i in range(n):
                balance.motion[0, i] += balance.to_joints[i, j - 1] * balance.more[j - 1]
        momentum_regressor(
            balance.chain, balance.motion[0], balance.motion[1], balance.work, balance.first,
            balance.second)  # fmt: skip
        for i in range(n):
            for c in range(10 * n):
                parts = balance.first[i, c], balance.second[i, c]
                put(hat, c, j * n + i, parts, (length, 0.5))
    if close_hat(hat, length):
        for j in range(n):
            for i in range(n):
                for c in range(10 * n):
                    change = hat.rows[(j + 1) * n + i, c] - hat.rows[i, c]
                    changes[i, 10 * n * j + c] = change
