"""Probability of detection against size: a logistic curve in the logarithm of the size."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

_LEAST = 10
_STEPS = 60
_LONGEST = 5.0
_CONVERGED = 1e-10


@dataclass(frozen=True)
class DetectionCurve:
    """P = 1 / (1 + exp(-(a + b ln(size))))."""

    intercept: float  # a
    slope: float  # b
    covariance: np.ndarray  # (2, 2) Of both
    low: float  # Smallest size of the data; the curve says nothing below
    high: float  # Largest size of the data; the curve says nothing above

    def probability(self, size: Any) -> Any:
        """Probability of detection at a size; any shape."""
        value = self.intercept + self.slope * np.log(size)
        return 1.0 / (1.0 + np.exp(-np.clip(value, -500.0, 500.0)))

    def size(self, probability: float) -> dict[str, Any]:
        """Size at which a probability is reached.

        Returns ``size``, and ``bound``: its upper confidence bound (95 %, delta method).
        None where it lies above all sizes of the data; the smallest size without a bound,
        with ``below`` true, where all sizes of the data reach the probability.
        """
        nothing = {'size': None, 'bound': None, 'below': False}
        if min(self.probability(self.low), self.probability(self.high)) >= probability:
            return {'size': self.low, 'bound': None, 'below': True}
        if not self.slope > 0.0:
            return nothing
        logarithm = (math.log(probability / (1.0 - probability)) - self.intercept) / self.slope
        gradient = -np.array([1.0, logarithm]) / self.slope
        error = math.sqrt(max(float(gradient @ self.covariance @ gradient), 0.0))
        top = logarithm + norm.ppf(0.95) * error
        if logarithm > math.log(self.high):
            return nothing
        bound = math.exp(top) if top <= math.log(self.high) else None
        return {'size': math.exp(logarithm), 'bound': bound, 'below': False}


def detection_curve(sizes: np.ndarray, found: np.ndarray) -> DetectionCurve | None:
    """Fit the curve by Firth's penalised likelihood.

    The penalty keeps the fit finite where a size separates all that is found from all that is not,
    which is what a good diagnosis does.

    Parameters
    ----------
    sizes : ndarray, shape (n,)
        Sizes, positive.
    found : ndarray of bool, shape (n,)
        Which were detected.

    Returns
    -------
    DetectionCurve or None
        None with fewer than ten cases or without different sizes.
    """
    known = np.isfinite(sizes) & (sizes > 0.0)
    sizes, found = sizes[known], found[known].astype(float)
    if len(sizes) < _LEAST or sizes.min() == sizes.max():
        return None
    logarithm = np.log(sizes)
    middle, width = logarithm.mean(), logarithm.std()
    design = np.column_stack([np.ones(len(sizes)), (logarithm - middle) / width])
    fitted = _fit(design, found)
    if fitted is None:
        return None
    beta, covariance = fitted
    # Back from the standardised logarithm.
    back = np.array([[1.0, -middle / width], [0.0, 1.0 / width]])
    intercept, slope = back @ beta
    return DetectionCurve(
        float(intercept),
        float(slope),
        back @ covariance @ back.T,
        float(sizes.min()),
        float(sizes.max()),
    )


def _fit(design: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    beta = np.zeros(2)
    for _ in range(_STEPS):
        chance = 1.0 / (1.0 + np.exp(-np.clip(design @ beta, -500.0, 500.0)))
        weight = chance * (1.0 - chance)
        information = design.T @ (design * weight[:, None])
        if not np.linalg.cond(information) < 1e12:
            return None
        covariance = np.linalg.inv(information)
        leverage = weight * np.einsum('ij,jk,ik->i', design, covariance, design)
        step = covariance @ (design.T @ (found - chance + leverage * (0.5 - chance)))
        longest = np.abs(step).max()
        beta = beta + step * min(1.0, _LONGEST / longest) if longest > 0.0 else beta
        if longest < _CONVERGED:
            return beta, covariance
    return (beta, covariance) if longest < 1e-4 else None
