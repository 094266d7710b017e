"""Detection probability and delay against the size of the fault."""

from typing import Any

import numpy as np

from lpv_campaign.plan.spec import BOTH
from lpv_campaign.report.statistics.intervals import share, spread
from lpv_campaign.report.statistics.probability import detection_curve
from lpv_campaign.report.statistics.results import Results, dose_of

_CLASSES = 8
_LEVELS = 12
PROBABILITIES = (0.95, 0.99)
"""Of which the smallest size is given."""


def detection(results: Results) -> list[dict[str, Any]]:
    """Detection of each kind of fault by each sensor.

    Returns ``kind``, ``sensor`` (a name, or ``both`` for any two at once), rates ``detected`` and
    ``isolated``, spreads of ``delay`` and ``onset_error`` [s] and of ``size_error`` [rad],
    ``dose`` and ``unit``, ``classes`` of sizes, ``curve``, ``smallest`` size by probability, and
    ``cases``.
    """
    entries = []
    found, isolated = results.flag('detected'), results.flag('isolated')
    delay = results.number('detection_delay')
    for kind in results.kinds:
        size, dose = results.dose(kind), dose_of(kind)
        for sensor in (*results.sensors, BOTH):
            mine = results.several if sensor == BOTH else results.sensor == sensor
            chosen = (results.kind == kind) & mine
            if not chosen.any():
                continue
            entries.append(
                {
                    'kind': kind,
                    'sensor': sensor,
                    'detected': share(found, chosen),
                    'isolated': share(isolated, chosen),
                    'delay': spread(delay[chosen]),
                    'onset_error': spread(results.number('onset_error')[chosen]),
                    'size_error': spread(results.number('size_error')[chosen]),
                    'dose': dose.name,
                    'unit': dose.unit,
                    **_against_size(size[chosen], found[chosen], delay[chosen]),
                }
            )
    return entries


def _against_size(size: np.ndarray, found: np.ndarray, delay: np.ndarray) -> dict[str, Any]:
    known = np.isfinite(size)
    size, found, delay = size[known], found[known], delay[known]
    curve = detection_curve(size, found)
    return {
        'classes': [
            {
                'low': float(size[part].min()),
                'high': float(size[part].max()),
                'middle': float(np.median(size[part])),
                'detected': share(found[part]),
                'delay': spread(delay[part]),
            }
            for part in classes(size)
        ],
        'curve': None if curve is None else {'intercept': curve.intercept, 'slope': curve.slope},
        'smallest': {f'{p:.2f}': None if curve is None else curve.size(p) for p in PROBABILITIES},
        'cases': {
            'size': size.tolist(),
            'detected': found.tolist(),
            'delay': [float(d) if np.isfinite(d) else None for d in delay],
        },
    }


def classes(values: np.ndarray) -> list[np.ndarray]:
    """Classes of about equal numbers, or one a level where there are few levels."""
    levels = np.unique(values)
    if len(levels) <= _LEVELS:
        return [np.flatnonzero(values == level) for level in levels]
    order = np.argsort(values, kind='stable')
    return np.array_split(order, min(_CLASSES, len(order)))
