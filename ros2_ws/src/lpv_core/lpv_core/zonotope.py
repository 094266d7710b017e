"""Reachable sets as zonotopes: all errors that unknown but bounded inputs can have caused.

A zonotope holds the points sum_j g_j s_j with abs(s_j) <= 1.  The columns g_j keep their signs when
the set is mapped, so that effects that cancel in time do cancel, which a bound by absolute values
would not see.
"""

import numpy as np

from lpv_core.jit import njit

KEPT = 24
"""Columns that a reduction leaves, beside one for each coordinate."""
COLUMNS = 64
"""Columns that are stored."""


@njit
def map_columns(columns, count, matrix, work):
    """Replace every column g by matrix @ g.

    Parameters
    ----------
    columns : ndarray, shape (n, COLUMNS)
        Changed in place.
    count : int
        Columns in use.
    matrix : ndarray, shape (n, n)
        The map.
    work : ndarray, shape (n,)
        Scratch.
    """
    n = columns.shape[0]
    for j in range(count):
        for r in range(n):
            total = 0.0
            for q in range(n):
                total += matrix[r, q] * columns[q, j]
            work[r] = total
        for r in range(n):
            columns[r, j] = work[r]


@njit
def reduce_columns(columns, count, work):
    """Put all but the largest columns into one box around their sum.

    Small columns lose their signs, which costs least; the set only grows.

    Parameters
    ----------
    columns : ndarray, shape (n, COLUMNS)
        Changed in place; rows should be scaled alike.
    count : int
        Columns in use.
    work : ndarray, shape (n,)
        Scratch.

    Returns
    -------
    int
        Columns in use afterwards.
    """
    n = columns.shape[0]
    size = np.zeros(count)
    for j in range(count):
        for r in range(n):
            size[j] += abs(columns[r, j])
    order = np.argsort(size)
    work[:] = 0.0
    kept = columns[:, order[count - KEPT:count]].copy()
    for k in range(count - KEPT):
        for r in range(n):
            work[r] += abs(columns[r, order[k]])
    columns[:, :KEPT] = kept
    columns[:, KEPT:KEPT + n] = 0.0
    for r in range(n):
        columns[r, KEPT + r] = work[r]
    return KEPT + n


@njit
def extent(columns, count, out):
    """Largest absolute value of every coordinate.

    Parameters
    ----------
    columns : ndarray, shape (n, COLUMNS)
        The zonotope.
    count : int
        Columns in use.
    out : ndarray, shape (n,)
        Receives the extents.
    """
    for r in range(columns.shape[0]):
        total = 0.0
        for j in range(count):
            total += abs(columns[r, j])
        out[r] = total
