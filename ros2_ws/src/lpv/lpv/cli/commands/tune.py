"""``lpv tune``: search the weights of a design by campaigns of runs, with Optuna."""

import argparse
import contextlib
import copy
import json
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.trial import TrialState
from rich.console import Console
from scipy import stats

from lpv.campaign.execution.execute import chunks_of, worker_pool
from lpv.campaign.plan.campaign import load_campaign
from lpv.campaign.plan.spec import NO_FAULT, TUNING
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.support.config import read_yaml, sha256_of, write_parameters, write_yaml
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import LARGEST
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import Gains, load_gains
from lpv.report.table import print_grid
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement, parse_requirement
from lpv_design.solve import InfeasibleError

COSTS = {
    'detection_delay': 2.0, 'missed': 1.0, 'unstable': 1.0, 'fault_rms_before': 0.5,
    'fault_rms_during': 0.5, 'tracking_rms_during': 0.5,
}  # fmt: skip
"""Weights of the figures that a cost is made of, unless --cost says otherwise."""
_RATES, _LEAST_RATE = ('missed', 'unstable', 'wrong_alarms', 'false_alarms'), 0.05
"""Figures that may be zero before the search, and what they count over then."""
_TOLERANCE, _RESAMPLES = 0.02, 2000
"""Share of the cost that a change has to gain; resamples, 50 of which are beyond an end of 95 %."""
_DIAGNOSIS = {'diagnosis.sigmas': 3.0, 'diagnosis.hours_between_false_alarms': 1.0}
"""Least values: below its bound a threshold means nothing, whatever a campaign says."""


