"""Kinds of faults, and what each may turn out to be."""

from enum import IntEnum

import numpy as np


class FaultKind(IntEnum):
    """What an alarm may be called."""

    BIAS = 0
    """A constant error."""
    DRIFT = 1
    """An error that grows with time."""
    SCALE = 2
    """An error in proportion to the angle."""
    STUCK = 3
    """A reading that stands still while the arm moves."""
    NOISE = 4
    """More noise than a healthy reading has."""
    SPIKE = 5
    """Excursions of a few samples."""
    DROPOUT = 6
    """No readings."""
    INCONSISTENT = 7
    """Cause unknown: rates, torques and model contradict each other, or it may be the rate sensor's
    fault."""
    UNCLASSIFIED = 8
    """A fault of the position sensor whose kind is not known yet."""


KINDS = tuple(kind.name.lower() for kind in FaultKind)
"""Names of the kinds in messages."""

# Plain numbers for compiled functions.
BIAS, DRIFT, SCALE, STUCK, NOISE, SPIKE, DROPOUT, INCONSISTENT, UNCLASSIFIED = (
    int(kind) for kind in FaultKind
)

TIME_PROFILES = (BIAS, DRIFT, SCALE, UNCLASSIFIED)
"""A lasting error of the reading that follows a time profile."""
WITHOUT_SIZE = (STUCK, NOISE, SPIKE)
"""No lasting size: over when the reading has settled."""
SCATTERED = (NOISE, SPIKE)
"""Single samples are wrong, their mean is not."""

_MAY_BECOME = {
    UNCLASSIFIED: (BIAS, DRIFT, SCALE, STUCK, NOISE, INCONSISTENT),
    BIAS: (DRIFT, SCALE, STUCK, NOISE, INCONSISTENT),
    DRIFT: (BIAS, SCALE, STUCK, NOISE, INCONSISTENT),
    SCALE: (BIAS, DRIFT, STUCK, NOISE, INCONSISTENT),
    SPIKE: (NOISE,),
    DROPOUT: (UNCLASSIFIED,),  # readings that come back wrong
    INCONSISTENT: (UNCLASSIFIED, STUCK, NOISE),  # the position sensor's after all
    STUCK: (),
    NOISE: (),
}
MAY_BECOME = np.array([[new in _MAY_BECOME[kind] for new in FaultKind] for kind in FaultKind])
"""Whether an alarm of a kind (row) may be updated to another (column)."""
