"""The campaign file: what is run, what varies, how often."""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from lpv.core.control.tracking import COMPENSATION
from lpv.core.monitoring.parameters import DIAGNOSIS
from lpv.core.simulation.faults import KINDS, Fault, uses
from lpv.core.simulation.scenario import PLANTS, Scenario
from lpv.core.support.config import Section, as_number
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.limits import MOST_ENTRIES, MOST_SAMPLES

METHODS = ('factorial', 'random', 'latin_hypercube')
NO_FAULT, BOTH = 'none', 'both'
PATHS = ('scenario', 'random')


def _limits(kind: type, name: str) -> tuple[float, float]:
    """Range of a number of a scenario, or of its faults."""
    _, _, limits = kind.__dataclass_fields__[name].metadata['entry']  # type: ignore[attr-defined]
    return limits['low'], limits['high']


NUMBERS = {
    **{f'fault.{name}': _limits(Fault, name) for name in ('size', 'rate', 'onset', 'duration')},
    'fault.sign': (-1.0, 1.0),
    **dict.fromkeys(('noise', 'disturbance'), (0.0, 1e3)),
    **dict.fromkeys(('mass_1', 'mass_2', 'inertia_1', 'inertia_2'), (1e-3, 1e3)),
    'parameter_error': (0.0, 0.5),
    'payload': _limits(Scenario, 'payload'),
    'friction': (0.0, 100.0),
    'sample_time': (1e-5, 1.0),
    'command_delay': (0.0, 63.0),
    'sample_loss': (0.0, 0.999),
}
"""Factors that are numbers, and their ranges; units and meaning in docs/scenario-file.md."""
_BY_KIND = ('fault.size', 'fault.rate', 'fault.duration')
TEXTS = ('design', 'path', 'plant', 'compensation', 'fault.kind', 'fault.sensor')
"""Factors that are texts."""
DEFAULTS: dict[str, Any] = {
    **dict.fromkeys((*TEXTS, *NUMBERS)),
    'path': 'scenario',
    'compensation': 'confirmed',
    'fault.kind': NO_FAULT,
    'fault.onset': 5.0,
    **dict.fromkeys((*_BY_KIND, 'command_delay', 'sample_loss'), 0.0),
}
"""Where the file is silent; None: as scenario or arm file, the first one, a sign by chance."""
TUNING = {f'diagnosis.{one.name}': one.limits for one in DIAGNOSIS if one.limits}
"""Factors that are numbers of the diagnosis, and their ranges."""


@dataclass(frozen=True)
class Choice:
    """One of several values; a fixed value is a choice of one."""

    values: tuple  # Numbers or texts

    def value(self, unit: float, _kind: str) -> Any:
        """Value for a number of [0, 1)."""
        return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Range:
    """A number between two ends, uniform in its value or in its logarithm."""

    low: float = entry('number')  # Lower end
    high: float = entry('number')  # Upper end
    # Whether its value or its logarithm is uniform
    spacing: str = entry('text', default='linear', choices=('linear', 'log'))
    # Values in a factorial plan, both ends among them: there it is a choice of these
    levels: int = entry('integer', default=2, low=2)

    def value(self, unit: float, _kind: str) -> float:
        """Value for a number of [0, 1]."""
        if self.spacing == 'log':
            return self.low * (self.high / self.low) ** unit
        return self.low + unit * (self.high - self.low)


@dataclass(frozen=True)
class ByKind:
    """Another choice or range for each kind of fault; one number of the plan stands for all."""

    kinds: dict  # Kinds that are left out give 0

    def value(self, unit: float, kind: str) -> Any:
        """Value of a kind for a number of [0, 1]."""
        return self.kinds[kind].value(unit, kind) if kind in self.kinds else 0.0

    def __len__(self) -> int:
        return max(len(factor) for factor in self.kinds.values())


Factor = Choice | Range | ByKind


