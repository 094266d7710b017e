"""The last seconds of one sensor: residual, reading, allowance, innovation of the rate.

A buffer is two arrays, stamps (2*size,) and values (2*size, 4), and the number ``end`` of rows in
use; the newest ``size`` of them count.  Residual and allowance: see `lpv_core.residual.dead_reckoning`.
"""

import numpy as np

from lpv_core.support.jit import njit

RESIDUAL, READING, ALLOWANCE, INNOVATION = range(4)
"""Columns of the values."""


def new_history(size: int) -> tuple[np.ndarray, ...]:
    """An empty buffer.

    Parameters
    ----------
    size : int
        Samples that are kept.

    Returns
    -------
    tuple of ndarray
        Stamps (2*size,) [ns] and values (2*size, 4) [rad].
    """
    return np.zeros(2 * size, dtype=np.int64), np.zeros((2 * size, 4))


@njit
def add_sample(
    stamps: np.ndarray,
    values: np.ndarray,
    end: int,
    stamp: int,
    residual: float,
    reading: float,
    allowance: float,
    innovation: float,
) -> int:
    """Add a sample.

    Parameters
    ----------
    stamps, values : ndarray
        The buffer.
    end : int
        Rows in use.
    stamp : int
        [ns], larger than the last one.
    residual, reading, allowance, innovation : float
        What the columns hold [rad], [rad/s].

    Returns
    -------
    int
        Rows in use afterwards.
    """
    if end == len(stamps):
        # Keep the newer half: rows stay contiguous, and copying is rare.
        end = len(stamps) // 2
        for k in range(end):
            stamps[k] = stamps[end + k]
            for column in range(4):
                values[k, column] = values[end + k, column]
    stamps[end] = stamp
    row = values[end]
    row[RESIDUAL], row[READING] = residual, reading
    row[ALLOWANCE], row[INNOVATION] = allowance, innovation
    return end + 1


@njit
def index_at(stamps: np.ndarray, end: int, stamp: int, guess: int) -> int:
    """Row of the latest sample not after a stamp.

    Parameters
    ----------
    stamps : ndarray of int64
        The buffer's.
    end : int
        Rows in use.
    stamp : int
        [ns].
    guess : int
        Where it should be; a good one saves time and does not change the result.

    Returns
    -------
    int
        -1 where the buffer does not reach back so far.
    """
    oldest = max(0, end - len(stamps) // 2)
    row = min(max(guess, oldest), end - 1)
    while row >= oldest and stamps[row] > stamp:
        row -= 1
    while row + 1 < end and row >= oldest and stamps[row + 1] <= stamp:
        row += 1
    return row if row >= oldest else -1


@njit
def first_since(stamps: np.ndarray, end: int, stamp: int) -> int:
    """First row that is not before a stamp; ``end`` if there is none.

    Parameters
    ----------
    stamps : ndarray of int64
        The buffer's.
    end : int
        Rows in use.
    stamp : int
        [ns].

    Returns
    -------
    int
        Among those that are kept.
    """
    row = end
    oldest = max(0, end - len(stamps) // 2)
    while row > oldest and stamps[row - 1] >= stamp:
        row -= 1
    return row


@njit
def median_before(values: np.ndarray, row: int, count: int) -> float:
    """Median of up to so many residuals that end at a row.

    A single bad sample must not be what later ones are compared with.

    Parameters
    ----------
    values : ndarray, shape (2*size, 4)
        The buffer's.
    row : int
        Last row.
    count : int
        Samples; fewer where the buffer begins.

    Returns
    -------
    float
        [rad].
    """
    few = np.sort(values[max(0, row + 1 - count) : row + 1, RESIDUAL])
    return few[len(few) // 2]
