"""The search: trials that Optuna asks for, one after the other, kept on disk."""

import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import TrialState
from sqlalchemy.exc import SQLAlchemyError

from lpv_campaign.plan.factors import Range
from lpv_campaign.tune.cost import cost, excesses
from lpv_campaign.tune.study_file import Study
from lpv_campaign.tune.trial import Bench, Outcome
from lpv_core.support.errors import ConfigError

_STARTUP = 16
"""Trials at random before the search models anything."""
_DIGITS = 3
"""Significant digits of tried values: requirement files are read by users."""
_STREAM = 1_000_003
_DONE = (TrialState.COMPLETE, TrialState.PRUNED)


class Search:
    """A study of Optuna's in a folder; it resumes where it stopped.

    Every trial has a random generator of its own, seeded by the study's seed and the number of
    trials before it: a study that was interrupted gives the trials that it would have given.

    Parameters
    ----------
    study : Study
        The study file.
    key : str
        Hash of everything that makes the figures.
    path : pathlib.Path
        SQLite file.

    Raises
    ------
    ConfigError
        If the file is another study's, or cannot be read.
    """

    def __init__(self, study: Study, key: str, path: Path) -> None:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._study = study
        try:
            storage = optuna.storages.RDBStorage(f'sqlite:///{path}')
            self._found = optuna.create_study(
                study_name='tune',
                storage=storage,
                directions=('minimize', 'minimize'),
                load_if_exists=True,
            )
            known = self._found.user_attrs.get('key', key)
            self._found.set_user_attr('key', known)
        except (SQLAlchemyError, optuna.exceptions.OptunaError, RuntimeError) as error:
            text = str(error).split('\n')[0]
            raise ConfigError(
                'study', f'cannot be read ({text}); remove the file to start again', str(path)
            ) from error
        if known != key:
            raise ConfigError(
                '--out',
                'holds another study (file, arm, campaign or software '
                'changed): take another folder, or remove it',
                str(path),
            )
        for trial in self._found.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            self._found.tell(trial.number, state=TrialState.FAIL)  # a crash left it behind

    @property
    def trials(self) -> list[dict[str, Any]]:
        """Finished trials in their order, each a dict as `study.json` has them."""
        return [
            {'number': number, **trial.user_attrs} for number, trial in enumerate(self._finished())
        ]

    def _finished(self) -> list[Any]:
        return self._found.get_trials(deepcopy=False, states=_DONE)

    @property
    def front(self) -> list[int]:
        """Numbers of the trials that no other one beats in both respects, limits kept."""
        if not any(trial.state == TrialState.COMPLETE for trial in self._finished()):
            return []
        best = {trial.number for trial in self._found.best_trials}
        return [number for number, trial in enumerate(self._finished()) if trial.number in best]

    @property
    def importance(self) -> dict[str, float]:
        """Share of each searched field in the cost's variation, by PED-ANOVA; empty if too few."""
        if len([t for t in self._finished() if t.state == TrialState.COMPLETE]) < 4:
            return {}
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # the lowest costs are what is meant
            found = optuna.importance.get_param_importances(
                self._found, target=lambda trial: trial.values[0]
            )
        return {name: found.get(name, 0.0) for name in self._study.search}

    def step(self, bench: Bench) -> dict[str, Any]:
        """Run one more trial."""
        number = len(self._finished())
        self._found.sampler = optuna.samplers.TPESampler(
            seed=(self._study.seed * _STREAM + number) % 2**32, n_startup_trials=_STARTUP
        )
        if number == 0:
            self._found.enqueue_trial(bench.base)
        trial = self._found.ask()
        asked = {
            name: trial.suggest_float(name, part.low, part.high, log=part.logarithmic)
            for name, part in self._study.search.items()
        }
        values = (
            bench.base
            if number == 0
            else {name: _rounded(value, self._study.search[name]) for name, value in asked.items()}
        )
        self._keep(trial, values, bench.outcome(values))
        return self.trials[-1]

    def _keep(self, trial: Any, values: dict[str, float], outcome: Outcome) -> None:
        entry: dict[str, Any] = {'values': values, 'state': 'infeasible', 'reason': outcome.reason}
        if outcome.reason:
            trial.set_constraint('certified', 1.0)
        else:
            figures = asdict(outcome)
            first = next(
                (t['figures'] for t in self.trials if t['state'] != 'infeasible'), outcome.figures
            )
            price = cost(self._study.figures, outcome.figures, first)
            over = excesses(self._study, outcome, first)
            for name, excess in over.items():
                trial.set_constraint(name, excess)
            violated = [name for name, excess in over.items() if excess > 0.0]
            entry = {
                'values': values,
                'state': 'beyond limits' if violated else 'good',
                'violated': violated,
                'cost': price,
                'figures': figures['figures'],
                'healthy_score': outcome.healthy_score,
                'false_alarms': outcome.false_alarms,
            }
        for name, value in entry.items():
            trial.set_user_attr(name, value)
        if outcome.reason:
            self._found.tell(trial, state=TrialState.PRUNED)
        else:
            self._found.tell(trial, (entry['cost'], outcome.healthy_score))


def _rounded(value: float, part: Range) -> float:
    return min(max(float(f'{value:.{_DIGITS}g}'), part.low), part.high)