class _Bench:
    """Designs by given values, and runs them on the campaign."""

    def __init__(self, arguments: argparse.Namespace, execute: Callable[..., Any]) -> None:
        path, self.campaign = load_campaign(arguments.campaign, designed=False)
        self.name, self._execute, self.arm = path.stem, execute, self.campaign.arm
        self._designed: dict[tuple[Any, ...], Gains] = {}
        if not self.campaign.designed:
            raise ConfigError('arm', f'{self.arm.name} has no lpv region: no design to tune')
        if len(self.campaign.spec.designs) > 1 or 'sample_time' in self.campaign.spec.factors:
            raise ConfigError('designs', 'must be one, at one sample time')
        first = self.campaign.spec.designs[0]
        self._requirement = load_requirement(bringup_file('requirements', first, path.parent))
        self._data = read_yaml(self._requirement.source)
        parts = {'observer': self._requirement.observer,
                 'controller': self._requirement.controller,
                 'diagnosis': DiagnosisParameters()}  # fmt: skip
        # Of each number the part, the field, its value, and places where that has several.
        self._known: dict[str, tuple[str, str, Any, list[int]]] = {}
        for part, of in parts.items():
            for field, value in vars(of).items():
                several = isinstance(value, tuple)
                if isinstance(value, float) or (several and len({*value}) == 1):  # one for all
                    places = [*range(len(value))] if several else []
                    self._known[f'{part}.{field}'] = part, field, value, places
                for k in range(len(value)) if several else ():
                    self._known[f'{part}.{field}[{k}]'] = part, field, value, [k]
        self.ranges = dict(self._range(text) for text in arguments.search)
        self.base = {}
        for name, (low, high) in self.ranges.items():
            if name not in self._known:
                raise ConfigError(f'--search {name}', f'is no number of {", ".join(self._known)}')
            _, _, value, places = self._known[name]
            self.base[name] = value[places[0]] if places else value
            if not low <= self.base[name] <= high:
                reason = f'must hold {self.base[name]:g}, as it is now'
                raise ConfigError(f'--search {name}', reason)
        self.weights = dict(map(_weight, arguments.cost)) if arguments.cost else COSTS

    def _range(self, text: str) -> tuple[str, tuple[float, float]]:
        name, _, ends = text.partition('=')
        try:
            low, high = (float(end) for end in ends.split(':'))
        except ValueError:
            raise ConfigError('--search', f'must be FIELD=LOW:HIGH, got {text!r}') from None
        least, most = TUNING.get(name, (0.0, LARGEST))
        least = max(least, _DIAGNOSIS.get(name, 0.0))
        if not (least <= low < high <= most and low > 0.0):
            reason = f'must have ends from {least:g} to {most:g}, low < high'
            raise ConfigError(f'--search {name}', reason)
        return name, (low, high)

    def content(self, values: dict[str, float]) -> dict[str, Any]:
        """Content of the requirement file with given values."""
        data = copy.deepcopy(self._data)
        for name, value in values.items():
            part, field, old, places = self._known[name]
            if places:
                now = data[part].get(field)
                now = now if isinstance(now, list) else old  # one number stands for all
                data[part][field] = [value if k in places else v for k, v in enumerate(now)]
            elif part != 'diagnosis':
                data[part][field] = value
        return data

    def gains(self, values: dict[str, float]) -> Gains:
        """Certified gains; InfeasibleError or ConfigError where there are none."""
        key = tuple(values.items())
        if key not in self._designed:
            gains = design(self.arm, parse_requirement(self.content(values), self.name)).gains
            gains.require(self.arm, self.name)
            self._designed[key] = gains
        return self._designed[key]

    def rows(self, values: dict[str, float], seed: int | None = None) -> list[dict[str, Any]]:
        """Results of all runs with given values: the same paths, noise and faults for each."""
        spec = self.campaign.content['spec']
        tuning = {name: value for name, value in values.items() if name.startswith('diagnosis.')}
        seed, factors = self.campaign.spec.seed if seed is None else seed, spec.get('factors', {})
        changes = {'factors': factors | tuning, 'seed': seed}
        tried = self.campaign.with_gains(self.gains(values), **changes)
        rows = [row for _, part in self._execute(tried, chunks_of(tried)) for row in part]
        return sorted(rows, key=lambda row: row['number'])

    def table(self, rows: list[dict[str, Any]]) -> np.ndarray:
        """Figures of the cost, shape (runs, figures); NaN where a run has none."""
        return np.array([[_figure(row, name) for name in self.weights] for row in rows])

    def cost(self, table: np.ndarray, first: np.ndarray) -> float:
        """Weighted mean of the figures' means, each over that of the first trial."""
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', RuntimeWarning)  # a figure that no run has
            means, scales = np.nanmean(table, axis=0), np.nanmean(first, axis=0)
        least = [_LEAST_RATE if name in _RATES else 1e-9 for name in self.weights]
        weights = np.array(list(self.weights.values())) * np.isfinite(scales)
        ratios = np.nan_to_num(means) / np.maximum(np.nan_to_num(scales), least)
        return float(weights @ ratios / weights.sum())


def _weight(text: str) -> tuple[str, float]:
    name, _, value = text.partition('=')
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0.0 < weight < math.inf:
        raise ConfigError('--cost', f'must be COLUMN=WEIGHT with a positive weight, got {text!r}')
    return name, weight


def _figure(row: dict[str, Any], name: str) -> float:
    faulty = row['kind'] != NO_FAULT
    if name == 'missed':
        return float(not row['detected']) if faulty else math.nan
    if name == 'unstable':
        return float(not row['stable'])
    if name == 'detection_delay' and faulty and not row['detected']:
        return row['observed'] - row['early_time']  # as late as can be
    if not isinstance(row.get(name), (int, float)):
        raise ConfigError('--cost', f'{name!r} is no number of the results')
    return min(float(row[name]), 1e6)


def healthy(rows: list[dict[str, Any]]) -> tuple[float, int]:
    """Largest score and number of alarms where there is no fault."""
    scores = [row[name] for row in rows for name in row if name.startswith('score_before')]
    alarms = sum(row[n] for row in rows for n in row if n.startswith('alarms_before'))
    finite = [min(score, 1e6) for score in scores if not math.isnan(score)]
    if not finite:
        raise ConfigError('campaign', 'has no run with a part without fault')
    return max(finite), alarms


