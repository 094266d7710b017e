"""Dataclasses that are sections of a file: each field says how its entry is read and written."""

import math
from dataclasses import MISSING, Field, field, fields
from typing import Any, TypeVar

import numpy as np

from lpv.core.support.config import Section

_Kind = TypeVar('_Kind')
_NOTHING = (None, '', (), math.inf, -math.inf)
"""Defaults that say nothing: not known, none, no limit."""


def entry(how: str, *details: Any, default: Any = MISSING, at: str = '', **limits: Any) -> Any:
    """A field that the method ``how`` of `Section` reads, with its arguments.

    One with a default may be missing.  ``at`` is its place in the file where that is not the
    field's name: ``section.key``.
    """
    place = {'at': at} if at else {}
    return field(default=default, metadata={'entry': (how, details, limits), **place})


def array(*shape: int, **limits: Any) -> Any:
    """A field that is an array, row by row; see `Section.matrix`."""
    return entry('matrix', shape, **limits)


def positive(high: float = np.inf) -> Any:
    """A field that is a positive number."""
    return entry('number', above=0.0, high=high)


def part(kind: Any, default: Any = MISSING) -> Any:
    """A field that is a section of its own, of another dataclass."""
    return field(default=default, metadata={'part': kind})


def _place(one: Field[Any]) -> tuple[str, str]:
    """Section and key of a field; no section where it is in that of its dataclass."""
    section, _, key = one.metadata.get('at', one.name).rpartition('.')
    return section, key


def read_entries(
    kind: type[_Kind], section: Section, base: _Kind | None = None, **given: Any
) -> _Kind:
    """What a section says, without the fields that are given; ``base`` has what it does not say.

    ConfigError if anything is missing, unknown, of the wrong size or out of range.
    """
    places = {'': section}
    for one in fields(kind):  # type: ignore[arg-type]
        inner, key = _place(one)
        if one.name in given:
            continue
        optional = base is not None or one.default is not MISSING
        if inner not in places:
            places[inner] = section.section(inner, required=not optional)
        if not one.metadata or (optional and key not in places[inner]):
            if base is not None:
                given[one.name] = getattr(base, one.name)
        elif 'part' in one.metadata:
            given[one.name] = read_entries(one.metadata['part'], places[inner].section(key))
        else:
            how, details, limits = one.metadata['entry']
            given[one.name] = getattr(places[inner], how)(key, *details, **limits)
    for place in places.values():
        place.finish()
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def plain_entries(data: Any) -> Any:
    """The mapping that `read_entries` reads: plain data, arrays row by row.

    Fields that say nothing are left out: the default is `_NOTHING`, and they have it.
    """
    if isinstance(data, np.ndarray):
        return [float(value) for value in data.ravel()]
    if isinstance(data, tuple):
        return [plain_entries(value) for value in data]
    if not hasattr(data, '__dataclass_fields__'):
        return float(data) if isinstance(data, float) else data  # also of NumPy's floats
    result: dict[str, Any] = {}
    for one in fields(data):
        (inner, key), value = _place(one), getattr(data, one.name)
        if not (one.default in _NOTHING and value == one.default):
            (result.setdefault(inner, {}) if inner else result)[key] = plain_entries(value)
    return result
