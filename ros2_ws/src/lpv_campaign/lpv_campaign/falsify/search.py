"""Search for the healthy run that comes nearest to its threshold: random, structured, CMA-ES."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from cmaes import CMA

_RANDOM = 0.2
"""Share of evaluations at random, beside the structured ones."""
_PATIENCE = 60
"""Generations of one optimisation before it starts again elsewhere."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Finding:
    """One evaluated attack."""

    ratio: float  # largest abs(f^)/threshold; 1 or more breaks the guarantee
    sensor: int  # of which sensor
    time: float  # when [s]
    threshold: float  # what it was compared with [rad]
    attack: Any  # what was done
    ratios: tuple[float, ...] = ()  # of each sensor, the largest of all runs
    thresholds: tuple[float, ...] = ()  # at these ratios [rad]


class Attacker(Protocol):
    """Healthy runs of one arm against its own thresholds.

    Attributes
    ----------
    numbers : int
        Numbers of a candidate, each in [-1, 1].
    """

    @property
    def arm(self) -> Any:
        """The arm, of either kind."""

    numbers: int

    def structured(self, rng: np.random.Generator) -> list[FloatArray]:
        """Candidates that an engineer would try."""

    def attack(self, candidate: FloatArray, seed: int) -> Any:
        """Attack of a candidate, with a seed of the noise."""

    def run(self, attack: Any) -> Finding:
        """Simulate one attack."""

    def readings(self) -> FloatArray:
        """Readings, rates and efforts of the last run, shape (N, 3, n)."""

    def as_dict(self, attack: Any) -> dict[str, Any]:
        """Plain numbers of an attack, for a file."""

    def from_dict(self, data: dict[str, Any]) -> Any:
        """Attack from `as_dict`."""


def search(
    attacker: Attacker,
    evaluations: int,
    seed: int = 0,
    progress: Callable[[int, Finding], None] | None = None,
) -> Finding:
    """Find the worst attack.

    Parameters
    ----------
    attacker : Attacker
        Arm and thresholds.
    evaluations : int
        Runs.
    seed : int, optional
        Of the search.
    progress : callable, optional
        Called with the number of runs and the worst finding whenever there is a worse one.

    Returns
    -------
    Finding
        The worst one; its ``ratios`` are the largest of all runs.
    """
    rng = np.random.default_rng(seed)
    candidates = _candidates(attacker, rng, evaluations)
    worst: Finding | None = None
    every: list[Finding] = []
    candidate = next(candidates)
    for count in range(evaluations):
        found = attacker.run(attacker.attack(candidate, int(rng.integers(2**31))))
        every.append(replace(found, attack=None))
        if worst is None or found.ratio > worst.ratio:
            worst = found
            if progress is not None:
                progress(count + 1, worst)
        candidate = candidates.send(found.ratio)
    assert worst is not None
    most = [max(every, key=lambda one: one.ratios[i]) for i in range(len(worst.ratios))]
    return replace(
        worst,
        ratios=tuple(one.ratios[i] for i, one in enumerate(most)),
        thresholds=tuple(one.thresholds[i] for i, one in enumerate(most)),
    )


def _candidates(
    attacker: Attacker, rng: np.random.Generator, evaluations: int
) -> Generator[FloatArray, float, None]:
    """Candidates; each is answered by its ratio."""
    size = attacker.numbers
    best: list[tuple[float, FloatArray]] = []
    first = attacker.structured(rng)
    rest = max(0, round(_RANDOM * evaluations) - len(first))
    for candidate in [*first, *rng.uniform(-1.0, 1.0, (rest, size))]:
        ratio = yield candidate
        best.append((ratio, candidate))
    best.sort(key=lambda pair: -pair[0])
    for start in range(2**31):
        mean = best[start % max(1, min(len(best), 8))][1]
        optimiser = CMA(
            mean=0.95 * mean,
            sigma=0.3,
            bounds=np.tile([-1.0, 1.0], (size, 1)),
            seed=int(rng.integers(2**31)),
        )
        for _ in range(_PATIENCE):
            answers = []
            for _ in range(optimiser.population_size):
                candidate = optimiser.ask()
                ratio = yield candidate
                answers.append((candidate, -ratio))
            optimiser.tell(answers)
            if optimiser.should_stop():
                break
