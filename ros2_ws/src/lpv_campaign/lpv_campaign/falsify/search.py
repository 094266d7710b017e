"""Search for the healthy run that comes nearest to its threshold: random, structured, CMA-ES."""

from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np
from cmaes import CMA

from lpv_campaign.falsify.attack import NUMBERS, make_attack, make_setup, structured_candidates
from lpv_campaign.falsify.healthy_run import WORK, run_healthy
from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.support.records import new_record

COLUMNS = 12
"""Signals of a run: see `run_healthy`."""
_RANDOM = 0.2
"""Share of evaluations at random, beside the structured ones."""
_PATIENCE = 60
"""Generations of one optimisation before it starts again elsewhere."""


@dataclass(frozen=True)
class Finding:
    """One evaluated attack.

    Attributes
    ----------
    ratio : float
        Largest abs(f^)/threshold; 1 or more breaks the guarantee.
    sensor : int
        Of which sensor.
    time : float
        When [s].
    threshold : float
        What it was compared with [rad].
    attack : numpy.record
        What was done.
    """

    ratio: float
    sensor: int
    time: float
    threshold: float
    attack: np.record


class Attacker:
    """Runs attacks on one arm and its gains; method ``exact`` only has a guaranteed bound.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.
    duration : float
        Of a run [s].
    """

    def __init__(self, arm: ArmParameters, gains: Gains, duration: float) -> None:
        self.arm, self._setup = arm, make_setup(arm, gains)
        self._work = new_record(WORK)
        self.samples = np.zeros((max(2, round(duration / arm.sample_time)), COLUMNS))

    def run(self, attack: np.record) -> Finding:
        """Simulate one attack; its signals are in ``samples``."""
        noise, work = np.random.default_rng(int(attack.seed)), self._work
        run_healthy(self._setup, attack, work, noise, self.samples)
        return Finding(
            float(work.ratio),
            int(work.sensor),
            1e-9 * float(work.stamp),
            float(work.threshold),
            attack.copy(),
        )


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
        Arm and gains.
    evaluations : int
        Runs.
    seed : int, optional
        Of the search.
    progress : callable, optional
        Called with the number of runs and the worst finding whenever there is a worse one.

    Returns
    -------
    Finding
        The worst one.
    """
    rng = np.random.default_rng(seed)
    candidates = _candidates(rng, evaluations)
    worst: Finding | None = None
    candidate = next(candidates)
    for count in range(evaluations):
        found = attacker.run(make_attack(attacker.arm, candidate, int(rng.integers(2**31))))
        if worst is None or found.ratio > worst.ratio:
            worst = found
            if progress is not None:
                progress(count + 1, worst)
        candidate = candidates.send(found.ratio)
    assert worst is not None
    return worst


def _candidates(rng: np.random.Generator, evaluations: int) -> Generator[np.ndarray, float, None]:
    """Candidates; each is answered by its ratio."""
    size = len(NUMBERS)
    best: list[tuple[float, np.ndarray]] = []
    first = structured_candidates(rng)
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
