"""Statistics of a fleet: rates of alarms, bags to look at, trends of single arms."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
from scipy import stats

_LEVEL = 0.95
_FEWEST = 5
"""Bags of one arm from which a trend is looked for."""
_DAY = 86400e9


@dataclass(frozen=True)
class Rate:
    """Events per hour."""

    count: int  # Events
    hours: float  # Time under observation [h]
    low: float  # Lower limit of the rate of a Poisson process, exact, 95 % [1/h]
    high: float  # Upper limit [1/h]

    @property
    def value(self) -> float:
        """Estimate [1/h]; NaN without observation."""
        return self.count / self.hours if self.hours > 0.0 else math.nan


def rate(count: int, hours: float) -> Rate:
    """Rate with its exact interval."""
    if not hours > 0.0:
        return Rate(count, 0.0, 0.0, math.inf)
    tail = (1.0 - _LEVEL) / 2.0
    low = stats.chi2.ppf(tail, 2 * count) / 2.0 / hours if count else 0.0
    return Rate(count, hours, float(low), float(stats.chi2.isf(tail, 2 * count + 2) / 2.0 / hours))


@dataclass(frozen=True)
class Trend:
    """How the fault estimate of one sensor of one arm changes from bag to bag."""

    unit: str  # The arm
    sensor: int  # Index of the sensor
    days: np.ndarray  # (n,) Time of each bag since the first one [d]
    means: np.ndarray  # (n,) Its mean fault estimate [rad]
    slope: float  # Theil-Sen slope [rad/d]
    low: float  # Lower end of its 95 % interval [rad/d]
    high: float  # Upper end [rad/d]
    probability: float  # That independent values are so much in order (Kendall's tau)
    significant: bool  # Whether that is less than 5 % over all trends together (Bonferroni)
    threshold: float  # Median of the bags' mean thresholds [rad]
    # Time from the last bag on after which the estimate reaches the mean threshold [d]; infinite
    # where it does not grow
    days_left: float


@dataclass(frozen=True)
class FleetStatistics:
    """Statistics of an archive."""

    bags: int  # All bags
    failed: int  # Bags that could not be read
    hours: float  # Time under observation [h]
    alarms: dict  # Alarms by sensor, and ``all``
    kinds: dict  # Alarms by sensor and kind
    false_alarms: Rate  # Alarms without a fault, of bags where that is known
    detected: int  # Faulty bags in which the fault was found on all its sensors
    faulty: int  # Bags with a true fault
    ranking: list  # Rows of all bags that could be read, the most suspicious first
    failures: list  # Rows of those that could not
    trends: list  # The least probable first


def fleet_statistics(
    table: pa.Table, sensor_names: Sequence[str], healthy: bool = False
) -> FleetStatistics:
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
    failures = [row for row in rows if row['error']]
    faulty = [row for row in _with_truth(good) if row['kind'] != 'none']
    return FleetStatistics(
        bags=len(rows),
        failed=len(failures),
        hours=_hours(good),
        alarms=_alarm_rates(good, sensor_names),
        kinds=_alarm_kinds(good),
        false_alarms=_false_alarms(good, healthy),
        detected=sum(bool(row['detected']) for row in faulty),
        faulty=len(faulty),
        ranking=sorted(good, key=suspicion, reverse=True),
        failures=failures,
        trends=trends(good),
    )


def _alarm_rates(rows: list[dict[str, Any]], sensor_names: Sequence[str]) -> dict[str, Rate]:
    columns = {name: f'alarms_{i}' for i, name in enumerate(sensor_names, start=1)}
    return {
        name: rate(sum(row[column] for row in rows), _hours(rows))
        for name, column in {**columns, 'all': 'alarms'}.items()
    }


def _alarm_kinds(rows: list[dict[str, Any]]) -> dict[tuple[str, str], int]:
    kinds: Counter[tuple[str, str]] = Counter()
    for row in rows:
        for alarm in row['alarm_list']:
            kinds[alarm['sensor'], alarm['kind']] += alarm['count']
    return dict(kinds)


def _with_truth(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row['false_alarms'] is not None]


def _false_alarms(rows: list[dict[str, Any]], healthy: bool) -> Rate:
    """Of bags with truth; with ``healthy``, all alarms of the others are false as well."""
    known = _with_truth(rows)
    assumed = [row for row in rows if healthy and row['false_alarms'] is None]
    count = sum(row['false_alarms'] for row in known) + sum(row['alarms'] for row in assumed)
    return rate(count, _hours(known) + _hours(assumed))


def _hours(rows: list[dict[str, Any]]) -> float:
    return sum(row['observed'] for row in rows) / 3600.0


def suspicion(row: dict[str, Any]) -> tuple[Any, ...]:
    """What bags are sorted by: alarms first, then contradictions, then how near a threshold."""
    share = row['inconsistent_time'] / row['observed'] if row['observed'] else 0.0
    return row['alarms'] > 0, share > 0.01, max(row['score_1'], row['score_2']), row['bag']


def trends(rows: list[dict[str, Any]]) -> list[Trend]:
    """Trends of all arms that have bags enough."""
    units: dict[str, list[dict[str, Any]]] = {}
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
        (replace(trend, significant=trend.probability < limit) for trend in found),
        key=lambda trend: (trend.probability, trend.unit, trend.sensor),
    )


def _trend(unit: str, sensor: int, rows: list[dict[str, Any]]) -> Trend | None:
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
