"""A campaign with all its files inlined: what every worker needs, as one text."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from lpv_campaign.plan.factors import ByKind, Choice
from lpv_campaign.plan.sampling import Plan
from lpv_campaign.plan.spec import (
    BOTH,
    DEFAULTS,
    OF_SERIAL_ARMS,
    OF_TWO_LINKS,
    PATHS,
    CampaignSpec,
    flat_factors,
    parse_spec,
)
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import Gains, gains_to_dict, load_gains, parse_gains
from lpv_core.model.arm import ArmParameters, arm_from_json
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.serial_arm.arm_file import is_serial_arm, parse_serial_arm, to_mapping
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation import serial_scenario
from lpv_core.simulation.any_scenario import AnyScenario, new_path, parse_any_scenario
from lpv_core.support.config import read_yaml, sha256_of
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


def resolve(
    data: dict[str, Any], source: str, folder: str | Path, designed: bool = True
) -> Campaign:
    """Inline all files that a campaign names, and design its gains.

    Parameters
    ----------
    data : dict
        Content of the campaign file.
    source : str
        Its name.
    folder : str or pathlib.Path
        Where relative names of files count from.
    designed : bool, optional
        Whether gains are found, too; if not, `Campaign.with_gains` gives them.

    Returns
    -------
    Campaign
        Ready to be run.

    Raises
    ------
    LpvError
        If anything is missing, wrong, or cannot be designed.
    """
    spec = parse_spec(data, source, str(folder))
    arm = load_any_arm(_file('arms', spec.arm, folder))
    names = {spec.scenario, *_path_scenarios(spec)}
    content: dict[str, Any] = {
        'spec': data,
        'arm': _to_json(arm),
        'scenarios': {name: read_yaml(_file('scenarios', name, folder)) for name in sorted(names)},
        'gains': {},
    }
    for name in _values(spec, 'path', 'scenario'):
        if name != 'random':
            name = spec.scenario if name == 'scenario' else name
            new_path(arm, parse_any_scenario(content['scenarios'][name], name, arm))
    if isinstance(arm, ArmParameters) and designed:
        for time in _sample_times(spec, arm):
            for design in spec.designs:
                gains = _gains(design, replace(arm, sample_time=time), folder)
                content['gains'][f'{design}@{time!r}'] = gains_to_dict(gains)
    campaign = Campaign(json.dumps(content, sort_keys=True))
    campaign.check()
    return campaign


def _to_json(arm: Arm) -> str:
    return arm.to_json() if isinstance(arm, ArmParameters) else json.dumps(to_mapping(arm))


def _from_json(text: str) -> Arm:
    data = json.loads(text)
    return parse_serial_arm(data) if is_serial_arm(data) else arm_from_json(text)


def _file(kind: str, name: str, folder: str | Path) -> Path:
    path = Path(folder) / name
    return bringup_file(kind, str(path) if path.is_file() else name)


def _values(spec: CampaignSpec, name: str, default: Any) -> tuple[Any, ...]:
    factor = spec.factors.get(name)
    return factor.values if isinstance(factor, Choice) else (default,)


def _path_scenarios(spec: CampaignSpec) -> list[str]:
    return [name for name in _values(spec, 'path', 'scenario') if name not in PATHS]


def _sample_times(spec: CampaignSpec, arm: Arm) -> tuple[float, ...]:
    return _values(spec, 'sample_time', arm.sample_time)


def _gains(name: str, arm: ArmParameters, folder: str | Path) -> Gains:
    path = Path(folder) / name
    if path.is_file() and 'ros__parameters' in path.read_text(encoding='utf-8', errors='ignore'):
        gains = load_gains(path)
        require(arm, gains, name)
        return gains
    # Only here: workers never design, and need no solver.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    return design(arm, load_requirement(path if path.is_file() else name)).gains


class Campaign:
    """What is run, from one text.

    Parameters
    ----------
    text : str
        JSON, as `resolve` makes it.

    Attributes
    ----------
    text : str
        The same.
    spec : CampaignSpec
        What varies.
    arm : ArmParameters or SerialArm
        Nominal arm of the arm file.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._content = content = json.loads(text)
        self.spec = parse_spec(content['spec'])
        self.arm = _from_json(content['arm'])
        self._gains = {name: parse_gains(gains, name) for name, gains in content['gains'].items()}
        self._scenarios = {
            name: parse_any_scenario(data, name, self.arm)
            for name, data in content['scenarios'].items()
        }
        flat = flat_factors(self.spec.factors)
        self._plan = Plan(self.spec.method, flat, self.spec.runs, self.spec.seed)

    @property
    def is_serial(self) -> bool:
        """Whether the arm is one of n joints, without designed gains."""
        return isinstance(self.arm, SerialArm)

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the software itself.

        Gains count by what they were designed from: a solver of another version finds others, and
        a campaign that is resumed keeps those that it started with.
        """
        fixed = {name: self._content[name] for name in ('spec', 'arm', 'scenarios')}
        return sha256_of({**fixed, 'gains': sorted(self._content['gains'])})

    def scenario(self, name: str) -> AnyScenario:
        """Scenario by the name that the campaign file gives it."""
        return self._scenarios[name]

    def gains(self, design: str, sample_time: float) -> Gains:
        """Gains of a design at a sample time [s]."""
        return self._gains[f'{design}@{sample_time!r}']

    def with_gains(self, gains: Gains, factors: dict[str, float]) -> Campaign:
        """The same runs with other gains."""
        content, data = json.loads(self.text), gains_to_dict(gains)
        content['spec']['factors'] = {**content['spec'].get('factors', {}), **factors}
        content['gains'] = {
            f'{design}@{time!r}': data
            for design in self.spec.designs
            for time in _sample_times(self.spec, self.arm)
        }
        return Campaign(json.dumps(content, sort_keys=True))

    def values(self, number: int) -> dict[str, Any]:
        """Value of every factor in one run.

        Returns by name; None: what scenario and arm say.
        """
        units = dict(zip(self.spec.factors, self._plan.point(number).tolist()))
        values: dict[str, Any] = dict(DEFAULTS)
        if not self.is_serial:
            values['design'] = self.spec.designs[0]
        kind_first = sorted(units, key=lambda name: name != 'fault.kind')
        for name in kind_first:
            factor = self.spec.factors[name]
            if isinstance(factor, ByKind):
                factor = factor.of(values['fault.kind'])
            values[name] = factor.value(units[name])
        return values

    def check(self) -> None:
        """Refuse what needs the arm to be seen as wrong."""
        known = (*self.arm.sensor_names, BOTH)
        for name in _values(self.spec, 'fault.sensor', BOTH):
            if name not in known:
                raise ConfigError(
                    'factors.fault.sensor', f'{name!r} is none of ' + ', '.join(known)
                )
        if self.is_serial:
            self._check_serial()
        for name in OF_TWO_LINKS if self.is_serial else OF_SERIAL_ARMS:
            if name in self.spec.factors:
                raise ConfigError(f'factors.{name}', f'is none of arms like {self.arm.name}')
        plants = _values(self.spec, 'plant', self.scenario(self.spec.scenario).plant)
        if self.spec.limit and 'lpv' in plants:
            raise ConfigError('limit', 'there is none for the plant lpv, which is no rigid arm')
        for name in _values(self.spec, 'design', self.spec.designs[0]):
            if name not in self.spec.designs:
                raise ConfigError(
                    'factors.design',
                    f'{name!r} is none of the designs ' + ', '.join(self.spec.designs),
                )

    def _check_serial(self) -> None:
        """Refuse what only the two-link arm has."""
        if 'designs' in self._content['spec']:
            raise ConfigError('designs', 'must be left out: a serial arm has no designed gains')
        if self.spec.limit:
            raise ConfigError('limit', 'is known of two-link arms alone')
        for plant in _values(self.spec, 'plant', serial_scenario.PLANTS[0]):
            if plant not in serial_scenario.PLANTS:
                known = ', '.join(serial_scenario.PLANTS)
                raise ConfigError('factors.plant', f'{plant!r} is none of {known}')


@lru_cache(maxsize=2)
def campaign_of(text: str) -> Campaign:
    """`Campaign` of a text; a worker parses it once."""
    return Campaign(text)