@dataclass(frozen=True)
class CampaignSpec:
    """A campaign file."""

    method: str  # One of `METHODS`
    runs: int  # Number of runs
    factors: dict  # What varies, and what is fixed to another value than the default
    name: str = entry('text')  # Name
    # Seed of the plan and, with the number of a run, of the run
    seed: int = entry('integer', default=1, low=0)
    arm: str = entry('text', default='paper')  # Arm file, or name of a shipped arm
    # Base scenario: a file, or name of a shipped one
    scenario: str = entry('text', default='two_faults')
    # Length of a run [s]; None: the scenario's
    duration: float | None = entry('number', default=None, above=0.0, high=1e4)
    # Requirement or gains files, or names of shipped requirements
    designs: tuple = entry('names', default=('paper',))
    substeps: int = entry('integer', default=2, low=1)  # Runge-Kutta steps of the plant per sample
    # Whether each run with a fault is repeated without it, for the ratio of tracking errors
    twin: bool = entry('flag', default=False)


def parse_spec(data: dict[str, Any], source: str = 'campaign') -> CampaignSpec:
    """Campaign of its file's mapping, validated as far as can be without the arm; ConfigError."""
    top = Section(data, source)
    plan = top.section('plan')
    method = plan.text('method', choices=METHODS)
    factors: dict[str, Any] = _factors(top.plain('factors'), source, method == 'factorial')
    designs = top.names('designs', default=('paper',))
    if len(designs) > 1:
        factors.setdefault('design', Choice(designs))
    if method == 'factorial':
        runs = plan.integer('repeats', 1, low=1) * math.prod(map(len, factors.values()))
    else:
        runs = plan.integer('runs', low=1)
    if runs > MOST_SAMPLES:
        raise plan.error('runs', f'would be {runs}; at most {MOST_SAMPLES} can be asked for')
    plan.finish()
    _check_faults(factors, Section({}, source, 'factors.fault'))
    return read_entries(CampaignSpec, top, method=method, runs=runs, factors=factors)


def _factors(data: dict[str, Any], source: str, factorial: bool) -> dict[str, Factor]:
    factors, section = dict[str, Factor](), Section(data, source, 'factors')
    for name, value in data.items():
        if name not in DEFAULTS and name not in TUNING:
            known = ', '.join([*DEFAULTS, *sorted(TUNING)])
            raise section.error(name, f'is not a factor; there are {known}')
        factors[name] = _factor(section, name, value, factorial)
    # Without a kind the scenario's faults are injected, whatever the campaign says of others.
    for name in () if 'fault.kind' in factors else factors:
        if name.startswith('fault.'):
            raise section.error(name, 'counts only with fault.kind, which is missing')
    return factors


def _factor(section: Section, name: str, data: Any, factorial: bool) -> Factor:
    """Read a factor: a value, a list of values, ``{low, high, ...}``, or one of these by kind."""
    keys = set(map(str, data)) if isinstance(data, dict) else set()
    if name not in _BY_KIND or not keys or keys & {one.name for one in fields(Range)}:
        return _any_kind(section, name, data, name, factorial)
    if unknown := sorted(keys - set(KINDS)):
        known = ', '.join(KINDS)
        raise section.error(name, f'has no kind of fault {unknown[0]!r}; known are {known}')
    kinds = section.section(name)
    each = {kind: _any_kind(kinds, kind, one, name, factorial) for kind, one in data.items()}
    return ByKind(each)


def _any_kind(section: Section, key: str, data: Any, name: str, factorial: bool) -> Choice | Range:
    """What a field says of a factor for any kind of fault; type and range are checked."""
    is_range, numeric = isinstance(data, dict), name not in TEXTS
    factor = _range(section, key) if is_range else _choice(section, key, data, numeric)
    values = factor.values if isinstance(factor, Choice) else (factor.low, factor.high)
    if isinstance(values[0], str) == numeric:
        raise section.error(key, 'must be a number' if numeric else 'must be a text')
    if numeric:
        low, high = {**NUMBERS, **TUNING}[name]
        if min(values) < low or max(values) > high:
            raise section.error(key, f'must lie within {low:g} and {high:g}')
        if name == 'sample_time' and is_range:
            raise section.error(key, 'must be values: each one has gains of its own')
        if name == 'command_delay' and not is_range and any(v % 1.0 for v in values):
            raise section.error(key, 'counts samples: whole numbers')
    known = {'fault.kind': (NO_FAULT, *KINDS), 'plant': PLANTS, 'compensation': COMPENSATION}
    for value in values:
        if name in known and value not in known[name]:
            raise section.error(key, f'{value!r} is none of ' + ', '.join(known[name]))
    if factorial and isinstance(factor, Range):
        shares = [k / (factor.levels - 1) for k in range(factor.levels)]
        return Choice(tuple(factor.value(share, '') for share in shares))
    return factor


