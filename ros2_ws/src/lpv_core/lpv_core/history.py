"""The last second of one sensor: fault estimate, reading, and the reading that was expected.

A buffer is two arrays, stamps (2*size,) and values (2*size, 3), and the number ``end`` of rows in
use; the newest ``size`` of them count.
"""

import numpy as np

from lpv_core.jit import njit

FAULT, READING, EXPECTED = range(3)
"""Columns of the values."""

_MEDIAN_OF = 5


def new_history(size):
    """An empty buffer.

    Parameters
    ----------
    size : int
        Samples that are kept.

    Returns
    -------
    tuple of ndarray
        Stamps (2*size,) [ns] and values (2*size, 3) [rad].
    """
    return np.zeros(2 * size, dtype=np.int64), np.zeros((2 * size, 3))


@njit
def add_sample(stamps, values, end, stamp, fault, reading, expected):
    """Add a sample.

    Parameters
    ----------
    stamps, values : ndarray
        The buffer.
    end : int
        Rows in use.
    stamp : int
        [ns], larger than the last one.
    fault, reading, expected : float
        f^, y_p and S theta^ of the sensor [rad].

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
            for column in range(3):
                values[k, column] = values[end + k, column]
    stamps[end] = stamp
    values[end, FAULT], values[end, READING], values[end, EXPECTED] = fault, reading, expected
    return end + 1


@njit
def index_at(stamps, end, stamp, guess):
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
def first_since(stamps, end, stamp):
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
def median_before(values, row):
    """Median of up to five fault estimates that end at a row.

    A single bad sample must not be what later ones are compared with.

    Parameters
    ----------
    values : ndarray, shape (2*size, 3)
        The buffer's.
    row : int
        Last row.

    Returns
    -------
    float
        [rad].
    """
    few = np.sort(values[max(0, row + 1 - _MEDIAN_OF):row + 1, FAULT])
    return few[len(few) // 2]
