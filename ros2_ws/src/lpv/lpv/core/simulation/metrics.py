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
    square = np.ma.masked_invalid(np.square(np.asarray(error, float)))
    return np.ma.filled(square.mean(axis=0), np.nan)
