"""Attacks on the certified observer of a two-link arm."""

from typing import Any

import numpy as np

from lpv_campaign.falsify.attack import (
    NUMBERS,
    attack_as_dict,
    attack_from_dict,
    make_attack,
    make_setup,
    structured_candidates,
)
from lpv_campaign.falsify.healthy_run import WORK, run_healthy
from lpv_campaign.falsify.search import Finding, FloatArray
from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.support.records import new_record

COLUMNS = 12
"""Signals of a run: see `run_healthy`."""


class TwoLinkAttacker:
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

    numbers = len(NUMBERS)

    def __init__(self, arm: ArmParameters, gains: Gains, duration: float) -> None:
        self.arm, self._setup = arm, make_setup(arm, gains)
        self._work = new_record(WORK)
        self.samples = np.zeros((max(2, round(duration / arm.sample_time)), COLUMNS))

    def structured(self, rng: np.random.Generator) -> list[FloatArray]:
        """Candidates that an engineer would try."""
        return structured_candidates(rng)

    def attack(self, candidate: FloatArray, seed: int) -> np.record:
        """Attack of a candidate."""
        return make_attack(self.arm, candidate, seed)

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

    def readings(self) -> FloatArray:
        """Readings, rates and efforts of the last run, shape (N, 3, 2)."""
        return self.samples[:, :6].reshape(-1, 3, 2)

    def as_dict(self, attack: np.record) -> dict[str, Any]:
        """Plain numbers of an attack, for a file."""
        return attack_as_dict(attack)

    def from_dict(self, data: dict[str, Any]) -> np.record:
        """Attack from `as_dict`."""
        return attack_from_dict(data)