def _check_faults(factors: dict[str, Factor], section: Section) -> None:
    """Refuse sizes and rates with which a fault of a kind would do nothing, or that none has."""
    kinds = [kind for kind in getattr(factors.get('fault.kind'), 'values', ()) if kind != NO_FAULT]
    for name in ('size', 'rate'):
        factor = factors.get(f'fault.{name}', Choice((DEFAULTS[f'fault.{name}'],)))
        if f'fault.{name}' in factors and not any(uses(kind, name) for kind in kinds):
            raise section.error(name, 'counts for none of ' + ', '.join(kinds or [NO_FAULT]))
        for kind in kinds:
            for value in _values(factor, kind):
                Fault('', kind, 0.0, **{'size': 1.0, 'rate': 1.0, name: value}).check(section)


def _values(factor: Factor, kind: str) -> tuple[float, ...]:
    """Values for a kind of fault: all, or the ends of what lies between them."""
    one = factor.kinds.get(kind, Choice((0.0,))) if isinstance(factor, ByKind) else factor
    if isinstance(one, Range):
        return one.low or one.high, one.high or one.low  # 0 itself is never drawn
    return tuple(one.values)


def _choice(section: Section, key: str, data: Any, numeric: bool) -> Choice:
    values = tuple(data) if isinstance(data, list) else (data,)
    values = tuple(map(as_number, values)) if numeric else values
    reason = ''
    if not 1 <= len(values) <= MOST_ENTRIES:
        reason = f'must list 1 to {MOST_ENTRIES} values'
    elif not all(type(v) is str or (type(v) in (int, float) and math.isfinite(v)) for v in values):
        reason = 'must be finite numbers or texts'
    elif len({isinstance(v, str) for v in values}) > 1:
        reason = 'must not mix numbers and texts'
    elif len(set(values)) < len(values):
        reason = 'lists a value twice'
    if reason:
        raise section.error(key, reason)
    return Choice(tuple(v if isinstance(v, str) else float(v) for v in values))


def _range(section: Section, key: str) -> Range:
    inside = section.section(key)
    found = read_entries(Range, inside)
    if not found.low < found.high:
        raise section.error(key, 'must have a low below a high')
    if found.spacing == 'log' and found.low <= 0.0:
        raise inside.error('low', 'must be positive for logarithmic spacing')
    if found.levels > MOST_ENTRIES:
        raise inside.error('levels', f'must be at most {MOST_ENTRIES}')
    return found


class Plan:
    """Points of the unit cube, one a run; each follows from seed and number alone."""

    def __init__(self, spec: CampaignSpec) -> None:
        self._spec = spec
        if spec.method == 'latin_hypercube':
            rng = np.random.default_rng([spec.seed, 0])
            strata = [rng.permutation(spec.runs) for _ in spec.factors]
            self._strata = np.array(strata, int).reshape(len(strata), spec.runs).T

    def point(self, number: int) -> np.ndarray:
        """Coordinates of a run in [0, 1], one a factor."""
        spec, factors = self._spec, self._spec.factors.values()
        if spec.method == 'factorial':
            counts = np.array([len(factor) for factor in factors], int)
            place = np.unravel_index(number % math.prod(counts.tolist()), counts)
            return (np.array(place) + 0.5) / counts
        offset = np.random.default_rng([spec.seed, 1, number]).random(len(factors))
        if spec.method == 'random':
            return offset
        return (self._strata[number] + offset) / spec.runs