def run(arguments: argparse.Namespace) -> int:
    """Search, validate, write; 1 if no trial is certified and keeps all limits."""
    if not arguments.search:
        raise ConfigError('--search', 'is needed: FIELD=LOW:HIGH')
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    console = Console(soft_wrap=True, highlight=False, markup=False)
    with worker_pool(arguments.workers, arguments.scheduler) as execute:
        bench = _Bench(arguments, execute)
        folder = Path(arguments.out or Path('out') / 'tune' / bench.name)
        folder.mkdir(parents=True, exist_ok=True)
        study = _search(bench, arguments, folder, console)
        good = [trial for trial in _finished(study) if trial.values]
        good = [trial for trial in good if max(trial.constraints.values()) <= 0.0]
        if not good:
            console.print('nothing is changed: no trial is certified and keeps all limits')
            return 1
        lowest = (1.0 + _TOLERANCE) * min(trial.values[0] for trial in good)
        near = (trial for trial in good if trial.values[0] <= lowest)
        picked = min(near, key=lambda trial: (trial.values[1], trial.number))
        console.print('validating the picked trial on other runs ...')
        result = _validate(bench, picked.params, arguments.seed)
    result['trial'] = picked.number
    (folder / 'study.json').write_text(json.dumps(result, indent=1, allow_nan=False) + '\n')
    rows = [(name, f'{bench.base[name]:g}', f'{v:g}') for name, v in picked.params.items()]
    title = f'trial {picked.number} of {arguments.trials}'
    print_grid(console, ('field', '>before', '>picked'), rows, title)
    accepted = not result['reason']
    interval = '{:+.3g} to {:+.3g}'.format(*result['interval'])
    console.print(f'cost {result["first"]:.4g} before, {result["picked"]:.4g} picked: {interval}')
    console.print('accepted' if accepted else 'nothing is changed: ' + result['reason'])
    if accepted:
        _write(bench, picked.params, folder)
    _draw(study, folder)
    console.print(*(f'written: {path}' for path in sorted(folder.iterdir())), sep='\n')
    return 0


def _finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """Trials with a result; one that was interrupted, or failed, has none and is tried again."""
    return study.get_trials(states=(TrialState.COMPLETE, TrialState.PRUNED))


def _search(
    bench: _Bench, arguments: argparse.Namespace, folder: Path, console: Console
) -> optuna.Study:
    """Trials up to the number wanted."""
    # Each draws from a generator of its own: a study that was killed goes on as if it had not been.
    key = sha256_of([bench.campaign.key, bench.ranges, bench.weights, bench.content({}),
                     arguments.seed, bench.campaign.software])  # fmt: skip
    storage = f'sqlite:///{folder / "study.db"}'
    try:
        # One without trials is of a cost that made no sense, or was stopped before it began.
        for other in optuna.get_all_study_summaries(storage):
            if other.study_name != key and other.n_trials:
                raise ConfigError('--out', 'holds another study: take another folder', str(folder))
            if other.study_name != key:
                optuna.delete_study(study_name=other.study_name, storage=storage)
        study = optuna.create_study(
            storage=storage, study_name=key, directions=['minimize'] * 2, load_if_exists=True
        )
    except ConfigError:
        raise
    except Exception as error:  # whatever the storage says of a file that is none
        reason = f'study.db cannot be used ({str(error).splitlines()[0]})'
        raise ConfigError('--out', reason, str(folder)) from None
    first = bench.table(bench.rows(bench.base))
    if not study.get_trials(states=(TrialState.WAITING,)) + _finished(study):
        study.enqueue_trial(bench.base)

    def objective(trial: optuna.Trial) -> tuple[float, float]:
        values = {name: trial.suggest_float(name, *ends, log=True)
                  for name, ends in bench.ranges.items()}  # fmt: skip
        try:
            rows = bench.rows(values)
        except (InfeasibleError, ConfigError) as error:
            trial.set_user_attr('reason', str(error))
            raise optuna.TrialPruned(str(error)) from None
        score, alarms = healthy(rows)
        trial.set_constraint('healthy score', score - 1.0)
        trial.set_constraint('false alarms', float(alarms))
        return bench.cost(bench.table(rows), first), score

    while (done := len(_finished(study))) < arguments.trials:
        study.sampler = optuna.samplers.TPESampler(seed=arguments.seed + done)
        study.optimize(objective, n_trials=1)
        last = _finished(study)[-1]
        told = f'cost {last.values[0]:.3f}' if last.values else last.user_attrs['reason']
        console.print(f'trial {done}: {told}', markup=False)
    return study


