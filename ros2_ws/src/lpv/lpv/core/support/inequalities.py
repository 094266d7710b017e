"""Whether matrix inequalities hold: by eigenvalues, and in exact rational arithmetic."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

SAME = 1e-6
"""Relative difference up to which a recomputed number is the stored one."""

NumberType = Callable[[Any], Any]
"""Makes numbers of one type: floats, or exact ``fractions.Fraction``."""


@dataclass(frozen=True)
class Check:
    """One inequality."""

    name: str  # what it is
    margin: float  # largest eigenvalue, or another figure that must be negative

    @property
    def holds(self) -> bool:
        """Whether it is satisfied; NaN is not."""
        return self.margin < 0.0


def largest_eigenvalue(*matrices: np.ndarray) -> float:
    """Largest eigenvalue of symmetric matrices; negative if M < 0 holds for all of them.

    NaN if any is not finite, which Python's max of their own would pass over.
    """
    if not all(np.isfinite(matrix).all() for matrix in matrices):
        return np.nan
    each = map(np.asarray, matrices)
    return max(float(np.linalg.eigvalsh(0.5 * (m + m.T))[-1]) for m in each)


def exact(values: ArrayLike) -> np.ndarray:
    """Array of fractions that equal the given floats."""
    return np.vectorize(Fraction, otypes=[object])(np.asarray(values))


def array_of(number: NumberType) -> Callable[[ArrayLike], np.ndarray]:
    """What makes arrays of a kind of number, floats or fractions."""
    return exact if number is Fraction else np.asarray


def is_positive_definite(matrix: np.ndarray) -> bool:
    """Sylvester's criterion by symmetric elimination over the fractions."""
    rest = exact(matrix)
    if not np.array_equal(rest, rest.T):
        return False
    for k in range(len(rest)):
        pivot = rest[k, k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(rest)):
            if rest[i, k] != 0:
                rest[i, k:] = rest[i, k:] - rest[k, k:] * (rest[i, k] / pivot)
    return True


def is_negative(matrix: np.ndarray) -> bool:
    """Whether sym(matrix) < 0."""
    matrix = exact(matrix)
    return is_positive_definite(-(matrix + matrix.T))
