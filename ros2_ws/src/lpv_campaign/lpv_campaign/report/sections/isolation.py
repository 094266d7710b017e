"""Confusion matrices: what was wrong, and what the diagnosis said."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_campaign.plan.spec import BOTH, NO_FAULT
from lpv_campaign.report.statistics.intervals import proportion
from lpv_campaign.report.statistics.results import Results
from lpv_core.simulation.faults import KINDS

_SAID = (NO_FAULT, *KINDS, 'unclassified', 'inconsistent')


def isolation(results: Results) -> dict[str, Any]:
    """Confusion of kinds and of sensors.

    Runs without a fault are a row of their own, with false alarms as what was said.

    Returns ``kinds`` and ``sensors``: as `confusion`; ``healthy``: runs without a fault, and
    those of them ``with_alarm``.
    """
    faulty = results.faulty
    kind, said_kind = results.kind[faulty], results.text('said_kind', NO_FAULT)[faulty]
    sensor, said_sensor = results.sensor[faulty], results.text('said_sensor', NO_FAULT)[faulty]
    alarmed = results.number('false_alarms')[~faulty] > 0
    return {
        'kinds': confusion(kind, said_kind, KINDS, _SAID),
        'sensors': confusion(
            sensor, said_sensor, (*results.sensors, BOTH), (NO_FAULT, *results.sensors, BOTH)
        ),
        'healthy': proportion(int(alarmed.sum()), len(alarmed)),
    }


def confusion(
    truth: np.ndarray, said: np.ndarray, truths: Sequence[str], answers: Sequence[str]
) -> dict[str, Any]:
    """Count what was said of what.

    Returns ``rows``, ``columns``, ``counts`` and ``rates`` (of each row), and rates with
    intervals of each row: ``right`` answers among all, and ``right_if_said``, among those that
    are not none.
    """
    rows, columns = _occurring(truth, truths), _occurring(said, (*truths, *answers))
    counts = [
        [int(np.count_nonzero((truth == row) & (said == column))) for column in columns]
        for row in rows
    ]
    totals = [sum(line) for line in counts]
    right = [line[columns.index(row)] if row in columns else 0 for row, line in zip(rows, counts)]
    silent = [line[columns.index(NO_FAULT)] if NO_FAULT in columns else 0 for line in counts]
    return {
        'rows': rows,
        'columns': columns,
        'counts': counts,
        'rates': [[count / total for count in line] for line, total in zip(counts, totals)],
        'right': [proportion(*pair) for pair in zip(right, totals)],
        'right_if_said': [
            proportion(r, total - none) for r, total, none in zip(right, totals, silent)
        ],
    }


def _occurring(values: np.ndarray, order: Sequence[str]) -> list[str]:
    present = set(values)
    known = [name for name in dict.fromkeys(order) if name in present]
    return known + sorted(present - set(known))
