"""What a trial costs, how far it is beyond the limits, and which one is picked."""

from collections.abc import Sequence
from typing import Any

from lpv_campaign.tune.metric import Figure
from lpv_campaign.tune.study_file import Study, Validation
from lpv_campaign.tune.trial import Outcome
from lpv_core.support.errors import ConfigError


def cost(figures: Sequence[Figure], values: dict[str, float], first: dict[str, float]) -> float:
    """Weighted mean of the figures, each over that of the first trial or over its scale."""
    total = weights = 0.0
    for figure in figures:
        if figure.weight == 0.0:
            continue
        scale = figure.scale or first[figure.name]
        if not scale > 0.0:
            raise ConfigError(
                f'figures.{figure.name}', f'is {scale:g} in the first trial: give it a scale'
            )
        total += figure.weight * values[figure.name] / scale
        weights += figure.weight
    return total / weights


def excesses(
    study: Study, outcome: Outcome, first: dict[str, float], validation: Validation | None = None
) -> dict[str, float]:
    """How far a trial is beyond each limit."""
    limit = (validation or study.limits).healthy_score
    share = 1.0 + (validation.slack if validation else 0.0)
    found = {
        'false_alarms': float(outcome.false_alarms),
        'healthy_score': outcome.healthy_score - limit,
    }
    for figure in study.figures:
        value = outcome.figures[figure.name]
        if figure.at_most < float('inf'):
            found[f'{figure.name} at_most'] = value - share * figure.at_most
        if figure.at_most_ratio < float('inf'):
            found[f'{figure.name} at_most_ratio'] = (
                value - share * figure.at_most_ratio * first[figure.name]
            )
    return found


def pick(trials: list[dict[str, Any]], tolerance: float) -> dict[str, Any] | None:
    """The trial that the study chooses.

    Of the trials that keep all limits, those whose cost is within the tolerance of the lowest
    are taken as equal; of these the one with the lowest score of healthy runs, the furthest
    from a false alarm, is picked.

    Returns None if no trial keeps all limits.
    """
    good = [trial for trial in trials if trial['state'] == 'good']
    if not good:
        return None
    lowest = min(trial['cost'] for trial in good)
    near = [trial for trial in good if trial['cost'] <= (1.0 + tolerance) * lowest]
    return min(near, key=lambda trial: (trial['healthy_score'], trial['number']))
