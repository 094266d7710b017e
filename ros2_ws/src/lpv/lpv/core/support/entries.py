"""Dataclasses that are sections of a file: each field says how its entry is read and written."""

import math
from dataclasses import MISSING, Field, field, fields
from typing import Any, TypeVar

import numpy as np

from lpv.core.support.config import Section
from lpv.core.support.errors import ConfigError, kept, raise_all

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
    """A field that is a section of its own, of another dataclass, or that which a function of the
    section says."""
    return field(default=default, metadata={'part': kind})


def part_by(key: str, **kinds: type) -> Any:
    """A field that is a section of its own, whose text ``key`` names its dataclass."""
    return part(lambda section: kinds[section.text(key, choices=kinds)])


def _place(one: Field[Any]) -> tuple[str, str]:
    """Section and key of a field; no section where it is in that of its dataclass."""
    section, _, key = one.metadata.get('at', one.name).rpartition('.')
    return section, key


def read_entries(
    kind: type[_Kind], section: Section, base: _Kind | None = None, **given: Any
) -> _Kind:
    """What a section says, without the fields that are given; ``base`` has what it does not say.

    Functions among what is given are called for their field.  One ConfigError names all fields that
    are missing, unknown, of the wrong size or out of range, or what the dataclass's own ``check``
    finds in the section then.
    """
    places = {'': section}
    errors: list[ConfigError] = []
    for one in fields(kind):  # type: ignore[arg-type]
        with kept(errors):
            if one.name not in given:
                _read_entry(one, places, base, given)
            elif callable(given[one.name]):
                given[one.name] = given[one.name]()
    for place in places.values():
        with kept(errors):
            place.finish()
    raise_all(errors)
    result = kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})
    if hasattr(result, 'check'):
        result.check(section)
    return result


def _read_entry(
    one: Field[Any], places: dict[str, Section], base: Any, given: dict[str, Any]
) -> None:
    """Add a field to what is given, unless its default holds; ``places`` are sections by name."""
    inner, key = _place(one)
    optional = base is not None or one.default is not MISSING
    if inner not in places or (inner and not optional and inner not in places['']):
        places[inner] = places[''].section(inner, required=not optional)
    if not one.metadata or (optional and key not in places[inner]):
        if base is not None:
            given[one.name] = getattr(base, one.name)
    elif 'part' in one.metadata:
        inside, part = places[inner].section(key), one.metadata['part']
        part = part if isinstance(part, type) else part(inside)
        given[one.name] = read_entries(part, inside)
    else:
        how, details, limits = one.metadata['entry']
        given[one.name] = getattr(places[inner], how)(key, *details, **limits)


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
