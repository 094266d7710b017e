"""Figures of merit."""

import numpy as np


def mise(error: np.ndarray) -> float | np.ndarray:
    """Mean integral of squared error over equidistant samples, eq. (70).

    Parameters
    ----------
    error : array_like, shape (n,) or (n, k)
        Error signal(s); samples that are not finite (a dropped-out sensor) are left out.

    Returns
    -------
    float or ndarray, shape (k,)
        Mean of the square; NaN without any finite sample.
    """
    square = np.square(np.asarray(error, float))
    finite = np.isfinite(square)
    count = finite.sum(axis=0)
    total = np.where(finite, square, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full_like(total, np.nan, dtype=float), where=count > 0)
