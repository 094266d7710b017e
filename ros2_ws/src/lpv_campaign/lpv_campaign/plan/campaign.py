"""A campaign with all its files inlined: what every worker needs, as one text."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from lpv_campaign.plan.arms import SERIAL, TWO_LINKS, ArmKind, kind_of
from lpv_campaign.plan.factors import ByKind, Choice
from lpv_campaign.plan.spec import BOTH, DEFAULTS, PATHS, CampaignSpec, Plan, parse_spec
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import Gains, gains_to_dict, load_gains, parse_gains
from lpv_core.model.arm import ArmParameters, arm_from_json, parse_arm
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.serial_arm.arm_file import is_serial_arm, parse_serial_arm, to_mapping
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.any_scenario import new_path, parse_any_scenario
from lpv_core.simulation.scenario import expanded_plant
from lpv_core.support.config import read_yaml, sha256_of
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


def resolve(
    data: dict[str, Any], source: str, folder: str | Path, designed: bool = True
) -> Campaign:
    """Inline all files that a campaign names, relative to a folder, and design its gains.

    Without ``designed``, `Campaign.with_gains` gives these.  LpvError if anything is missing,
    wrong, or cannot be designed.
    """
    spec = parse_spec(data, source)
    arm_file = _file('arms', spec.arm, folder)
    arm = load_any_arm(arm_file)
    paths = [spec.scenario if path == 'scenario' else path for path in _values(spec, 'path')]
    names = {spec.scenario, *(path for path in paths if path not in PATHS)}
    content: dict[str, Any] = {
        'spec': data,
        'arm': to_mapping(arm) if isinstance(arm, SerialArm) else read_yaml(arm_file),
        'scenarios': {
            name: expanded_plant(read_yaml(_file('scenarios', name, folder)))
            for name in sorted(names)
        },
        'gains': {},
    }
    for name in names:
        scenario = parse_any_scenario(content['scenarios'][name], name, arm)
        if name in paths:
            new_path(arm, scenario)
    if isinstance(arm, ArmParameters) and designed:
        for time in _values(spec, 'sample_time'):
            at = replace(arm, sample_time=time or arm.sample_time)
            for design in spec.designs:
                gains = find_gains(design, at, folder)
                content['gains'][f'{design}@{at.sample_time!r}'] = gains_to_dict(gains)
    campaign = Campaign(json.dumps(content, sort_keys=True))
    campaign.check()
    return campaign


def _file(kind: str, name: str, folder: str | Path) -> Path:
    path = Path(folder) / name
    return bringup_file(kind, str(path) if path.is_file() else name)


def _values(spec: CampaignSpec, name: str) -> tuple[Any, ...]:
    factor = spec.factors.get(name)
    return factor.values if isinstance(factor, Choice) else (DEFAULTS[name],)


def find_gains(name: str, arm: ArmParameters, folder: str | Path = '.') -> Gains:
    """Gains of a gains file, checked, or designed for a requirement, a file or a shipped one."""
    path = Path(folder) / name
    if path.is_file() and 'ros__parameters' in path.read_text(encoding='utf-8', errors='ignore'):
        gains = load_gains(path)
        require(arm, gains, name)
        return gains
    # Only here: workers never design, and need no solver.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    return design(arm, load_requirement(path if path.is_file() else name)).gains


def arm_content(arm: Arm) -> Any:
    """An arm as plain data; `parse_content` reads it back exactly."""
    return to_mapping(arm) if isinstance(arm, SerialArm) else arm.to_json()


def parse_content(data: Any) -> Arm:
    """Arm of `arm_content`, or of the mapping of an arm file."""
    if isinstance(data, str):
        return arm_from_json(data)
    return parse_serial_arm(data) if is_serial_arm(data) else parse_arm(data)


class Campaign:
    """Simulated runs, from one text: JSON, as `resolve` makes it.

    Parsed it is the ``content``: ``spec`` (what varies), ``arm``, ``scenarios``, ``gains``.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.content: dict[str, Any] = json.loads(text)
        self.spec = parse_spec(self.content['spec'])
        self.arm: Any = parse_content(self.content['arm'])
        self.kind: ArmKind = kind_of(self.arm)
        gains = self.content['gains']
        self._gains = {name: parse_gains(gains[name], name) for name in gains}
        self._plan = Plan(self.spec)

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the software itself.

        Gains count by what they were designed from: a solver of another version finds others, and
        a campaign that is resumed keeps those that it started with.
        """
        fixed = {name: self.content[name] for name in ('spec', 'arm', 'scenarios')}
        return sha256_of({**fixed, 'gains': sorted(self.content['gains'])})

    @property
    def tasks(self) -> list[int]:
        """Numbers of all runs."""
        return list(range(self.spec.runs))

    def gains(self, design: str | None, sample_time: float) -> Gains | None:
        """Gains of a design at a sample time [s]; None for an arm that has none."""
        return self._gains[f'{design}@{sample_time!r}'] if self.kind.designed else None

    def with_gains(self, gains: Gains, **changes: Any) -> Campaign:
        """The same campaign with other gains, and with other fields of its file."""
        content, data = json.loads(self.text), gains_to_dict(gains)
        content['spec'].update(changes)
        content['gains'] = {f'{self.spec.designs[0]}@{self.arm.sample_time!r}': data}
        return Campaign(json.dumps(content, sort_keys=True))

    def values(self, number: int) -> dict[str, Any]:
        """Value of every factor in one run; None: what scenario and arm say."""
        units = dict(zip(self.spec.factors, self._plan.point(number).tolist()))
        values: dict[str, Any] = dict(DEFAULTS)
        if self.kind.designed:
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
        spec, given = self.spec, self.content['spec']
        other = SERIAL if self.kind is TWO_LINKS else TWO_LINKS
        if 'designs' in given and not self.kind.designed:
            raise ConfigError('designs', 'must be left out: a serial arm has no designed gains')
        for name in other.factors:
            if name in spec.factors:
                raise ConfigError(f'factors.{name}', f'is none of arms like {self.arm.name}')
        for name, known in (
            ('fault.sensor', (*self.arm.sensor_names, BOTH)),
            ('plant', self.kind.plants),
            ('design', spec.designs),
        ):
            for value in _values(spec, name):
                if value is not None and value not in known:
                    listed = ', '.join(known)
                    raise ConfigError(f'factors.{name}', f'{value!r} is none of {listed}')
