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
    """Replace every column g by m @ g."""
    # Locals: the compiler cannot know that the map does not change with the columns.
    m_00, m_01, m_02, m_03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m_10, m_11, m_12, m_13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m_20, m_21, m_22, m_23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m_30, m_31, m_32, m_33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    for j in range(count):
        a, b, c, d = columns[0, j], columns[1, j], columns[2, j], columns[3, j]
        columns[0, j] = m_00 * a + m_01 * b + m_02 * c + m_03 * d
        columns[1, j] = m_10 * a + m_11 * b + m_12 * c + m_13 * d
        columns[2, j] = m_20 * a + m_21 * b + m_22 * c + m_23 * d
        columns[3, j] = m_30 * a + m_31 * b + m_32 * c + m_33 * d


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
    box[:] = 0.0
    while count > KEPT:  # a sort of NumPy's takes longer to compile than all the rest
        count -= 1
        j = 0
        for k in range(1, count + 1):
            if size[k] < size[j]:
                j = k
        for r in range(SIZE):
            box[r] += abs(columns[r, j])
            columns[r, j] = columns[r, count]
        size[j] = size[count]
    for r in range(SIZE):
        columns[r, KEPT : KEPT + SIZE] = 0.0
        columns[r, KEPT + r] = box[r]
    return KEPT + SIZE


@njit
def extent(columns: np.ndarray, count: int, out: np.ndarray) -> None:
    """Largest absolute value of every coordinate."""
    for r in range(SIZE):
        total = 0.0
        for j in range(count):
            total += abs(columns[r, j])
        out[r] = total
