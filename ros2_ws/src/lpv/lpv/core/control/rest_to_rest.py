"""Quintic splines through timed points, at rest at both ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lpv.core.support.errors import ConfigError

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


def checked_times(times: Sequence[float]) -> np.ndarray:
    """Times of waypoints [s]; ConfigError if they are not two or more that increase."""
    knots = np.asarray(times, float)
    if len(knots) < 2:
        raise ConfigError('path.waypoints', 'must be two or more')
    if not (np.isfinite(knots).all() and np.all(np.diff(knots) > 0)):
        raise ConfigError('path.waypoints', 'times must increase')
    return knots


def rest_to_rest(knots: np.ndarray, points: np.ndarray) -> BSpline:
    """Spline through points, shape (m, n), at times, shape (m,) [s].

    Rates and accelerations vanish at both ends; the jerk is continuous inside.
    """
    # Here: it loads for 0.2 s, and not every program that reads a scenario follows its path.
    from scipy.interpolate import make_interp_spline

    still = np.zeros(points.shape[1])
    rest = [(1, still), (2, still)]
    return make_interp_spline(knots, points, k=5, bc_type=(rest, rest))
