"""Dataclasses that are sections of a file: each field says how its entry is read."""

from dataclasses import MISSING, field, fields
from typing import Any, TypeVar

import numpy as np

from lpv.core.support.config import Section

_Kind = TypeVar('_Kind')


def entry(how: str, *details: Any, default: Any = MISSING, **limits: Any) -> Any:
    """A field that the method ``how`` of `Section` reads, with its arguments.

    One whose default is None may be missing.
    """
    if default is not MISSING and default is not None:
        limits['default'] = default
    return field(default=default, metadata={'entry': (how, details, limits)})


def array(*shape: int, **limits: float) -> Any:
    """A field that is an array, row by row; see `Section.matrix`."""
    return entry('matrix', shape, **limits)


def positive(high: float = np.inf) -> Any:
    """A field that is a positive number."""
    return entry('number', above=0.0, high=high)


def part(kind: Any, default: Any = MISSING) -> Any:
    """A field that is a section of its own, of another dataclass."""
    return field(default=default, metadata={'part': kind})


def read_entries(kind: type[_Kind], section: Section, **given: Any) -> _Kind:
    """What a section says, without the fields that are given.

    ConfigError if anything is missing, unknown, of the wrong size or out of range.
    """
    values = dict(given)
    for one in fields(kind):  # type: ignore[arg-type]
        name = one.name
        if name in given or (one.default is None and name not in section):
            continue
        if 'entry' in one.metadata:
            how, details, limits = one.metadata['entry']
            value = getattr(section, how)(name, *details, **limits)
            values[name] = tuple(value) if isinstance(value, list) else value
        elif 'part' in one.metadata:
            values[name] = read_entries(one.metadata['part'], section.section(name))
    section.finish()
    return kind(**values)


def plain_entries(data: Any) -> Any:
    """The mapping that `read_entries` reads: plain data, arrays row by row; no fields of None."""
    if isinstance(data, np.ndarray):
        return [float(value) for value in data.ravel()]
    if isinstance(data, (str, dict)):
        return data
    if not hasattr(data, '__dataclass_fields__'):
        return float(data)
    return {name: plain_entries(v) for name, v in vars(data).items() if v is not None}
