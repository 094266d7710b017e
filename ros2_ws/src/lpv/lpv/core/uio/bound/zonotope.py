"""Reachable sets as zonotopes: all errors that unknown but bounded inputs can have caused.

A zonotope holds the points sum_j g_j s_j with abs(s_j) <= 1.  The columns g_j keep their signs when
the set is mapped, so that effects that cancel in time do cancel, which a bound by absolute values
would not see.
"""

import numpy as np

from lpv.core.support.jit import njit_in_place as njit

KEPT = 24
"""Columns that a reduction leaves, beside one for each coordinate."""
COLUMNS = 64
"""Columns that are stored: those, and what six steps of six columns add."""
SIZE = 4
"""Coordinates."""


@njit
def map_columns(columns: np.ndarray, first: int, end: int, m: np.ndarray) -> None:
    """Replace every column g from the first one on, before the end, by m @ g."""
    for j in range(first, end):
        a, b, c, d = columns[0, j], columns[1, j], columns[2, j], columns[3, j]
        for r in range(SIZE):
            columns[r, j] = m[r, 0] * a + m[r, 1] * b + m[r, 2] * c + m[r, 3] * d


@njit
def shear_columns(columns: np.ndarray, count: int, first: float, second: float) -> None:
    """Add ``first`` times row 2 to row 0 and ``second`` times row 3 to row 1, in place."""
    for k in range(count):
        columns[0, k] += first * columns[2, k]
        columns[1, k] += second * columns[3, k]


@njit
def reduce_columns(columns: np.ndarray, count: int, size: np.ndarray, box: np.ndarray) -> int:
    """Put all but the largest columns into one box around their sum.

    Small columns lose their signs, which costs least; the set only grows.  The last two are
    scratch, shapes (`COLUMNS`,), (`SIZE`,).
    """
    for j in range(count):
        size[j] = 0.0
        for r in range(SIZE):
            size[j] += abs(columns[r, j])
    _put_largest_first(columns, count, size)
    box[:] = 0.0
    for j in range(KEPT, count):
        for r in range(SIZE):
            box[r] += abs(columns[r, j])
    for r in range(SIZE):
        columns[r, KEPT : KEPT + SIZE] = 0.0
        columns[r, KEPT + r] = box[r]
    return KEPT + SIZE


@njit
def _put_largest_first(columns: np.ndarray, count: int, size: np.ndarray) -> None:
    """Order columns so that the first `KEPT` are the largest, by Hoare's selection.

    A sort of NumPy's takes longer to compile than all the rest.
    """
    first, last = 0, count - 1
    while first < last:
        pivot, j, k = size[(first + last) // 2], first, last
        while j <= k:
            while size[j] > pivot:
                j += 1
            while size[k] < pivot:
                k -= 1
            if j <= k:
                size[j], size[k] = size[k], size[j]
                for r in range(SIZE):
                    columns[r, j], columns[r, k] = columns[r, k], columns[r, j]
                j, k = j + 1, k - 1
        if k >= KEPT - 1:
            last = k
        elif j <= KEPT - 1:
            first = j
        else:
            break


@njit
def extent(columns: np.ndarray, count: int, out: np.ndarray) -> None:
    """Largest absolute value of every coordinate."""
    for r in range(SIZE):
        total = 0.0
        for j in range(count):
            total += abs(columns[r, j])
        out[r] = total
