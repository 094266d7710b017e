"""The study file: what is searched, by which runs, figures and limits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv_campaign.plan.factors import Range, parse_factor
from lpv_campaign.plan.spec import NO_FAULT
from lpv_campaign.tune.metric import Figure, parse_figure, parse_where
from lpv_core.support.config import Section, read_yaml
from lpv_core.support.errors import ConfigError

MOST_TRIALS = 100_000
_OWN = ('arm', 'designs', 'name')
"""Fields of a campaign that the study sets."""


@dataclass(frozen=True)
class Limits:
    """What a trial must keep to."""

    healthy: tuple  # Conditions; in a run that meets one of them any alarm is false
    healthy_score: float  # Largest abs(fault estimate) / threshold without a fault
    pole_step: float  # Largest fastest pole of the observer times the sample time


@dataclass(frozen=True)
class Validation:
    """The second look, on other runs."""

    seed: int  # Of the campaign
    runs: int  # Of the campaign
    healthy_score: float  # As in `Limits`: more runs have a larger largest value
    # Share by which a figure may be beyond its limit: the optimum is at the limit itself
    slack: float
    resamples: int  # Of the bootstrap
    confidence: float  # Of its intervals
    # By how much of the first cost the picked one must be lower, with that confidence
    least_gain: float


@dataclass(frozen=True)
class Study:
    """A study file."""

    name: str  # Name
    seed: int  # Seed of the search
    trials: int  # How many designs are tried
    # Requirement file, or name of a shipped one: what is not searched, and the first trial
    requirement: str
    # Fields of the requirement (``observer.decay``) or of the diagnosis (``diagnosis.dwell``)
    search: dict
    # Campaign that evaluates trials; a factor for each searched field of the diagnosis
    campaign: dict
    figures: tuple[Figure, ...]  # What counts
    limits: Limits  # What must hold
    tolerance: float  # Costs so much above the lowest one, relatively, count as equal
    validation: Validation  # The second look
    data: dict  # Content of the file
    folder: str  # Where relative names of files count from


def load_study(path: str | Path) -> Study:
    """Read a study file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/tune.md``.

    Returns
    -------
    Study
        Validated as far as it can be without arm and requirement.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    data, source, folder = read_yaml(path), str(path), Path(path).resolve().parent
    top = Section(data, source)
    arm = top.text('arm')
    search = _search(top)
    limits = _limits(top.section('limits'), top.plain('healthy'))
    figures = _figures(top)
    study = Study(
        name=top.text('name'),
        seed=top.integer('seed', 1, low=0),
        trials=_trials(top),
        requirement=top.text('requirement', arm),
        search=search,
        campaign=_campaign(top, data, arm, search, folder),
        figures=figures,
        limits=limits,
        tolerance=top.number('tolerance', 0.0, 0.0, 1.0),
        validation=_validation(top.section('validation'), limits),
        data=data,
        folder=str(folder),
    )
    top.finish()
    if study.validation.seed == study.campaign.get('seed', 1):
        raise ConfigError('validation.seed', "must be another one than the campaign's", source)
    return study


def _trials(top: Section) -> int:
    trials = top.integer('trials', low=1)
    if trials > MOST_TRIALS:
        raise top.error('trials', f'must be at most {MOST_TRIALS}, got {trials}')
    return trials


def _search(top: Section) -> dict[str, Range]:
    found = {}
    for name, value in top.plain('search').items():
        field = f'search.{name}'
        part = parse_factor(value, field, 'study')
        if not isinstance(part, Range):
            raise ConfigError(field, 'must be a range: {low: ..., high: ...}')
        found[str(name)] = part
    if not found:
        raise top.error('search', 'names no field')
    return found


def _figures(top: Section) -> tuple[Figure, ...]:
    figures = tuple(
        parse_figure(Section(entry, 'study', f'figures.{name}'), str(name))
        for name, entry in top.plain('figures').items()
    )
    if not any(figure.weight > 0.0 for figure in figures):
        raise top.error('figures', 'needs one with a weight above 0')
    return figures


def _limits(section: Section, healthy: dict[str, Any]) -> Limits:
    conditions = tuple(
        parse_where(Section(where, 'study', f'healthy.{name}'), where)
        for name, where in healthy.items()
    ) or ({'kind': (NO_FAULT,)},)
    limits = Limits(
        conditions,
        section.number('healthy_score', 1.0, above=0.0),
        section.number('pole_step', 0.5, above=0.0),
    )
    section.finish()
    return limits


def _validation(section: Section, limits: Limits) -> Validation:
    validation = Validation(
        section.integer('seed', low=0),
        section.integer('runs', low=1),
        section.number('healthy_score', limits.healthy_score, above=0.0),
        section.number('slack', 0.0, 0.0, 1.0),
        section.integer('resamples', 2000, low=100),
        section.number('confidence', 0.95, 0.5, 0.999),
        section.number('least_gain', 0.02, 0.0, 1.0),
    )
    section.finish()
    return validation


def _campaign(
    top: Section, study: dict[str, Any], arm: str, search: dict[str, Range], folder: Path
) -> dict[str, Any]:
    """The campaign's mapping; every trial has the same factors, so that all draw the same runs."""
    if isinstance(study.get('campaign'), str):
        data = read_yaml(Path(folder) / top.text('campaign'))
    else:
        data = top.plain('campaign')
    section = Section(data, 'study', 'campaign')
    for name in _OWN:
        if name in data:
            raise section.error(name, 'is set by the study')
    plan = section.section('plan')
    if plan.text('method') == 'factorial':
        raise plan.error('method', 'must draw its runs, so that the validation can draw others')
    factors = section.plain('factors')
    for name in ('design', 'sample_time'):
        if name in factors:
            raise section.error(f'factors.{name}', 'is one, and set by the study')
    for name in search:
        if name.startswith('diagnosis.'):
            if name in factors:
                raise section.error(f'factors.{name}', 'is searched')
            factors[name] = 1.0  # of every trial its own
    return {**data, 'name': top.text('name'), 'arm': arm, 'designs': ['tried'], 'factors': factors}
