"""Figures of a campaign: one number from one column of its rows."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv_campaign.execution.run_metrics import COUNTS, FLAGS, FLOATS
from lpv_campaign.plan.spec import NO_FAULT
from lpv_core.support.config import Section
from lpv_core.support.errors import ConfigError

DERIVED = ('missed', 'unstable')
"""Columns that are made here: 1 where a fault was not found, or the loop lost control."""
_SUMMARIES: dict[str, Callable[..., Any]] = {
    'mean': np.mean,
    'median': np.median,
    'geometric_mean': lambda v: np.exp(np.mean(np.log(np.maximum(v, 1e-12)))),
    'rms': lambda v: np.sqrt(np.mean(np.square(v))),
    'percentile_95': lambda v: np.percentile(v, 95.0),
    'largest': np.max,
}
STATISTICS = tuple(_SUMMARIES)
BEYOND = 1e6
"""In place of infinity, where a loop ran away: it must count, and be written as JSON."""


@dataclass(frozen=True)
class Span:
    """Numbers from ``low`` to ``high``."""

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        return isinstance(value, (int, float)) and self.low <= value <= self.high


@dataclass(frozen=True)
class Figure:
    """One figure of a campaign; small is good."""

    name: str  # How it is called
    column: str  # Column of the results, or one of `DERIVED`
    statistic: str = 'mean'  # One of `STATISTICS`, over the runs
    where: dict[str, Any] | None = None  # Runs that count: by column the values that it may have
    weight: float = 0.0  # Of the figure in the cost; 0: it is only watched
    scale: float | None = None  # What counts as 1 in the cost; None: the figure of the first trial
    at_most: float = math.inf  # Largest value
    at_most_ratio: float = math.inf  # Largest value over that of the first trial

    def values(self, rows: list[dict[str, Any]], length: float) -> np.ndarray:
        """The column over all runs.

        Returns ndarray of shape (number of rows,): NaN where a run does not count.
        """
        found = np.array(
            [_value(row, self.column, length) if self._counts(row) else math.nan for row in rows],
            float,
        )
        if np.isnan(found).all():
            raise ConfigError(
                f'figures.{self.name}',
                f'no run of the campaign has a {self.column}' + (' there' if self.where else ''),
            )
        return found

    def summary(self, values: np.ndarray) -> float:
        """The figure, from `values` or a part of them; NaN if nothing is left."""
        values = values[~np.isnan(values)]
        return float(_SUMMARIES[self.statistic](values)) if values.size else math.nan

    def _counts(self, row: dict[str, Any]) -> bool:
        return meets(row, self.where or {}, f'figures.{self.name}.where')


def meets(row: dict[str, Any], where: dict[str, tuple[Any, ...] | Span], name: str) -> bool:
    """Whether a run meets a condition."""
    for column, wanted in where.items():
        if column not in row:
            raise ConfigError(name, f'there is no column {column!r}')
        if row[column] not in wanted:
            return False
    return True


def _value(row: dict[str, Any], column: str, length: float) -> float:
    faulty = row['kind'] not in (NO_FAULT, 'rate_bias')
    if column == 'missed':
        return float(not row['detected']) if faulty else math.nan
    if column == 'unstable':
        return float(not row['stable'])
    if column == 'detection_delay' and faulty and not row['detected']:
        left = length - row['fault.onset']
        return min(left, row['fault.duration']) if row['fault.duration'] > 0.0 else left
    return max(min(float(row[column]), BEYOND), -BEYOND)  # leaves NaN alone


def parse_figure(section: Section, name: str) -> Figure:
    """Read a figure of a study file."""
    known = (*FLOATS, *COUNTS, *FLAGS, *DERIVED)
    figure = Figure(
        name,
        section.text('column', choices=known),
        section.text('statistic', 'mean', STATISTICS),
        parse_where(section, section.plain('where')),
        section.number('weight', 0.0, low=0.0),
        section.number('scale', above=0.0) if 'scale' in section else None,
        section.number('at_most') if 'at_most' in section else math.inf,
        section.number('at_most_ratio', above=0.0) if 'at_most_ratio' in section else math.inf,
    )
    section.finish()
    return figure


def parse_where(section: Section, data: dict[str, Any]) -> dict[str, tuple[Any, ...] | Span]:
    """Read a condition on runs."""
    found: dict[str, tuple[Any, ...] | Span] = {}
    for name, wanted in data.items():
        if isinstance(wanted, dict):
            low, high = (
                wanted.get(key, default)
                for key, default in (('low', -math.inf), ('high', math.inf))
            )
            numbers = all(
                isinstance(v, (int, float)) and not isinstance(v, bool) for v in (low, high)
            )
            if set(wanted) - {'low', 'high'} or not numbers or not low <= high:
                raise section.error(
                    name, 'must be a value, a list, or a range {low: ..., high: ...}'
                )
            found[str(name)] = Span(low, high)
        else:
            found[str(name)] = tuple(wanted) if isinstance(wanted, list) else (wanted,)
    return found
