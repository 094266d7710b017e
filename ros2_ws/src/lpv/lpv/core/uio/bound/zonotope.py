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
def map_columns(columns: np.ndarray, count: int, m: np.ndarray) -> None:
    """Replace each of the first columns g by m @ g."""
    # Not read from m in the loop, which is compiled for several columns at once then.
    first, second, third, fourth = _row(m, 0), _row(m, 1), _row(m, 2), _row(m, 3)
    for j in range(count):
        a, b, c, d = columns[0, j], columns[1, j], columns[2, j], columns[3, j]
        columns[0, j] = first[0] * a + first[1] * b + first[2] * c + first[3] * d
        columns[1, j] = second[0] * a + second[1] * b + second[2] * c + second[3] * d
        columns[2, j] = third[0] * a + third[1] * b + third[2] * c + third[3] * d
        columns[3, j] = fourth[0] * a + fourth[1] * b + fourth[2] * c + fourth[3] * d


@njit
def _row(m: np.ndarray, r: int) -> tuple[float, float, float, float]:
    return m[r, 0], m[r, 1], m[r, 2], m[r, 3]


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
    out[:] = 0.0
    for j in range(count):  # four sums at once: one alone would wait for each addition
        for r in range(SIZE):
            out[r] += abs(columns[r, j])
