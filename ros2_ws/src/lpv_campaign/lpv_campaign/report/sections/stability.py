"""Where in the space of the factors the loop stays stable."""

import math
from itertools import combinations
from typing import Any

import numpy as np

from lpv_campaign.plan.factors import Range
from lpv_campaign.report.statistics.intervals import share
from lpv_campaign.report.statistics.results import Results

_CELLS, _FEWEST_CELLS = 8, 2
_RUNS_PER_CELL = 5
"""Mean number of runs in a cell of a map; cells of single runs would say nothing."""
_LEVELS = 10
_MOST_FACTORS = 4
_FEWEST_RUNS = _RUNS_PER_CELL * _FEWEST_CELLS**2
"""From which maps are drawn."""
_LEAST_RUNS = 5
_FIRST = ('payload', 'friction', 'mass_1', 'mass_2', 'command_delay', 'sample_loss', 'sample_time')
"""Preferred where no factor makes a difference."""


def stability(results: Results) -> dict[str, Any]:
    """Rate of stable runs over single factors and over pairs of them.

    Returns ``stable``, ``going``: rates over all runs; ``unstable``, ``safe_stops`` (events),
    ``stopped`` (runs with any): counts; ``factors``: by decreasing ``effect`` (difference
    between best and worst class), with ``classes``; ``maps``: pairs of the most relevant
    factors, with ``x`` and ``y`` axes (``edges`` or ``levels``) and ``cells``, rows along y; in
    ``going``, the same for runs that are stable without a safe stop, which saves an arm and
    ends its work.
    """
    stable = results.flag('stable')
    stops = np.nan_to_num(results.number('safe_stops'))
    going = stable & (stops == 0.0)
    axes = [
        axis for name in results.varied(numeric=True) if (axis := _axis(results, name)) is not None
    ]
    factors = sorted((_effect(axis, stable) for axis in axes), key=_relevance)
    # A map of one colour says nothing, and neither do cells of a run or two.
    most = _MOST_FACTORS if not going.all() and results.count >= _FEWEST_RUNS else 0
    chosen = [f['name'] for f in factors[:most]]
    pairs = combinations([a for name in chosen for a in axes if a['name'] == name], 2)
    return {
        'stable': share(stable),
        'going': share(going),
        'unstable': int((~stable).sum()),
        'safe_stops': int(stops.sum()),
        'stopped': int((stops > 0.0).sum()),
        'factors': factors,
        'maps': [{**_map(x, y, stable), 'going': _map(x, y, going)['cells']} for x, y in pairs],
    }


def _relevance(factor: Any) -> Any:
    name = factor['name']
    place = _FIRST.index(name) if name in _FIRST else len(_FIRST)
    return -(factor['effect'] or 0.0), name.startswith('fault.'), place


def _axis(results: Results, name: str) -> dict[str, Any] | None:
    """Classes of one factor: its levels, or cells of equal width; logarithmic as it was drawn."""
    values = results.number(name)
    known = np.isfinite(values)
    levels = np.unique(values[known])
    if len(levels) < 2:
        return None
    axis = {'name': name, 'levels': None, 'edges': None, 'logarithmic': False}
    if len(levels) <= _LEVELS and len(levels) < results.count:
        place = np.searchsorted(levels, np.where(known, values, levels[0]))
        axis.update(levels=levels.tolist())
    else:
        factor = results.campaign.spec.factors[name]
        logarithmic = isinstance(factor, Range) and factor.logarithmic
        low, high = (factor.low, factor.high) if isinstance(factor, Range) else levels[[0, -1]]
        cells = int(np.clip(math.isqrt(results.count // _RUNS_PER_CELL), _FEWEST_CELLS, _CELLS))
        edges = (np.geomspace if logarithmic else np.linspace)(low, high, cells + 1)
        place = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, cells - 1)
        axis.update(edges=edges.tolist(), logarithmic=logarithmic)
    return {**axis, 'place': np.where(known, place, -1)}


def size_of(axis: dict[str, Any]) -> int:
    """Number of classes of an axis of a map."""
    return len(axis['levels']) if axis['levels'] is not None else len(axis['edges']) - 1


def _effect(axis: dict[str, Any], stable: np.ndarray) -> dict[str, Any]:
    """Difference that a factor makes between its best and its worst class."""
    cells = [share(stable, axis['place'] == k) for k in range(size_of(axis))]
    rates = [cell['rate'] for cell in cells if cell['cases'] >= _LEAST_RUNS]
    return {**_public(axis), 'classes': cells, 'effect': max(rates) - min(rates) if rates else None}


def _map(x: dict[str, Any], y: dict[str, Any], stable: np.ndarray) -> dict[str, Any]:
    return {
        'x': _public(x),
        'y': _public(y),
        'cells': [
            [
                share(stable, (x['place'] == column) & (y['place'] == row))
                for column in range(size_of(x))
            ]
            for row in range(size_of(y))
        ],
    }


def _public(axis: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in axis.items() if name != 'place'}
