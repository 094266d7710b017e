"""Tracking with faults and without, and false alarms per hour."""

from typing import Any

import numpy as np

from lpv_campaign.plan.spec import NO_FAULT
from lpv_campaign.report.statistics.intervals import poisson_rate, share, spread
from lpv_campaign.report.statistics.results import Results

_COLUMNS = {
    'rms': 'tracking_rms',
    'rms_during': 'tracking_rms_during',
    'largest': 'tracking_max',
    'ratio': 'tracking_ratio',
}


def tracking(results: Results) -> list[dict[str, Any]]:
    """Tracking error by kind of fault and compensation mode.

    Returns ``kind``, ``compensation``, ``runs``, rate of ``stable`` ones, and of these spreads
    of ``rms``, ``rms_during``, ``largest`` [rad] and ``ratio`` (to the healthy twin).
    """
    modes, stable, entries = results.text('compensation'), results.flag('stable'), []
    healthy = [NO_FAULT] if (results.kind == NO_FAULT).any() else []
    for kind in [*healthy, *results.kinds]:
        for mode in dict.fromkeys(modes):
            chosen = (results.kind == kind) & (modes == mode)
            if not chosen.any():
                continue
            entries.append(
                {
                    'kind': kind,
                    'compensation': mode,
                    'runs': int(chosen.sum()),
                    'stable': share(stable, chosen),
                    **{
                        name: spread(results.number(column)[chosen & stable])
                        for name, column in _COLUMNS.items()
                    },
                }
            )
    return entries


def false_alarms(results: Results, chosen: np.ndarray | None = None) -> dict[str, Any]:
    """False alarms per hour of operation without a fault, with exact intervals.

    Returns as `poisson_rate`, of alarms of any sensor before the fault, after it, or without
    any; ``before`` and ``after``: the same of those before any fault, and of those after its
    end, where a fault that was not detected ends in a change; ``runs``: the rate of runs with
    any.
    """
    chosen = np.ones(results.count, bool) if chosen is None else chosen
    alarms = np.nan_to_num(results.number('false_alarms')[chosen])
    hours, early = results.healthy_hours[chosen].sum(), results.early_hours[chosen].sum()
    before = sum(
        np.nan_to_num(results.number(f'alarms_before_{i + 1}')[chosen]).sum()
        for i in range(len(results.sensors))
    )
    return {
        **poisson_rate(alarms.sum(), hours),
        'before': poisson_rate(before, early),
        'after': poisson_rate(max(alarms.sum() - before, 0.0), max(hours - early, 0.0)),
        'runs': share(alarms > 0.0),
    }


def wrong_alarms(results: Results) -> dict[str, Any]:
    """Rate of runs in which a healthy sensor raised an alarm while another one was faulty."""
    return share(results.number('wrong_alarms') > 0.0, results.faulty)
