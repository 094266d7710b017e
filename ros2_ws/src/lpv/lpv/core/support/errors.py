"""Errors that name what is wrong and where."""

import copyreg
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar


class LpvError(ValueError):
    """Base of every error that this software raises on bad input."""


_Item = TypeVar('_Item')
_Result = TypeVar('_Result')
_LONGEST = 1600
"""Most characters of the text that names all wrong fields: 20 lines of a terminal."""


class ConfigError(LpvError):
    """A file or parameter is invalid.

    Parameters
    ----------
    field : str
        Dotted name of the offending field, e.g. ``links[0].mass``.
    reason : str
        What is wrong with it, and what would be right.
    source : str, optional
        The file or node that the field comes from.
    texts : sequence of str, optional
        Of several wrong fields, this one the first, field and reason of each.
    """

    def __init__(
        self, field: str, reason: str, source: str = '', texts: Sequence[str] = ()
    ) -> None:
        self.field = field
        self.reason = reason
        self.source = source
        self.texts = tuple(texts) or (f'{field}: {reason}',)
        text = self.texts[0]
        if len(self.texts) > 1:
            text = '; '.join(f'({i}) {one}' for i, one in enumerate(self.texts, start=1))
            text = text if len(text) <= _LONGEST else text[:_LONGEST] + ' ...'
            text = f'{len(self.texts)} fields are wrong: {text}'
        super().__init__(f'{source}: {text}' if source else text)

    def __reduce__(self) -> tuple[Any, ...]:
        """What makes a copy in another process: the text is there, and not made again."""
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


@contextmanager
def kept(errors: list[ConfigError]) -> Iterator[None]:
    """Context whose ConfigError goes to a list, for `raise_all`; what follows it goes on."""
    try:
        yield
    except ConfigError as error:
        errors.append(error)


def raise_all(errors: Sequence[ConfigError]) -> None:
    """Raise one ConfigError in place of several, which names all fields; nothing without any."""
    if errors:
        first, texts = errors[0], [text for error in errors for text in error.texts]
        raise ConfigError(first.field, first.reason, first.source, list(dict.fromkeys(texts)))


def each(read: Callable[[_Item], _Result], items: Iterable[_Item]) -> tuple[_Result, ...]:
    """What a function reads from each item; one ConfigError names all that is wrong with them."""
    errors: list[ConfigError] = []
    found = []
    for item in items:
        with kept(errors):
            found.append(read(item))
    raise_all(errors)
    return tuple(found)


class UnreachableError(LpvError):
    """A Cartesian point is outside the arm's annulus of reach."""


class SampleError(LpvError):
    """A sample cannot be used (wrong size, unknown joints, not finite)."""
