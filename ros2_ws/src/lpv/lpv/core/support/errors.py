"""Errors that name what is wrong and where."""

import copyreg
from typing import Any


class LpvError(ValueError):
    """Base of every error that this software raises on bad input."""


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
    """

    def __init__(self, field: str, reason: str, source: str = '') -> None:
        self.field = field
        self.reason = reason
        self.source = source
        where = f'{source}: ' if source else ''
        super().__init__(f'{where}{field}: {reason}')

    def __reduce__(self) -> tuple[Any, ...]:
        """What makes a copy in another process: the text is there, and not made again."""
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class UnreachableError(LpvError):
    """A Cartesian point is outside the arm's annulus of reach."""


class SampleError(LpvError):
    """A sample cannot be used (wrong size, unknown joints, not finite)."""
