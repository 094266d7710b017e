"""The runs that deserve a look, each with the command that replays it into a bag."""

import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from lpv_campaign.report.statistics.results import Results, dose_of

_MOST = 10


def worst(results: Results, folder: str | Path) -> list[dict[str, Any]]:
    """Lists of single runs.

    Returns ``title``, ``figure`` (what the list is sorted by), ``unit``, ``runs``: at most ten,
    each with ``number``, ``kind``, ``sensor``, ``size`` (with unit, or empty), ``value``,
    ``stable`` and ``command``.
    """
    lost = _lost_tracking(results)
    missed, relative = _missed(results)
    delay = results.number('detection_delay')
    alarms = results.number('false_alarms')
    lists = (
        (
            'Largest tracking errors',
            'largest true tracking error',
            'rad',
            lost,
            np.ones(results.count, bool),
            results.number('tracking_max'),
        ),
        (
            'Undetected, largest faults',
            'size over the largest of its kind',
            '1',
            relative,
            missed,
            relative,
        ),
        ('Longest delays', 'detection delay', 's', delay, np.isfinite(delay), delay),
        ('Most false alarms', 'false alarms', '1', alarms, alarms > 0.0, alarms),
    )
    return [
        {
            'title': title,
            'figure': figure,
            'unit': unit,
            'runs': _list(results, folder, key, among, value),
        }
        for title, figure, unit, key, among, value in lists
    ]


def _lost_tracking(results: Results) -> np.ndarray:
    """Largest error; a run that ended in no number at all is the worst."""
    error = results.number('tracking_max')
    return np.where(np.isnan(error) & ~results.flag('stable'), math.inf, error)


def _missed(results: Results) -> tuple[np.ndarray, np.ndarray]:
    """Undetected faults, and their size over the largest of the kind; 1 where there are none."""
    relative = np.ones(results.count)
    for kind in results.kinds:
        mine, size = results.kind == kind, results.dose(kind)
        if np.isfinite(size[mine]).any():
            relative[mine] = (size / np.nanmax(size[mine]))[mine]
    return results.faulty & ~results.flag('detected'), relative


def _list(
    results: Results, folder: str | Path, key: np.ndarray, among: np.ndarray, value: np.ndarray
) -> list[dict[str, Any]]:
    order = np.lexsort((results.number('number'), -np.nan_to_num(key, posinf=math.inf)))
    chosen = [int(k) for k in order if among[k] and not np.isnan(key[k])][:_MOST]
    return [_run(results, folder, k, float(value[k])) for k in chosen]


def _run(results: Results, folder: str | Path, row: int, value: float) -> dict[str, Any]:
    number = int(results.number('number')[row])
    kind = str(results.kind[row])
    size, dose = results.dose(kind)[row], dose_of(kind)
    unit = '' if dose.unit in ('', '1') else f' {dose.unit}'
    return {
        'number': number,
        'kind': kind,
        'sensor': str(results.sensor[row]),
        'size': f'{size:.3g}{unit}' if np.isfinite(size) else '',
        'said': results.text('said_kind')[row],
        'value': value if math.isfinite(value) else None,
        'stable': bool(results.flag('stable')[row]),
        'command': '' if results.campaign.is_serial else command(folder, number),
    }


def command(folder: str | Path, number: int) -> str:
    """Command that replays a run into a bag."""
    bag = Path(folder) / 'bags' / f'run_{number}'
    return f'lpv campaign {shlex.quote(str(folder))} --run {number} --bag {shlex.quote(str(bag))}'
