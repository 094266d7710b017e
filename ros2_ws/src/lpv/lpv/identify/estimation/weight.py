"""Whether recorded efforts contain the torque that holds the arm's weight.

Some drivers report efforts with the weight taken out.  Both assumptions are fitted, and each
predicts blocks of the data that were held back.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv.identify.estimation.regression import Filters, Rows, fit_parameters
from lpv.identify.estimation.selection import validation_error
from lpv.identify.model.prior import Prior

_SLOPE = 50.0  # of the Coulomb term while this is decided [s/rad]
_SURE = 2.0  # ratio of errors above which one assumption is preferred


@dataclass(frozen=True)
class WeightEvidence:
    """How well the efforts are predicted with the weight and without it."""

    with_weight: np.ndarray  # RMS error of each joint on data held back, shape (n,) [N m]
    without_weight: np.ndarray  # the same if efforts do not contain the weight

    @property
    def ratio(self) -> float:
        """Error without the weight by that with it, at the joint where they differ most."""
        ratios = np.log(self.without_weight / self.with_weight)
        return float(np.exp(ratios[np.argmax(np.abs(ratios))]))

    @property
    def contains_weight(self) -> bool | None:
        """What the data say; None if they do not tell."""
        return None if 1.0 / _SURE < self.ratio < _SURE else self.ratio > 1.0


def error_of(rows: Sequence[Rows], filters: Filters, prior: Prior) -> np.ndarray:
    """RMS error of each joint on data held back of the training data, shape (n,) [N m]."""
    n = rows[0].effort.shape[1]
    slope, no_load = np.full(n, _SLOPE), np.zeros(n, bool)
    squares = validation_error(
        rows, filters, lambda part: fit_parameters(part, filters, no_load, prior, slope)
    )
    return np.sqrt(np.maximum(squares, 1e-24))
