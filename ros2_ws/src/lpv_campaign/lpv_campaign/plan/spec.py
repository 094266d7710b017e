"""The campaign file: what is run, what varies, how often."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from lpv_campaign.plan.factors import ByKind, Choice, Range, parse_factor
from lpv_campaign.plan.sampling import METHODS, MOST_RUNS, plan_size
from lpv_core.control.tracking import COMPENSATION
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.simulation.faults import KINDS
from lpv_core.simulation.scenario import PLANTS
from lpv_core.support.config import Section, read_yaml

NO_FAULT = 'none'
BOTH = 'both'
PATHS = ('scenario', 'random')
_INF = math.inf
NUMBERS = {
    'fault.size': (-_INF, _INF),
    'fault.rate': (-_INF, _INF),
    'fault.onset': (0.0, _INF),
    'fault.duration': (0.0, _INF),
    'fault.sign': (-1.0, 1.0),
    'noise': (0.0, 1e3),
    'disturbance': (0.0, 1e3),
    'mass_1': (1e-3, 1e3),
    'mass_2': (1e-3, 1e3),
    'inertia_1': (1e-3, 1e3),
    'inertia_2': (1e-3, 1e3),
    'parameter_error': (0.0, 0.5),
    'payload': (-_INF, _INF),
    'friction': (0.0, 100.0),
    'sample_time': (1e-5, 1.0),
    'command_delay': (0.0, 63.0),
    'sample_loss': (0.0, 0.999),
}
"""Factors that are numbers, and their ranges; units and meaning in docs/campaign.md."""
_BY_KIND = ('fault.size', 'fault.rate', 'fault.duration')
DEFAULTS = {
    'design': None,
    'path': 'scenario',
    'plant': None,
    'compensation': 'confirmed',
    'fault.kind': NO_FAULT,
    'fault.sensor': None,
    'fault.size': 0.0,
    'fault.rate': 0.0,
    'fault.onset': 5.0,
    'fault.duration': 0.0,
    'fault.sign': None,
    'noise': None,
    'disturbance': None,
    'mass_1': None,
    'mass_2': None,
    'inertia_1': None,
    'inertia_2': None,
    'parameter_error': None,
    'payload': None,
    'friction': None,
    'sample_time': None,
    'command_delay': 0.0,
    'sample_loss': 0.0,
}
"""What acts where the campaign file is silent; None: what scenario or arm file says, the first
design, the first sensor, a sign by chance."""
OF_TWO_LINKS = (
    'design',
    'disturbance',
    'mass_1',
    'mass_2',
    'inertia_1',
    'inertia_2',
    'command_delay',
    'sample_loss',
)
"""Factors that serial arms do not have."""
OF_SERIAL_ARMS = ('parameter_error',)
"""Factors that the two-link arm does not have."""
_TUNING = {
    f'diagnosis.{field.name}'
    for field in fields(DiagnosisParameters)
    if field.type in (float, 'float')
}


@dataclass(frozen=True)
class CampaignSpec:
    """A campaign file."""

    name: str  # Name
    seed: int  # Seed of the plan and, with the number of a run, of the run
    method: str  # One of `lpv_campaign.plan.sampling.METHODS`
    runs: int  # Number of runs
    arm: str  # Arm file, or name of a shipped arm
    scenario: str  # Base scenario: a file, or name of a shipped one
    duration: float | None  # Length of a run [s]; None: the scenario's
    designs: tuple  # Requirement or gains files, or names of shipped requirements
    factors: dict  # What varies, and what is fixed to another value than the default
    substeps: int = 2  # Runge-Kutta steps of the plant per sample
    # Whether each run with a fault is repeated without it, for the ratio of tracking errors
    twin: bool = False
    # In so many runs, spread evenly, the estimates are compared with the best possible ones
    limit: int = 0
    folder: str = '.'  # Where relative names of files count from


def load_spec(path: str | Path) -> CampaignSpec:
    """Read a campaign file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/campaign.md``.

    Returns
    -------
    CampaignSpec
        Validated as far as it can be without the arm.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    return parse_spec(read_yaml(path), str(path), str(Path(path).resolve().parent))


