"""Errors of the identification."""

from lpv.core.support.errors import LpvError


class IdentificationError(LpvError):
    """A recording cannot identify the arm; the message says why, and what would help."""
