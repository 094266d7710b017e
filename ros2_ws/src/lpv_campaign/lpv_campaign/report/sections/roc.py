"""Detection against false alarms over a sweep of the threshold factor."""

from typing import Any

import numpy as np
from scipy.stats import rankdata

from lpv_campaign.report.statistics.intervals import area_interval, proportion, share, wilson
from lpv_campaign.report.statistics.results import Results

_POINTS, _DIGITS = 200, 6
ALL = 'all'
"""Stands for all kinds, or for both sensors."""


def roc(results: Results) -> dict[str, Any]:
    """ROC curves by kind of fault and sensor.

    Returns ``curves``: one per kind (and all, where there are several) and sensor, each with
    ``kind``, ``sensor``, ``positive`` and ``negative`` cases, those ``without_score``, ``area``
    with its interval, ``points`` of the sweep, rates of the ``score`` at the shipped threshold
    and of the ``shipped`` decision (actual alarms); ``mean_window``: mean length of the windows
    without a fault [s].
    """
    curves = []
    kinds = results.kinds
    for kind in [*kinds, ALL] if len(kinds) > 1 else kinds:
        for i, sensor in enumerate(results.sensors):
            chosen = results.of_sensor(i)
            if kind != ALL:
                chosen = chosen & (results.kind == kind)
            curves.append({'kind': kind, 'sensor': sensor, **_curve(results, i, chosen)})
    return {'curves': curves, 'mean_window': _mean_window(results)}


def _mean_window(results: Results) -> float | None:
    """Mean length of the windows without a fault from which false alarms are counted [s]."""
    hours = results.early_hours
    return float(hours.mean() * 3600.0) if hours.size else None


def _curve(results: Results, i: int, chosen: np.ndarray) -> dict[str, Any]:
    during = results.number(f'score_during_{i + 1}')[chosen]
    before = results.number(f'score_before_{i + 1}')
    positive, negative = during[~np.isnan(during)], before[~np.isnan(before)]
    return {
        'positive': len(positive),
        'negative': len(negative),
        'without_score': int(len(during) - len(positive)),
        **area(positive, negative),
        'points': sweep(positive, negative),
        'shipped': _shipped(results, i, chosen),
        'score': {'detection': share(positive > 1.0), 'false_alarm': share(negative > 1.0)},
    }


def area(positive: np.ndarray, negative: np.ndarray) -> dict[str, Any]:
    """Area under the ROC curve: how often a faulty case scores above a healthy one.

    Returns ``area``, ``area_low``, ``area_high``; None where either is empty.
    """
    m, n = len(positive), len(negative)
    if not (m and n):
        return {'area': None, 'area_low': None, 'area_high': None}
    ranks = rankdata(np.concatenate([positive, negative]))
    value = float((ranks[:m].sum() - m * (m + 1) / 2.0) / (m * n))
    low, high = area_interval(value, m, n)
    return {'area': value, 'area_low': low, 'area_high': high}


def sweep(positive: np.ndarray, negative: np.ndarray) -> dict[str, Any]:
    """Rates above a threshold that is multiplied by a factor.

    Returns ``factor``, ``detection``, ``false_alarm``, and both rates' intervals with ``_low``
    and ``_high``; from the highest factor to the lowest, the shipped one (1) among them; some
    hundreds. Empty without scores of either.
    """
    if not (len(positive) and len(negative)):
        return {'factor': []}
    scores = np.unique(np.concatenate([positive, negative]))
    levels = np.linspace(0.0, 1.0, _POINTS)
    kept = np.unique(
        np.concatenate(
            [np.quantile(part, levels, method='nearest') for part in (scores, positive, negative)]
        )
    )
    # Below the lowest score everything is an alarm, at the highest one nothing is.
    factors = np.unique(np.concatenate([[0.0, 1.0], kept[np.isfinite(kept)]]))[::-1]
    hits = _above(positive, factors)
    false = _above(negative, factors)
    kept = _informative(factors, hits, false)
    points = {'factor': factors[kept]}
    for name, count, cases in (
        ('detection', hits[kept], len(positive)),
        ('false_alarm', false[kept], len(negative)),
    ):
        points[name] = count / cases
        points[f'{name}_low'], points[f'{name}_high'] = wilson(count, cases)
    return {name: np.round(values, _DIGITS).tolist() for name, values in points.items()}


def _above(scores: np.ndarray, factors: np.ndarray) -> np.ndarray:
    return len(scores) - np.searchsorted(np.sort(scores), factors, side='right')


def _informative(factors: np.ndarray, hits: np.ndarray, false: np.ndarray) -> np.ndarray:
    """Factors at which something changes, and the shipped one."""
    kept = np.ones(len(factors), bool)
    kept[1:] = (np.diff(hits) != 0) | (np.diff(false) != 0)
    return kept | (factors == 1.0)


def _shipped(results: Results, i: int, chosen: np.ndarray) -> dict[str, Any]:
    """What the diagnosis did: alarms while the fault acted, and alarms before any fault."""
    name = f'found_{i + 1}'
    if name not in results.columns:
        return {'detection': proportion(0, 0), 'false_alarm': proportion(0, 0)}
    return {
        'detection': share(results.flag(name), chosen & ~np.isnan(results.number(name))),
        'false_alarm': share(
            results.number(f'alarms_before_{i + 1}') > 0.0,
            ~np.isnan(results.number(f'alarms_before_{i + 1}')),
        ),
    }
