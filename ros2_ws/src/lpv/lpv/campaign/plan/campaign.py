"""A campaign with all its files inlined: what every worker needs, as one text."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import lpv.bag
import lpv.campaign
import lpv.core
from lpv.campaign.plan.spec import BOTH, DEFAULTS, PATHS, CampaignSpec, Choice, Plan, parse_spec
from lpv.core.serial_arm.arm_file import load_arm, parse_arm, to_mapping
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import PAPER_PLANTS, PLANTS, parse_scenario
from lpv.core.support.config import read_yaml, sha256_of
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import source_digest
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import Gains, load_gains
from lpv.core.uio.planar import is_planar

_OF_GAINS = ('design', 'disturbance')
"""Factors of arms with a region for which gains are designed."""


def software() -> str:
    """Hash of everything that makes the numbers."""
    modules = (lpv.core.__file__, lpv.bag.__file__, lpv.campaign.__file__)
    return '-'.join(source_digest(Path(module).parent) for module in modules)


def load_campaign(name: str, designed: bool = True) -> tuple[Path, Campaign]:
    """A campaign file, or a shipped one by its name, as of `resolve`, and where it is."""
    path = bringup_file('campaigns', name)
    return path, resolve(read_yaml(path), str(path), path.parent, designed)


def resolve(
    data: dict[str, Any], source: str, folder: str | Path, designed: bool = True
) -> Campaign:
    """Inline all files that a campaign names, relative to a folder, and design its gains."""
    spec = parse_spec(data, source)
    arm = load_arm(bringup_file('arms', spec.arm, folder))
    paths = [spec.scenario if path == 'scenario' else path for path in _values(spec, 'path')]
    names = {spec.scenario, *(path for path in paths if path not in PATHS)}
    scenarios = {name: bringup_file('scenarios', name, folder) for name in sorted(names)}
    content: dict[str, Any] = {
        'spec': data,
        'arm': to_mapping(arm),
        'scenarios': {name: read_yaml(file) for name, file in scenarios.items()},
        'gains': {},
        'designs': {},
        'software': software(),
    }
    for name in names:
        scenario = parse_scenario(content['scenarios'][name], name)
        if name in paths:
            scenario.path(arm)
    if arm.lpv is not None and designed:
        for time in _values(spec, 'sample_time'):
            at = replace(arm, sample_time=time or arm.sample_time)
            for design in spec.designs:
                gains = find_gains(design, at, folder)
                content['gains'][f'{design}@{at.sample_time!r}'] = gains.mapping()
        # Of gains and requirement files, or of shipped requirements.
        files = {name: bringup_file('requirements', name, folder) for name in spec.designs}
        content['designs'] = {name: sha256_of(read_yaml(file)) for name, file in files.items()}
    campaign = Campaign(json.dumps(content, sort_keys=True))
    campaign.check()
    return campaign


def _values(spec: CampaignSpec, name: str) -> tuple[Any, ...]:
    factor = spec.factors.get(name)
    return factor.values if isinstance(factor, Choice) else (DEFAULTS[name],)


def find_gains(name: str, arm: SerialArm, folder: str | Path = '.') -> Gains:
    """Gains of a gains file, checked, or designed for a requirement, a file or a shipped one."""
    path = bringup_file('requirements', name, folder)
    if 'ros__parameters' in path.read_text(encoding='utf-8', errors='ignore'):
        gains = load_gains(path)
        gains.require(arm, name)
        return gains
    # Only here: workers never design, and need no solver.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    return design(arm, load_requirement(path)).gains


class Campaign:
    """Simulated runs from JSON: ``spec`` (what varies), ``arm``, ``scenarios``, ``gains``."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.content: dict[str, Any] = json.loads(text)
        self.software: str = self.content.get('software', 'unknown')
        self.spec = parse_spec(self.content['spec'])
        self.arm: SerialArm = parse_arm(self.content['arm'])
        self.designed = self.arm.lpv is not None
        gains = self.content['gains']
        self._gains = {name: Gains.parse(gains[name], name) for name in gains}
        self._plan = Plan(self.spec)

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the software itself."""
        # Gains count by what they were designed from: another version of the solver finds others.
        names = 'spec', 'arm', 'scenarios', 'designs'
        fixed = {name: self.content.get(name, {}) for name in names}
        return sha256_of({**fixed, 'gains': sorted(self.content['gains'])})

    def gains(self, design: str | None, sample_time: float) -> Gains | None:
        """Gains of a design at a sample time [s]; None for an arm that has none."""
        return self._gains[f'{design}@{sample_time!r}'] if self.designed else None

    def with_gains(self, gains: Gains, **changes: Any) -> Campaign:
        """The same campaign with other gains, and with other fields of its file."""
        content, data = json.loads(self.text), gains.mapping()
        content['spec'].update(changes)
        content['gains'] = {f'{self.spec.designs[0]}@{self.arm.sample_time!r}': data}
        return Campaign(json.dumps(content, sort_keys=True))

    def values(self, number: int) -> dict[str, Any]:
        """Value of every factor in one run; None: what scenario and arm say."""
        units = dict(zip(self.spec.factors, self._plan.point(number).tolist()))
        values: dict[str, Any] = dict(DEFAULTS)
        if self.designed:
            values['design'] = self.spec.designs[0]
        kind_first = sorted(units, key=lambda name: name != 'fault.kind')
        for name in kind_first:
            values[name] = self.spec.factors[name].value(units[name], values['fault.kind'])
        # Counts samples; a range gives any number.
        values['command_delay'] = float(round(values['command_delay']))
        return values

    def check(self) -> None:
        """Refuse what needs the arm to be seen as wrong."""
        spec, given = self.spec, self.content['spec']
        if 'designs' in given and not self.designed:
            raise ConfigError('designs', 'must be left out: the arm has no lpv region')
        for name in _OF_GAINS:
            if name in spec.factors and not self.designed:
                raise ConfigError(f'factors.{name}', f'is none of arms like {self.arm.name}')
        plants = [p for p in PLANTS if p not in PAPER_PLANTS or is_planar(self.arm)]
        for name, known in (
            ('fault.sensor', (*self.arm.sensor_names, BOTH)),
            ('plant', plants),
            ('design', spec.designs),
        ):
            for value in _values(spec, name):
                if value is not None and value not in known:
                    listed = ', '.join(known)
                    raise ConfigError(f'factors.{name}', f'{value!r} is none of {listed}')
