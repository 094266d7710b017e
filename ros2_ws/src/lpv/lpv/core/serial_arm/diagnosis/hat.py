"""Integrals with a hat function over two intervals: the time profile of every momentum balance."""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.support.jit import njit_in_place


class Hat(NamedTuple):
    """Integrals over the previous and the current interval, of c columns for n joints."""

    momentum: FloatArray  # (2, n, c) of p [N m s2]
    rising: FloatArray  # (2, n, c) of forces, weighted by the half of the hat that rises [N m s]
    falling: FloatArray  # (n, c) by the half that falls, of the current interval alone [N m s]
    rows: FloatArray  # (n, c) mean(p, 2nd) - mean(p, 1st) - int w force dt, of the last one [N m s]
    length: FloatArray  # (1,) of the previous interval, 0 if there is none [s]


def new_hat(joints: int, columns: int) -> Hat:
    """A hat without samples."""
    shape = joints, columns
    return Hat(
        np.zeros((2, *shape)), np.zeros((2, *shape)), np.zeros(shape), np.zeros(shape), np.zeros(1)
    )


@njit_in_place
def put(
    hat: Hat, column: int, row: int, parts: tuple[float, float], weight: tuple[float, float]
) -> None:
    """Add momentum and force of one entry, weighted by block length and place in the interval."""
    momentum, force = parts
    length, place = weight
    hat.momentum[1, row, column] += length * momentum
    hat.rising[1, row, column] += length * place * force
    hat.falling[row, column] += length * (1.0 - place) * force


@njit_in_place
def close_hat(hat: Hat, length: float) -> bool:
    """End the current interval [s], which becomes the previous one; true if ``rows`` are new."""
    before = hat.length[0]
    n, columns = hat.rows.shape
    for i in range(n):
        for c in range(columns):
            if before > 0.0:
                hat.rows[i, c] = (
                    hat.momentum[1, i, c] / length
                    - hat.momentum[0, i, c] / before
                    - hat.rising[0, i, c]
                    - hat.falling[i, c]
                )
            hat.momentum[0, i, c], hat.rising[0, i, c] = hat.momentum[1, i, c], hat.rising[1, i, c]
            hat.momentum[1, i, c] = hat.rising[1, i, c] = hat.falling[i, c] = 0.0
    hat.length[0] = length
    return bool(before > 0.0)


@njit_in_place
def drop_hat(hat: Hat) -> None:
    """Forget the intervals so far."""
    hat.momentum[:] = 0.0
    hat.rising[:] = 0.0
    hat.falling[:] = 0.0
    hat.length[0] = 0.0
