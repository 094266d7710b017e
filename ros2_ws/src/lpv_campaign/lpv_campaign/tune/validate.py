"""Validation: picked and first design on other runs, pair by pair."""

from typing import Any

import numpy as np

from lpv_campaign.tune.cost import cost, excesses
from lpv_campaign.tune.study_file import Study
from lpv_campaign.tune.trial import Bench
from lpv_core.certificate.gains import Gains


def validate(bench: Bench, gains: Gains, values: dict[str, float], first: Gains) -> dict[str, Any]:
    """Compare two designs on the runs of the validation.

    Both see the same paths, arms, noise and faults; the intervals are percentiles of a
    bootstrap over the runs, which are drawn together with what both designs made of them.

    Returns ``accepted``, ``reason``, ``cost`` and ``figures`` with ``first``, ``picked``,
    ``difference`` and its ``interval``, and the limits.
    """
    study, wanted = bench.study, bench.study.validation
    plan = {'seed': wanted.seed, 'runs': wanted.runs}
    rows = {'first': bench.rows(first, bench.base, plan), 'picked': bench.rows(gains, values, plan)}
    outcomes = {name: bench.measure(found) for name, found in rows.items()}
    over = excesses(study, outcomes['picked'], outcomes['first'].figures, wanted)
    columns = {
        name: {f.name: f.values(found, bench.length) for f in study.figures}
        for name, found in rows.items()
    }
    result = {
        'runs': wanted.runs,
        'seed': wanted.seed,
        'confidence': wanted.confidence,
        'resamples': wanted.resamples,
        'least_gain': wanted.least_gain,
        **_compare(study, columns),
    }
    for name in ('healthy_score', 'false_alarms'):
        result[name] = {which: getattr(found, name) for which, found in outcomes.items()}
    broken = [f'{name} by {excess:.3g}' for name, excess in over.items() if excess > 0.0]
    result['reason'] = ''
    if broken:
        result['reason'] = 'beyond the limits: ' + ', '.join(broken)
    elif not result['cost']['interval'][1] < -wanted.least_gain * result['cost']['first']:
        result['reason'] = (
            f'the cost is not lower by {wanted.least_gain:.3g} of what it was with '
            f'{wanted.confidence:.3g} confidence'
        )
    result['accepted'] = not result['reason']
    return result


def _compare(study: Study, columns: dict[str, Any]) -> dict[str, Any]:
    wanted = study.validation
    rng = np.random.default_rng([study.seed, wanted.seed])
    names = [f.name for f in study.figures]

    def summaries(chosen: Any) -> dict[str, dict[str, float]]:
        return {
            which: {f.name: f.summary(found[f.name][chosen]) for f in study.figures}
            for which, found in columns.items()
        }

    def costs(found: dict[str, dict[str, float]]) -> dict[str, float]:
        return {which: cost(study.figures, found[which], whole['first']) for which in found}

    whole = summaries(slice(None))
    differences: dict[str, list[float]] = {name: [] for name in ('cost', *names)}
    for _ in range(wanted.resamples):
        found = summaries(rng.integers(wanted.runs, size=wanted.runs))
        price = costs(found)
        differences['cost'].append(price['picked'] - price['first'])
        for name in names:
            differences[name].append(found['picked'][name] - found['first'][name])
    return {
        'cost': _entry(costs(whole), differences['cost'], wanted.confidence),
        'figures': {
            name: _entry(
                {which: whole[which][name] for which in whole}, differences[name], wanted.confidence
            )
            for name in names
        },
    }


def _entry(pair: dict[str, float], differences: list[float], confidence: float) -> dict[str, Any]:
    tail = 50.0 * (1.0 - confidence)
    # A resample may hold no run that counts for a figure.
    known = np.array(differences)[np.isfinite(differences)]
    return {
        **pair,
        'difference': pair['picked'] - pair['first'],
        'interval': np.percentile(known, [tail, 100.0 - tail]).tolist(),
    }
