"""Figures of a campaign: one number from one column of its rows."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv_campaign.execution.run_metrics import COUNTS, FLAGS, FLOATS
from lpv_campaign.plan.spec import NO_FAULT
from lpv_core.support.errors import ConfigError

DERIVED = ('missed', 'unstable')
"""Columns that are made here: 1 where a fault was not found, or the loop lost control."""
_SUMMARIES = {
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

    def __contains__(self, value):
        return isinstance(value, (int, float)) and self.low <= value <= self.high


@dataclass(frozen=True)
class Figure:
    """One figure of a campaign; small is good.

    Attributes
    ----------
    name : str
        How it is called.
    column : str
        Column of the results, or one of `DERIVED`.
    statistic : str
        One of `STATISTICS`, over the runs.
    where : dict of str to tuple or Span
        Runs that count: by column the values that it may have.
    weight : float
        Of the figure in the cost; 0: it is only watched.
    scale : float or None
        What counts as 1 in the cost; None: the figure of the first trial.
    at_most, at_most_ratio : float
        Largest value, as it is and over that of the first trial.
    """

    name: str
    column: str
    statistic: str = 'mean'
    where: dict = None
    weight: float = 0.0
    scale: float = None
    at_most: float = math.inf
    at_most_ratio: float = math.inf

    def values(self, rows: list[dict[str, Any]], length: float) -> np.ndarray:
        """The column over all runs.

        Parameters
        ----------
        rows : list of dict
            Results.
        length : float
            Length of a run [s]; a fault that is not found has a delay up to its end.

        Returns
        -------
        ndarray, shape (number of rows,)
            NaN where a run does not count.

        Raises
        ------
        ConfigError
            If none does.
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

    def summary(self, values):
        """The figure, from `values` or a part of them; NaN if nothing is left."""
        values = values[~np.isnan(values)]
        return float(_SUMMARIES[self.statistic](values)) if values.size else math.nan

    def _counts(self, row):
        return meets(row, self.where or {}, f'figures.{self.name}.where')


def meets(row: dict[str, Any], where: dict[str, tuple[Any, ...] | Span], name: str) -> bool:
    """Whether a run meets a condition.

    Parameters
    ----------
    row : dict
        Its results.
    where : dict of str to tuple or Span
        The condition.
    name : str
        Its name, for the message.

    Returns
    -------
    bool
        True if every column has one of its values.

    Raises
    ------
    ConfigError
        If there is no such column.
    """
    for column, wanted in where.items():
        if column not in row:
            raise ConfigError(name, f'there is no column {column!r}')
        if row[column] not in wanted:
            return False
    return True


def _value(row, column, length):
    faulty = row['kind'] not in (NO_FAULT, 'rate_bias')
    if column == 'missed':
        return float(not row['detected']) if faulty else math.nan
    if column == 'unstable':
        return float(not row['stable'])
    if column == 'detection_delay' and faulty and not row['detected']:
        left = length - row['fault.onset']
        return min(left, row['fault.duration']) if row['fault.duration'] > 0.0 else left
    return max(min(float(row[column]), BEYOND), -BEYOND)  # leaves NaN alone


def parse_figure(section, name: str) -> Figure:
    """Read a figure of a study file.

    Parameters
    ----------
    section : lpv_core.support.config.Section
        The figure's mapping.
    name : str
        Its name.

    Returns
    -------
    Figure
        Validated.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    known = (*FLOATS, *COUNTS, *FLAGS, *DERIVED)
    figure = Figure(
        name,
        section.text('column', choices=known),
        section.text('statistic', 'mean', STATISTICS),
        parse_where(section, section.plain('where')),
        section.number('weight', 0.0, low=0.0),
        *(
            section.number(key, above=above) if key in section else default
            for key, above, default in (
                ('scale', 0.0, None),
                ('at_most', None, math.inf),
                ('at_most_ratio', 0.0, math.inf),
            )
        ),
    )
    section.finish()
    return figure


def parse_where(section, data: dict[str, Any]) -> dict[str, tuple[Any, ...] | Span]:
    """Read a condition on runs.

    Parameters
    ----------
    section : lpv_core.support.config.Section
        For messages.
    data : dict
        By column a value, a list of values, or ``{low: ..., high: ...}``.

    Returns
    -------
    dict of str to tuple or Span
        The condition.

    Raises
    ------
    ConfigError
        Naming the column.
    """
    found = {}
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