def parse_spec(data: dict[str, Any], source: str = 'campaign', folder: str = '.') -> CampaignSpec:
    """Build a campaign from the mapping of a campaign file."""
    top = Section(data, source)
    plan = top.section('plan')
    method = plan.text('method', choices=METHODS)
    if method == 'factorial':
        repeats, runs = plan.integer('repeats', 1, low=1), 0
    else:
        repeats, runs = 1, plan.integer('runs', low=1)
    factors = _factors(top.plain('factors'), source)
    designs = top.texts('designs', ('paper',))
    if len(designs) > 1:
        factors.setdefault('design', Choice(designs))
    runs = plan_size(method, flat_factors(factors), runs, repeats)
    if runs > MOST_RUNS:
        raise plan.error('runs', f'would be {runs}; at most {MOST_RUNS} can be asked for')
    duration = top.number('duration', above=0.0, high=1e4) if 'duration' in top else None
    spec = CampaignSpec(
        name=top.text('name'),
        seed=top.integer('seed', 1, low=0),
        method=method,
        runs=runs,
        arm=top.text('arm', 'paper'),
        scenario=top.text('scenario', 'two_faults'),
        duration=duration,
        designs=designs,
        factors=factors,
        substeps=top.integer('substeps', 2, low=1),
        twin=top.flag('twin', False),
        limit=top.integer('limit', 0, low=0),
        folder=folder,
    )
    plan.finish()
    top.finish()
    return spec


def flat_factors(factors: dict[str, Choice | Range | ByKind]) -> dict[str, Choice | Range]:
    """Factors as coordinates of a plan: one that goes by kind counts as one continuous number."""
    return {
        name: _widest(factor) if isinstance(factor, ByKind) else factor
        for name, factor in factors.items()
    }


def _widest(factor: ByKind) -> Choice | Range:
    return max(factor.kinds.values(), key=lambda kind: len(kind.units))


def _factors(data: dict[str, Any], source: str) -> dict[str, Choice | Range | ByKind]:
    factors, section = {}, Section(data, source, 'factors')
    for name, value in data.items():
        if name not in DEFAULTS and name not in _TUNING:
            raise section.error(
                name, 'is not a factor; there are ' + ', '.join([*DEFAULTS, *sorted(_TUNING)])
            )
        field = f'factors.{name}'
        kinds = KINDS if name in _BY_KIND else None
        factors[name] = factor = parse_factor(value, field, source, kinds)
        parts = factor.kinds.values() if isinstance(factor, ByKind) else (factor,)
        for part in parts:
            _check(part, name, section)
    return factors


def _check(factor: Choice | Range, name: str, section: Section) -> None:
    """Type and range of a factor's values."""
    values = factor.values if isinstance(factor, Choice) else (factor.low, factor.high)
    numeric = name in NUMBERS or name in _TUNING
    if isinstance(values[0], str) == numeric:
        raise section.error(name, 'must be a number' if numeric else 'must be a text')
    if numeric:
        low, high = NUMBERS.get(name, (0.0, _INF))
        if min(values) < low or max(values) > high:
            raise section.error(name, f'must lie within {low:g} and {high:g}')
        if name == 'sample_time' and not isinstance(factor, Choice):
            raise section.error(name, 'must be values: each one has gains of its own')
        if name == 'command_delay' and isinstance(factor, Choice) and any(v % 1.0 for v in values):
            raise section.error(name, 'counts samples: whole numbers')
        return
    known = {'fault.kind': (NO_FAULT, *KINDS), 'plant': PLANTS, 'compensation': COMPENSATION}
    for value in values:
        if name in known and value not in known[name]:
            raise section.error(name, f'{value!r} is none of ' + ', '.join(known[name]))