def _validate(bench: _Bench, values: dict[str, float], seed: int) -> dict[str, Any]:
    """Compare with the values before on other runs, pair by pair, by a bootstrap over runs."""
    other = bench.campaign.spec.seed + 1
    rows = bench.rows(values, other)
    first, tried = bench.table(bench.rows(bench.base, other)), bench.table(rows)
    numbers = np.arange(len(rows))

    def difference(chosen: np.ndarray) -> float:
        return bench.cost(tried[chosen], first) - bench.cost(first[chosen], first)

    before, now = bench.cost(first, first), bench.cost(tried, first)
    score, alarms = healthy(rows)
    interval = [now - before] * 2
    if len(numbers) > 1 and values != bench.base:
        found = stats.bootstrap(
            (numbers,), difference, n_resamples=_RESAMPLES, vectorized=False,
            method='percentile', rng=np.random.default_rng(seed)).confidence_interval  # fmt: skip
        interval = [float(found.low), float(found.high)]
    reason = ''
    if score > 1.0 or alarms:
        reason = f'{alarms} false alarms, healthy score {score:.3g} on other runs'
    elif not interval[1] < -_TOLERANCE * before:
        reason = f'the cost is not lower by {_TOLERANCE:.0%} with 95 % confidence'
    return {'values': values, 'base': bench.base, 'first': before, 'picked': now,
            'interval': interval, 'healthy_score': score, 'reason': reason}  # fmt: skip


def _write(bench: _Bench, values: dict[str, float], folder: Path) -> None:
    """Requirement and gains, verified as the nodes will; parameters if the diagnosis was tuned."""
    requirement = folder / 'requirement.yaml'
    write_yaml(requirement, bench.content(values), 'Found by lpv tune.')
    tuned: dict[str, Any] = {
        name[10:]: value for name, value in values.items() if name.startswith('diagnosis.')
    }
    if tuned:
        parameters = {'diagnosis': vars(replace(DiagnosisParameters(), **tuned))}
        write_parameters(folder / 'diagnosis.yaml', parameters, 'Found by lpv tune.')
    found = design(bench.arm, load_requirement(requirement))
    lines = [f'Gains for arm {bench.arm.name!r}, found by lpv tune.', *found.lines]
    found.gains.save(folder / 'gains.yaml', '\n'.join(lines))
    load_gains(folder / 'gains.yaml').require(bench.arm, 'gains.yaml')


def _draw(study: optuna.Study, folder: Path) -> None:
    """Optuna's pictures: front, course of the search, importance, slices."""
    import matplotlib

    matplotlib.use('Agg')
    import matplotlib.pyplot as plt
    from optuna.visualization import matplotlib as plots

    shown: Any = {'target': lambda trial: trial.values[0], 'target_name': 'cost'}
    evaluator = optuna.importance.PedAnovaImportanceEvaluator
    pictures: dict[str, Callable[[], Any]] = {
        'front': lambda: plots.plot_pareto_front(study, target_names=['cost', 'score']),
        'history': lambda: plots.plot_optimization_history(study, **shown),
        'importance': lambda: plots.plot_param_importances(study, evaluator=evaluator(), **shown),
        'slices': lambda: plots.plot_slice(study, **shown),
    }
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # these plots are called experimental
        for name, draw in pictures.items():
            # Too few trials say nothing.
            with contextlib.suppress(ValueError, RuntimeError, ZeroDivisionError):
                draw()
                plt.savefig(folder / f'{name}.png', dpi=100, bbox_inches='tight')
            plt.close('all')
