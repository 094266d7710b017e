"""How messages get from node to node in a simulated run: late, or not at all."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpv.core.support.limits import MAX_DELAY

PARTS = ('observer', 'tracker', 'commands')
"""What can stall: the way of measurements to the observer (or the process that publishes them, or
the observer), the tracker, and the way of its commands to the drives."""
NO_MEASUREMENT, NO_ESTIMATE, NO_COMMAND = 1, 2, 4
"""Flags of what is blocked, in the order of `PARTS`."""


class Stall(NamedTuple):
    """A part of the graph that is held up; what it would have passed on is lost."""

    part: str  # one of PARTS
    begin: float  # [s]
    duration: float  # [s]


@dataclass(frozen=True)
class Transport:
    """How messages get from node to node in a simulated run."""

    delay: int = 0  # samples from a measurement to the effect of its command, at most 63
    loss: float = 0.0  # probability that a measurement is lost; the last command then goes on
    stalls: tuple[Stall, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.delay < MAX_DELAY:
            raise ValueError(f'delay must be 0 to {MAX_DELAY - 1} samples, got {self.delay}')

    def blocked(self, count: int, period: float) -> np.ndarray:
        """What is blocked at each sample, as a sum of flags."""
        flags = np.zeros(count, np.uint8)
        for stall in self.stalls:
            first = round(stall.begin / period)
            last = round((stall.begin + stall.duration) / period)
            flags[first:last] |= 1 << PARTS.index(stall.part)
        return flags


DIRECT = Transport()
"""Every message arrives at once."""
