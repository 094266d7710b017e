"""Errors of bags."""

from lpv.core.support.errors import LpvError


class BagError(LpvError):
    """A bag cannot be read, or does not hold what is needed."""


class DamageError(BagError):
    """Bytes of a bag do not form what they claim to be."""
