"""One trial: a design, its runs, its figures."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lpv_campaign.plan.campaign import Campaign, resolve
from lpv_campaign.tune.fields import base_value, changed, check_range, diagnosis_values
from lpv_campaign.tune.metric import BEYOND, meets
from lpv_campaign.tune.study_file import Study
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.support.config import read_yaml
from lpv_core.support.errors import ConfigError
from lpv_design.design_flow import design
from lpv_design.requirement import Requirement, load_requirement, parse_requirement
from lpv_design.solve import InfeasibleError


@dataclass
class Outcome:
    """What came out of a trial."""

    reason: str = ''  # Why there are no gains; empty if there are
    figures: dict = field(default_factory=dict)  # By name
    healthy_score: float = math.nan  # Largest abs(fault estimate) / threshold without a fault
    false_alarms: int = 0  # Alarms in healthy runs


class Bench:
    """Designs by given values, and runs them on the study's campaign.

    Parameters
    ----------
    study : Study
        The study.
    execute : callable
        As `lpv_campaign.execution.execute.worker_pool` gives it.
    """

    def __init__(self, study: Study, execute: Callable[..., Any]) -> None:
        self.study, self._execute = study, execute
        self.requirement = _base(study)
        self.base = {name: base_value(name, self.requirement) for name in study.search}
        for name, found in study.search.items():
            check_range(name, found, self.base[name])
        self._data = read_yaml(self.requirement.source)
        self._campaign = resolve(study.campaign, study.name, study.folder, designed=False)
        arm = self._campaign.arm
        if not isinstance(arm, ArmParameters):
            raise ConfigError('arm', f'{arm.name} is a serial arm, without a design to tune')
        self.arm = arm
        spec = self._campaign.spec
        self.length = spec.duration or self._campaign.scenario(spec.scenario).duration

    @property
    def key(self) -> str:
        """Hash of the campaign; see `lpv_campaign.plan.campaign.Campaign.key`."""
        return self._campaign.key

    def content(self, values: dict[str, float]) -> dict[str, Any]:
        """Content of the requirement file with given values."""
        return changed(self._data, self.requirement, values)

    def gains(self, values: dict[str, float]) -> Gains:
        """Certified gains."""
        requirement = parse_requirement(self.content(values), self.study.name)
        observer: Any = requirement.observer
        fastest = getattr(observer, 'fastest', None) or observer.q + observer.r
        step = fastest * self.arm.sample_time
        if step > self.study.limits.pole_step:
            raise InfeasibleError(
                f'observer: pole {fastest:g}/s times the sample time is '
                f'{step:.3g}, beyond {self.study.limits.pole_step:g}'
            )
        gains = design(self.arm, requirement).gains
        require(self.arm, gains, self.study.name)
        return gains

    def rows(
        self, gains: Gains, values: dict[str, float], plan: dict[str, Any] | None = None
    ) -> list[dict[str, Any]]:
        """Results of all runs with given gains."""
        campaign = self._campaign if plan is None else self._other(**plan)
        tried = campaign.with_gains(gains, diagnosis_values(values))
        rows = [row for part in self._execute(tried, range(tried.spec.runs)) for row in part]
        return sorted(rows, key=lambda row: row['number'])

    def _other(self, seed: int, runs: int) -> Campaign:
        data = {
            **self.study.campaign,
            'seed': seed,
            'plan': {**self.study.campaign['plan'], 'runs': runs},
        }
        return resolve(data, self.study.name, self.study.folder, designed=False)

    def outcome(self, values: dict[str, float]) -> Outcome:
        """Design, run, and measure."""
        try:
            gains = self.gains(values)
        except (InfeasibleError, ConfigError) as error:
            return Outcome(reason=str(error))
        return self.measure(self.rows(gains, values))

    def measure(self, rows: list[dict[str, Any]]) -> Outcome:
        """Figures of a campaign's results."""
        healthy = [self._is_healthy(row) for row in rows]
        return Outcome(
            figures={f.name: f.summary(f.values(rows, self.length)) for f in self.study.figures},
            healthy_score=_score(rows, healthy),
            false_alarms=sum(row['false_alarms'] for row, well in zip(rows, healthy) if well),
        )

    def _is_healthy(self, row: dict[str, Any]) -> bool:
        return any(meets(row, where, 'limits.healthy') for where in self.study.limits.healthy)


def _base(study: Study) -> Requirement:
    path = Path(study.folder) / study.requirement
    return load_requirement(path if path.is_file() else study.requirement)


def _score(rows: list[dict[str, Any]], healthy: list[bool]) -> float:
    """Over whole healthy runs, and up to the faults of the others."""
    parts = [
        (row, part)
        for row, well in zip(rows, healthy)
        for part in (('before', 'during') if well else ('before',))
    ]
    scores = [row[f'score_{part}_{i}'] for row, part in parts for i in (1, 2)]
    scores = [score for score in scores if not math.isnan(score)]
    if not scores:
        raise ConfigError('limits.healthy', 'no run of the campaign has a part without fault')
    return min(max(scores), BEYOND)
