"""Whether recorded efforts contain the torque that holds the arm's weight.

Some drivers report efforts with the weight taken out.  Both assumptions are fitted, and each
predicts blocks of the data that were held back.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_identify.estimation.regression import Filters, Prior, Rows, fit_parameters
from lpv_identify.estimation.selection import validation_error

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
        if 1.0 / _SURE < self.ratio < _SURE:
            return None
        return self.ratio > 1.0


def weigh(
    with_weight: Sequence[Rows], without_weight: Sequence[Rows], filters: Filters, prior: Prior
) -> WeightEvidence:
    """Compare both assumptions.

    Parameters
    ----------
    with_weight, without_weight : sequence of Rows
        Training data under either assumption.
    filters : Filters
        Of the regression.
    prior : Prior
        Of all parameters; a weak one.

    Returns
    -------
    WeightEvidence
        Errors of both.
    """
    n = with_weight[0].effort.shape[1]
    slope, no_load = np.full(n, _SLOPE), np.zeros(n, bool)

    def error(rows: Sequence[Rows]) -> np.ndarray:
        squares = validation_error(
            rows, filters, lambda part: fit_parameters(part, filters, no_load, prior, slope)
        )
        return np.sqrt(np.maximum(squares, 1e-24))

    return WeightEvidence(error(with_weight), error(without_weight))
