"""What varies from run to run: fixed values, choices, ranges, each as a map from [0, 1)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lpv.core.support.config import Section, as_number
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import MOST_ENTRIES

_KEYS = {'low', 'high', 'spacing', 'levels'}


@dataclass(frozen=True)
class Choice:
    """One of several values; a fixed value is a choice of one."""

    values: tuple  # Numbers or texts

    def value(self, unit: float) -> Any:
        """Value for a number of [0, 1)."""
        return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]

    @property
    def units(self) -> tuple[float, ...]:
        """Numbers of [0, 1) that give each value once, for a factorial plan."""
        return tuple((k + 0.5) / len(self.values) for k in range(len(self.values)))


@dataclass(frozen=True)
class Range:
    """A number between two ends, uniform in its value or in its logarithm."""

    low: float  # Lower end
    high: float  # Upper end
    logarithmic: bool = False  # Whether the logarithm is uniform
    levels: int = 2  # Values in a factorial plan, both ends among them

    def value(self, unit: float) -> float:
        """Value for a number of [0, 1]."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** unit
        return self.low + unit * (self.high - self.low)

    @property
    def units(self) -> tuple[float, ...]:
        """Numbers of [0, 1] that give the levels of a factorial plan."""
        return tuple(k / (self.levels - 1) for k in range(self.levels))


@dataclass(frozen=True)
class ByKind:
    """Another choice or range for each kind of fault."""

    kinds: dict  # Kinds that are left out give 0

    def of(self, kind: str) -> Choice | Range:
        """Choice or range of a kind."""
        return self.kinds.get(kind, Choice((0.0,)))


def parse_factor(
    data: object, name: str, source: str, kinds: Sequence[str] | None = None, numeric: bool = True
) -> Choice | Range | ByKind:
    """Read a factor: a value, a list of values, ``{low, high, ...}``, or one of these by kind."""
    if not isinstance(data, dict):
        return _choice(data, name, source, numeric)
    if kinds is not None and data and not _KEYS & set(data):
        unknown = sorted(set(map(str, data)) - set(kinds))
        if unknown:
            raise ConfigError(
                name, f'has no kind of fault {unknown[0]!r}; known are ' + ', '.join(kinds), source
            )
        return ByKind(
            {kind: parse_factor(value, f'{name}.{kind}', source) for kind, value in data.items()}
        )
    return _range(data, name, source)


def _choice(data: Any, name: str, source: str, numeric: bool) -> Choice:
    values = tuple(data) if isinstance(data, list) else (data,)
    values = tuple(map(as_number, values)) if numeric else values
    reason = ''
    if not 1 <= len(values) <= MOST_ENTRIES:
        reason = f'must list 1 to {MOST_ENTRIES} values'
    elif not all(isinstance(v, str) or _is_number(v) for v in values):
        reason = 'must be finite numbers or texts'
    elif len({isinstance(v, str) for v in values}) > 1:
        reason = 'must not mix numbers and texts'
    elif len(set(values)) < len(values):
        reason = 'lists a value twice'
    if reason:
        raise ConfigError(name, reason, source)
    return Choice(tuple(v if isinstance(v, str) else float(v) for v in values))


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def _range(data: dict[str, Any], name: str, source: str) -> Range:
    section = Section(data, source, name)
    low, high = section.number('low'), section.number('high')
    logarithmic = section.text('spacing', 'linear', ('linear', 'log')) == 'log'
    levels = section.integer('levels', 2, low=2)
    section.finish()
    if not low < high:
        raise ConfigError(name, 'must have a low below a high', source)
    if logarithmic and low <= 0.0:
        raise section.error('low', 'must be positive for logarithmic spacing')
    if levels > MOST_ENTRIES:
        raise section.error('levels', f'must be at most {MOST_ENTRIES}')
    return Range(low, high, logarithmic, levels)
