"""Estimates beside the best possible ones, in the runs that compared them."""

from typing import Any

import numpy as np

from lpv_campaign.limit.accuracy import ESTIMATORS, LIMITS
from lpv_campaign.plan.spec import NO_FAULT
from lpv_core.simulation.faults import KINDS

QUANTITIES = ('fault', 'angle')
OURS, BEST = 'ours', 'limit_within_priors'


def limit(results) -> list[dict[str, Any]]:
    """Root mean squares over all runs of a kind, by estimator and limit.

    The bound holds for the mean over runs, not for one run: squares are averaged, not ratios.

    Parameters
    ----------
    results : Results
        Rows.

    Returns
    -------
    list of dict
        For each quantity and kind of fault that was compared: ``quantity``, ``kind``, ``runs``,
        ``ratio`` (ours over the limit within priors) and ``rms`` [rad] by the names of
        `lpv_campaign.limit.accuracy`; None where no run has it.
    """
    return [
        entry
        for quantity in QUANTITIES
        for kind in (NO_FAULT, *KINDS)
        if (entry := _entry(results, quantity, kind))['runs']
    ]


def _entry(results, quantity, kind):
    ours = results.number(f'limit_{quantity}_{OURS}')
    chosen = (results.kind == kind) & np.isfinite(ours)
    rms = {
        name: _rms(results.number(f'limit_{quantity}_{name}')[chosen])
        for name in (*ESTIMATORS, *LIMITS)
    }
    ratio = rms[OURS] / rms[BEST] if rms[OURS] is not None and rms[BEST] else None
    return {
        'quantity': quantity,
        'kind': kind,
        'runs': int(chosen.sum()),
        'ratio': ratio,
        'rms': rms,
    }


def _rms(values):
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else None
