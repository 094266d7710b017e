"""Designs, compensation modes and other alternatives side by side."""

from typing import Any

import numpy as np

from lpv_campaign.report.sections.roc import area
from lpv_campaign.report.sections.tracking import false_alarms
from lpv_campaign.report.statistics.intervals import share, spread
from lpv_campaign.report.statistics.results import Results

_LEFT_OUT = ('fault.kind', 'fault.sensor')
_MOST = 12


def comparison(results: Results) -> list[dict[str, Any]]:
    """The main figures for each alternative.

    Returns one a factor of texts (or of a few numbers that tune design and diagnosis) with more
    than one value: ``factor``, and ``groups`` of ``value`` and its figures; errors are those of
    stable runs.
    """
    tables = [_table(results, name, results.text(name)) for name in _alternatives(results)]
    designs, modes = results.text('design'), results.text('compensation')
    if len(set(designs)) > 1 and len(set(modes)) > 1:
        both = np.array([f'{d}, {m}' for d, m in zip(designs, modes)], object)
        tables.append(_table(results, 'design, compensation', both))
    return tables


def _alternatives(results: Results) -> list[str]:
    names = [name for name in results.varied(numeric=False) if name not in _LEFT_OUT]
    names += [
        name
        for name in results.varied(numeric=True)
        if name.startswith('diagnosis.') or name == 'sample_time'
    ]
    return [name for name in names if 1 < len(set(results.text(name))) <= _MOST]


def _table(results: Results, name: str, values: np.ndarray) -> dict[str, Any]:
    groups = [
        {'value': value, **_figures(results, values == value)}
        for value in sorted(set(values), key=_by_size)
    ]
    return {'factor': name, 'groups': groups}


def _by_size(value: str) -> tuple[Any, ...]:
    try:
        return (0, float(value), value)
    except ValueError:
        return (1, 0.0, value)


def _figures(results: Results, chosen: np.ndarray) -> dict[str, Any]:
    faulty, stable = results.faulty & chosen, results.flag('stable')
    return {
        'runs': int(chosen.sum()),
        'detected': share(results.flag('detected'), faulty),
        'isolated': share(results.flag('isolated'), faulty),
        'delay': spread(results.number('detection_delay')[faulty]),
        'false_alarms': false_alarms(results, chosen),
        **_area(results, chosen),
        'estimate_rms': spread(results.number('fault_rms_during')[faulty & stable]),
        'tracking_rms': spread(results.number('tracking_rms')[chosen & stable]),
        'stable': share(stable, chosen),
    }


def _area(results: Results, chosen: np.ndarray) -> dict[str, Any]:
    """Area under the ROC curve of all kinds and both sensors."""
    positive, negative = [], []
    for i in range(len(results.sensors)):
        positive.append(results.number(f'score_during_{i + 1}')[results.of_sensor(i) & chosen])
        negative.append(results.number(f'score_before_{i + 1}')[chosen])
    faulty, healthy = np.concatenate(positive), np.concatenate(negative)
    return area(faulty[~np.isnan(faulty)], healthy[~np.isnan(healthy)])
