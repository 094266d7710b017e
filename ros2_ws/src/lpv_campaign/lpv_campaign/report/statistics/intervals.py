"""Confidence intervals of rates, areas and quantiles; 95 % each, two-sided."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, norm

LEVEL = 0.95
"""Confidence level of all intervals."""
_Z = float(norm.ppf(0.5 + LEVEL / 2.0))


def wilson(hits: int | np.ndarray, cases: int | np.ndarray) -> tuple[np.ndarray, ...]:
    """Wilson's interval of a rate.

    Written out, because SciPy's comes with a test that takes a thousand times as long.

    Parameters
    ----------
    hits, cases : int or ndarray
        Successes and trials, at least one.

    Returns
    -------
    tuple of ndarray
        Both ends.
    """
    z2, rate = _Z**2, hits / cases
    middle = (rate + z2 / (2.0 * cases)) / (1.0 + z2 / cases)
    half = _Z * np.sqrt(rate * (1.0 - rate) / cases + z2 / (4.0 * cases**2)) / (1.0 + z2 / cases)
    # At 0 and 1 rounding would leave the rate outside.
    return np.minimum(np.clip(middle - half, 0.0, 1.0), rate), np.maximum(
        np.clip(middle + half, 0.0, 1.0), rate
    )


def proportion(hits: int, cases: int) -> dict[str, Any]:
    """A rate with Wilson's interval.

    Returns ``hits``, ``cases``, ``rate``, ``low``, ``high``; the last three None without cases.
    """
    hits, cases = int(hits), int(cases)
    if cases == 0:
        return {'hits': 0, 'cases': 0, 'rate': None, 'low': None, 'high': None}
    low, high = wilson(hits, cases)
    return {
        'hits': hits,
        'cases': cases,
        'rate': hits / cases,
        'low': float(low),
        'high': float(high),
    }


def share(mask: np.ndarray, among: np.ndarray | None = None) -> dict[str, Any]:
    """Rate of a property, with its interval."""
    if among is None:
        return proportion(int(np.count_nonzero(mask)), len(mask))
    return proportion(int(np.count_nonzero(mask & among)), int(np.count_nonzero(among)))


def poisson_rate(events: int, hours: float) -> dict[str, Any]:
    """Rate of events with the exact Poisson interval (Garwood).

    Parameters
    ----------
    events : int
        How many occurred.
    hours : float
        In which time [h].

    Returns
    -------
    dict
        ``events``, ``hours``, ``rate``, ``low``, ``high`` [1/h]; the rates are None without time.
        Without events ``high`` is the one-sided bound: 3.0 over the time.
    """
    events, hours = int(events), float(hours)
    result = {'events': events, 'hours': hours, 'rate': None, 'low': None, 'high': None}
    if not hours > 0.0:
        return result
    tail = (1.0 - LEVEL) / 2.0
    low = float(chi2.ppf(tail, 2 * events)) / 2.0 if events else 0.0
    high = float(chi2.ppf(1.0 - (tail if events else 2.0 * tail), 2 * events + 2)) / 2.0
    return {**result, 'rate': events / hours, 'low': low / hours, 'high': high / hours}


def area_interval(area: float, positive: int, negative: int) -> tuple[float, ...]:
    """Interval of an area under a ROC curve by Newcombe's method 5.

    Unlike the usual standard errors it does not shrink to nothing where scores are separated.

    Parameters
    ----------
    area : float
        The area.
    positive, negative : int
        Cases with and without a fault.

    Returns
    -------
    tuple of float
        Both ends.
    """
    mean = (positive + negative) / 2.0 - 1.0

    def excess(theta: float) -> float:
        spread = (
            theta
            * (1.0 - theta)
            * (1.0 + mean * ((1.0 - theta) / (2.0 - theta) + theta / (1.0 + theta)))
        )
        return abs(theta - area) - _Z * math.sqrt(max(spread, 0.0) / (positive * negative))

    low = brentq(excess, 0.0, area) if area > 0.0 and excess(0.0) > 0.0 > excess(area) else 0.0
    high = brentq(excess, area, 1.0) if area < 1.0 and excess(1.0) > 0.0 > excess(area) else 1.0
    if area in (0.0, 1.0):
        low, high = _one_end(excess, area)
    return float(low), float(high)


def _one_end(excess: Callable[[float], float], area: float) -> tuple[float, float]:
    # At 0 and 1 the spread vanishes, so that the search must start next to them.
    if area == 1.0:
        return brentq(excess, 0.0, 1.0 - 1e-12), 1.0
    return 0.0, brentq(excess, 1e-12, 1.0)


def spread(values: np.ndarray) -> dict[str, Any]:
    """Median and the middle 90 % of some values.

    Returns ``count``, ``low`` (5 %), ``median``, ``high`` (95 %); None without values.
    """
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    if not values.size:
        return {'count': 0, 'low': None, 'median': None, 'high': None}
    low, median, high = (float(v) for v in np.percentile(values, (5.0, 50.0, 95.0)))
    return {'count': int(values.size), 'low': low, 'median': median, 'high': high}
