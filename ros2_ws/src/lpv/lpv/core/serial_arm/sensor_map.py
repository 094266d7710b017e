"""Between joint positions q and readings y = S q + f: products that leave zeros out.

A sensor that delivers NaN must not spoil what does not depend on it: 0 NaN is NaN.  The same
matrices lead from rates to rates.
"""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.support.jit import njit_in_place


@njit_in_place
def map_vector(matrix: FloatArray, values: FloatArray, result: FloatArray) -> None:
    """Write the product of a matrix (n, n) and values (n,); ``result`` is another array."""
    for i in range(matrix.shape[0]):
        total, row = 0.0, matrix[i]
        for j in range(matrix.shape[1]):
            if row[j] != 0.0:
                total += row[j] * values[j]
        result[i] = total


@njit_in_place
def _map_rows(matrix: FloatArray, values: FloatArray, result: FloatArray) -> None:
    for k in range(values.shape[0]):
        map_vector(matrix, values[k], result[k])


def mixing(matrix: FloatArray) -> FloatArray | None:
    """The matrix, or None where it is 1 and `map_rows` has nothing to do."""
    return None if np.array_equal(matrix, np.eye(len(matrix))) else matrix


def map_rows(matrix: FloatArray | None, values: FloatArray) -> FloatArray:
    """Products of a matrix (n, n) and rows of values.

    Parameters
    ----------
    matrix : ndarray, shape (n, n), optional
        S, or its inverse; see `mixing`.
    values : ndarray, shape (..., n)
        Positions or rates.

    Returns
    -------
    ndarray, shape (..., n)
        The values themselves without a matrix.
    """
    if matrix is None:
        return values
    rows = np.ascontiguousarray(values, float).reshape(-1, len(matrix))
    result = np.empty(rows.shape)
    _map_rows(np.ascontiguousarray(matrix), rows, result)
    return result.reshape(values.shape)
