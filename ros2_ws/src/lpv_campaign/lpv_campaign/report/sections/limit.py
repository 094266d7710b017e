"""Estimates compared with the best possible ones, in the runs that compared them."""

from typing import Any

import numpy as np

from lpv_campaign.limit.accuracy import ESTIMATORS, LIMITS
from lpv_campaign.plan.spec import NO_FAULT
from lpv_campaign.report.statistics.results import Results
from lpv_core.simulation.faults import KINDS

QUANTITIES = ('fault', 'angle')
OURS, BEST = 'ours', 'limit_within_priors'


def limit(results: Results) -> list[dict[str, Any]]:
    """Root mean squares over all runs of a kind, by estimator and limit.

    The bound holds for the mean over runs, not for one run: squares are averaged, not ratios.

    Returns for each quantity and kind of fault that was compared: ``quantity``, ``kind``,
    ``runs``, ``ratio`` (ours over the limit within priors) and ``rms`` [rad] by the names of
    `lpv_campaign.limit.accuracy`; None where no run has it.
    """
    return [
        entry
        for quantity in QUANTITIES
        for kind in (NO_FAULT, *KINDS)
        if (entry := _entry(results, quantity, kind))['runs']
    ]


def _entry(results: Results, quantity: str, kind: str) -> dict[str, Any]:
    ours = results.number(f'limit_{quantity}_{OURS}')
    chosen = (results.kind == kind) & np.isfinite(ours)
    rms = {
        name: _rms(results.number(f'limit_{quantity}_{name}')[chosen])
        for name in (*ESTIMATORS, *LIMITS)
    }
    ours_rms, best = rms[OURS], rms[BEST]
    ratio = ours_rms / best if ours_rms is not None and best else None
    return {
        'quantity': quantity,
        'kind': kind,
        'runs': int(chosen.sum()),
        'ratio': ratio,
        'rms': rms,
    }


def _rms(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else None
