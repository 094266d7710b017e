"""Which values the factors of a run take: full factorial, random, or Latin hypercube."""

import math
from typing import Any

import numpy as np

METHODS = ('factorial', 'random', 'latin_hypercube')
MOST_RUNS = 10_000_000


def plan_size(method: str, factors: dict[str, Any], runs: int, repeats: int) -> int:
    """Number of runs of a plan."""
    if method != 'factorial':
        return runs
    return repeats * math.prod(len(factor.units) for factor in factors.values())


class Plan:
    """Points of the unit cube, one a run; each follows from seed and number alone.

    Parameters
    ----------
    method : str
        One of `METHODS`.
    factors : dict of str to Choice or Range
        What varies, in the order of the coordinates.
    size : int
        Number of runs.
    seed : int
        Seed of the plan.
    """

    def __init__(self, method: str, factors: dict[str, Any], size: int, seed: int) -> None:
        self._method, self._seed, self._width = method, seed, len(factors)
        self._levels = [factor.units for factor in factors.values()]
        self._strata = None
        if method == 'latin_hypercube':
            rng = np.random.default_rng([seed, 0])
            self._strata = (
                np.stack([rng.permutation(size) for _ in factors], axis=1)
                if factors
                else np.zeros((size, 0), int)
            )
            self._size = size

    def point(self, number: int) -> np.ndarray:
        """Coordinates of a run.

        Returns ndarray of shape (number of factors,): In [0, 1].
        """
        if self._method == 'factorial':
            counts = [len(levels) for levels in self._levels]
            place = np.unravel_index(number % math.prod(counts), counts) if counts else ()
            return np.array([levels[k] for levels, k in zip(self._levels, place)], float)
        offset = np.random.default_rng([self._seed, 1, number]).random(self._width)
        if self._strata is None:
            return offset
        return (self._strata[number] + offset) / self._size
