"""Statistics of a fleet: rates of alarms, bags to look at, trends of single arms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

_LEVEL = 0.95
_FEWEST = 5
"""Bags of one arm from which a trend is looked for."""
_DAY = 86400e9


@dataclass(frozen=True)
class Rate:
    """Events per hour.

    Attributes
    ----------
    count : int
        Events.
    hours : float
        Time under observation [h].
    low, high : float
        Exact limits of the rate of a Poisson process, 95 % [1/h].
    """

    count: int
    hours: float
    low: float
    high: float

    @property
    def value(self):
        """Estimate [1/h]; NaN without observation."""
        return self.count / self.hours if self.hours > 0.0 else math.nan


def rate(count: int, hours: float) -> Rate:
    """Rate with its exact interval.

    Parameters
    ----------
    count : int
        Events.
    hours : float
        Time under observation [h].

    Returns
    -------
    Rate
        The limits are 0 and infinity without observation.
    """
    if not hours > 0.0:
        return Rate(count, 0.0, 0.0, math.inf)
    tail = (1.0 - _LEVEL) / 2.0
    low = stats.chi2.ppf(tail, 2 * count) / 2.0 / hours if count else 0.0
    return Rate(count, hours, float(low), float(stats.chi2.isf(tail, 2 * count + 2) / 2.0 / hours))


@dataclass(frozen=True)
class Trend:
    """How the fault estimate of one sensor of one arm changes from bag to bag.

    Attributes
    ----------
    unit : str
        The arm.
    sensor : int
        Index of the sensor.
    days, means : ndarray, shape (n,)
        Time of each bag since the first one [d], and its mean fault estimate [rad].
    slope, low, high : float
        Theil-Sen slope and its interval, 95 % [rad/d].
    probability : float
        That independent values are so much in order (Kendall's tau).
    significant : bool
        Whether that is less than 5 % over all trends together (Bonferroni).
    threshold : float
        Median of the bags' mean thresholds [rad].
    days_left : float
        Time from the last bag on after which the estimate reaches the mean threshold [d]; infinite
        where it does not grow.
    """

    unit: str
    sensor: int
    days: np.ndarray
    means: np.ndarray
    slope: float
    low: float
    high: float
    probability: float
    significant: bool
    threshold: float
    days_left: float


@dataclass(frozen=True)
class FleetStatistics:
    """Statistics of an archive.

    Attributes
    ----------
    bags, failed : int
        All bags, and those that could not be read.
    hours : float
        Time under observation [h].
    alarms : dict of str to Rate
        Alarms by sensor, and ``all``.
    kinds : dict of tuple to int
        Alarms by sensor and kind.
    false_alarms : Rate
        Alarms without a fault, of bags where that is known.
    detected, faulty : int
        Bags with a true fault, and those of them in which it was found on all its sensors.
    ranking : list of dict
        Rows of all bags that could be read, the most suspicious first.
    failures : list of dict
        Rows of those that could not.
    trends : list of Trend
        The least probable first.
    """

    bags: int
    failed: int
    hours: float
    alarms: dict
    kinds: dict
    false_alarms: Rate
    detected: int
    faulty: int
    ranking: list
    failures: list
    trends: list


def fleet_statistics(table, sensor_names: Sequence[str], healthy: bool = False) -> FleetStatistics:
    """Statistics of the rows of an archive.

    Parameters
    ----------
    table : pyarrow.Table
        As of `lpv_campaign.fleet.store.FleetFolder.rows`.
    sensor_names : sequence of str
        Of the arm.
    healthy : bool, optional
        All bags without ground truth are of healthy arms: their alarms are false.

    Returns
    -------
    FleetStatistics
        What they say.
    """
    # Sums by configuration are long, and not used here.
    rows = table.drop_columns(
        [n for n in table.column_names if n.startswith(('error_squares', 'error_counts'))]
    ).to_pylist()
    good = [row for row in rows if not row['error']]
    hours = _hours(good)
    alarms = {
        name: rate(sum(row[f'alarms_{i + 1}'] for row in good), hours)
        for i, name in enumerate(sensor_names)
    }
    alarms['all'] = rate(sum(row['alarms'] for row in good), hours)
    kinds = {}
    for row in good:
        for alarm in row['alarm_list']:
            key = (alarm['sensor'], alarm['kind'])
            kinds[key] = kinds.get(key, 0) + alarm['count']
    known = [row for row in good if row['false_alarms'] is not None]
    faulty = [row for row in known if row['kind'] != 'none']
    assumed = [row for row in good if healthy and row['false_alarms'] is None]
    false = rate(
        sum(row['false_alarms'] for row in known) + sum(row['alarms'] for row in assumed),
        _hours(known) + _hours(assumed),
    )
    return FleetStatistics(
        len(rows),
        len(rows) - len(good),
        hours,
        alarms,
        kinds,
        false,
        sum(bool(row['detected']) for row in faulty),
        len(faulty),
        sorted(good, key=suspicion, reverse=True),
        [row for row in rows if row['error']],
        trends(good),
    )


def _hours(rows):
    return sum(row['observed'] for row in rows) / 3600.0


def suspicion(row: dict[str, Any]) -> tuple[Any, ...]:
    """What bags are sorted by: alarms first, then contradictions, then how near a threshold.

    Parameters
    ----------
    row : dict
        Of a bag.

    Returns
    -------
    tuple
        The greater, the more suspicious.
    """
    share = row['inconsistent_time'] / row['observed'] if row['observed'] else 0.0
    return row['alarms'] > 0, share > 0.01, max(row['score_1'], row['score_2']), row['bag']


def trends(rows: list[dict[str, Any]]) -> list[Trend]:
    """Trends of all arms that have bags enough.

    Parameters
    ----------
    rows : list of dict
        Of bags that could be read.

    Returns
    -------
    list of Trend
        The least probable first.
    """
    units = {}
    for row in rows:
        units.setdefault(row['unit'], []).append(row)
    found = [
        trend
        for unit, mine in sorted(units.items())
        for i in range(2)
        if (trend := _trend(unit, i, mine)) is not None
    ]
    limit = (1.0 - _LEVEL) / max(1, len(found))
    return sorted(
        (_judged(trend, limit) for trend in found),
        key=lambda trend: (trend.probability, trend.unit, trend.sensor),
    )


def _trend(unit, sensor, rows):
    number = sensor + 1
    rows = sorted(
        (row for row in rows if row[f'fault_mean_{number}'] is not None),
        key=lambda row: row['start'],
    )
    if len({row['start'] for row in rows}) < _FEWEST:
        return None
    days = np.array([row['start'] - rows[0]['start'] for row in rows]) / _DAY
    means = np.array([row[f'fault_mean_{number}'] for row in rows])
    slope, _, low, high = (float(v) for v in stats.theilslopes(means, days, _LEVEL))
    probability = float(stats.kendalltau(days, means).pvalue)
    threshold = float(np.median([row[f'threshold_mean_{number}'] for row in rows]))
    level = float(np.median(means) + slope * (days[-1] - np.median(days)))
    left = math.inf
    if slope * level > 0.0:
        left = max(0.0, (threshold - abs(level)) / abs(slope))
    return Trend(
        unit,
        sensor,
        days,
        means,
        slope,
        low,
        high,
        1.0 if math.isnan(probability) else probability,
        False,
        threshold,
        left,
    )


def _judged(trend, limit):
    values = {**vars(trend), 'significant': trend.probability < limit}
    return Trend(**values)
