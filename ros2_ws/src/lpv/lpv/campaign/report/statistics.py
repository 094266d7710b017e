"""Rows of results as columns of NumPy; rates, spreads and curves with 95 % intervals."""

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa
from scipy import stats

from lpv.campaign.plan.spec import BOTH, NO_FAULT
from lpv.core.simulation.faults import KINDS

LEVEL = 0.95
"""Confidence level of all intervals."""
_FEWEST_CASES = 10
"""Cases for a smallest size that is found: ten of ten are at least 74 % with 95 % confidence."""
_FEWEST_BAGS = 5
"""Bags of one arm from which a trend is looked for: each order of four is likelier than 5 %."""
_DAY = 86400e9  # [ns]
DOSES = {
    'bias': ('size', '{}'),
    'drift': ('rate', '{}/s'),
    'scale': ('relative size', '1'),
    'noise': ('standard deviation', '{}'),
    'spike': ('height', '{}'),
    'rate_bias': ('size', '{}/s'),
    'unknown': ('largest size', '{}'),
}
"""What ``fault_size`` is called, and its unit by that of the sensor, of the kinds that have one."""


class Results:
    """Rows of a campaign, or of a part of it; columns may be missing or empty."""

    def __init__(self, table: pa.Table, units: Mapping[str, str]) -> None:
        self.table, self.units, self.count = table, units, table.num_rows  # units by sensor
        self.sensors = tuple(units)
        self.kind, self.sensor = self.text('kind'), self.text('sensor')
        self.faulty = (self.kind != NO_FAULT) & (self.kind != '')

    def unit(self, sensor: str) -> str:
        """Unit of a sensor, of several those that occur."""
        return self.units.get(sensor) or ' or '.join(dict.fromkeys(self.units.values()))

    def number(self, name: str) -> np.ndarray:
        """A column of numbers, NaN where there is none; shape (count,)."""
        return np.array(self._values(name), float)

    def text(self, name: str, empty: str = '') -> np.ndarray:
        """A column of texts, ``empty`` where there is none; shape (count,)."""
        return np.array([empty if v is None else str(v) for v in self._values(name)], object)

    def _values(self, name: str) -> list[Any]:
        there = name in self.table.column_names
        return self.table[name].to_pylist() if there else [None] * self.count

    def flag(self, name: str) -> np.ndarray:
        """A column of truths, False where there is none; shape (count,)."""
        return np.nan_to_num(self.number(name)) > 0.0

    def each(self, name: str) -> np.ndarray:
        """A column of every sensor; shape (count, sensors)."""
        columns = [self.number(f'{name}_{i + 1}') for i in range(len(self.sensors))]
        return np.column_stack(columns)

    @property
    def kinds(self) -> list[str]:
        """Kinds of faults that occur, in the order in which they are documented."""
        present = set(self.kind[self.faulty])
        return [kind for kind in (*KINDS, 'unknown') if kind in present]

    @property
    def several(self) -> np.ndarray:
        """Rows in which several sensors are faulty; shape (count,)."""
        return np.array([name == BOTH or '+' in name for name in self.sensor], bool)


@lru_cache(maxsize=10_000)
def proportion(hits: int, cases: int) -> dict[str, Any]:
    """A rate with Wilson's interval; ``rate``, ``low``, ``high`` are None without cases."""
    if cases == 0:
        return {'hits': 0, 'cases': 0, 'rate': None, 'low': None, 'high': None}
    interval = stats.binomtest(hits, cases).proportion_ci(LEVEL, 'wilson')
    ends = {'low': float(interval.low), 'high': float(interval.high)}
    return {'hits': hits, 'cases': cases, 'rate': hits / cases, **ends}


def share(mask: np.ndarray, among: np.ndarray | None = None) -> dict[str, Any]:
    """Rate of a property, with its interval."""
    among = np.ones(len(mask), bool) if among is None else among
    return proportion(int(np.count_nonzero(mask & among)), int(np.count_nonzero(among)))


def poisson_rate(events: float, hours: float) -> dict[str, Any]:
    """Rate of events [1/h] with Garwood's exact interval, one-sided without events."""
    events, hours = int(events), float(hours)
    result = {'events': events, 'hours': hours, 'rate': None, 'low': None, 'high': None}
    if not hours > 0.0:
        return result
    tail = (1.0 - LEVEL) / 2.0
    low = float(stats.chi2.ppf(tail, 2 * events)) / 2.0 if events else 0.0
    high = float(stats.chi2.isf(tail if events else 2.0 * tail, 2 * events + 2)) / 2.0
    return {**result, 'rate': events / hours, 'low': low / hours, 'high': high / hours}


def spread(values: np.ndarray) -> dict[str, Any]:
    """``count``, ``median`` and the middle 90 % (``low``, ``high``) of what is finite."""
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    if not values.size:
        return {'count': 0, 'low': None, 'median': None, 'high': None}
    low, median, high = (float(v) for v in np.percentile(values, (5.0, 50.0, 95.0)))
    return {'count': int(values.size), 'low': low, 'median': median, 'high': high}


def found_from(sizes: np.ndarray, found: np.ndarray) -> float:
    """Smallest size from which on a share of the faults is detected; NaN if there is none."""
    order = np.argsort(-sizes, kind='stable')
    shares = np.cumsum(found[order]) / np.arange(1, len(order) + 1)
    # Faults of one size count together, whatever their order.
    last = np.append(np.diff(sizes[order]) != 0.0, True)[: len(order)]
    enough = np.flatnonzero((shares >= LEVEL) & last)
    is_known = len(order) >= _FEWEST_CASES and len(enough)
    return float(sizes[order][enough[-1]]) if is_known else math.nan


def trends(results: Results) -> list[dict[str, Any]]:
    """How estimates change from bag to bag: Theil-Sen slope a day, Kendall's probability."""
    units, start = results.text('unit'), results.number('start')
    means, thresholds = results.each('fault_mean'), results.each('threshold_mean')
    found = []
    for unit, (i, sensor) in product(sorted(set(units)), enumerate(results.sensors)):
        mine = np.flatnonzero((units == unit) & np.isfinite(means[:, i]))
        mine = mine[np.argsort(start[mine], kind='stable')]
        if len(set(start[mine])) < _FEWEST_BAGS:
            continue
        days, values = (start[mine] - start[mine[0]]) / _DAY, means[mine, i]
        slope, _, low, high = (float(v) for v in stats.theilslopes(values, days, LEVEL))
        chance = float(stats.kendalltau(days, values).pvalue)
        level = float(np.median(values) + slope * (days[-1] - np.median(days)))
        # A bag without a finite threshold has none to reach.
        threshold = np.nan_to_num(thresholds[mine, i], nan=math.inf)
        room = float(np.median(threshold)) - abs(level)
        found.append(
            {
                'unit': unit,
                'sensor': sensor,
                'position_unit': results.unit(sensor),
                'days': days.tolist(),
                'means': values.tolist(),
                'slope': slope,
                'interval': [low, high],
                'chance': 1.0 if math.isnan(chance) else chance,
                'days_left': max(0.0, room / abs(slope)) if slope * level > 0.0 else math.inf,
            }
        )
    for trend in found:
        trend['clear'] = trend['chance'] < (1.0 - LEVEL) / len(found)
    return sorted(found, key=lambda trend: trend['chance'])
