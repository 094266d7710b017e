"""What the last readings of an arm say, and the blocks of them that balances are made of."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.decision import reading_noise
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator
from lpv.core.serial_arm.diagnosis.sampler import BEFORE_STOP, ROUNDING, Sampler, block_end
from lpv.core.serial_arm.diagnosis.stuck import at_rest, usual_acceleration


class Readings(NamedTuple):
    """The last samples, as corrected so far, and the horizon of balances."""

    sampler: Sampler
    estimator: OffsetEstimator
    sample_time: float  # [s]

    def last(self) -> float:
        """When the newest sample was taken [s]."""
        return float(self.sampler.time[-1])

    def newest(self, i: int) -> float:
        """The newest reading of sensor i, as corrected [rad]."""
        return float(self.sampler.samples[-1, 0, i])

    def places(self, intervals: int) -> IntArray:
        """Places of the last blocks in the ring, oldest first."""
        capacity, written = len(self.sampler.blocks), int(self.sampler.state['blocks'][0])
        count = min(intervals * self.estimator.plan.blocks, written, capacity)
        return np.arange(written - count, written) % capacity

    def blocks(self, intervals: int) -> FloatArray:
        """The last blocks, oldest first; not to be changed."""
        places = self.places(intervals)
        if len(places) and places[0] <= places[-1]:
            return self.sampler.blocks[places[0] : places[-1] + 1]
        return self.sampler.blocks[places]

    def all_blocks(self) -> FloatArray:
        """Those of the horizon, and of the interval before it."""
        return self.blocks(len(self.estimator) + 1)

    def balanced(self) -> FloatArray:
        """Those of the horizon in whole intervals, without the one that is not complete yet."""
        blocks, per_interval = self.blocks(len(self.estimator) + 2), self.estimator.plan.blocks
        whole = blocks[: len(blocks) - int(self.sampler.state['in_interval'][0])]
        return whole[len(whole) % per_interval :]

    def ended(self) -> float:
        """When the newest balance ended: younger samples wait to enter one [s]."""
        return block_end(self.blocks(1)[-1])

    def noise(self, i: int) -> float:
        """Standard deviation of a noisy reading [rad]."""
        return math.sqrt(reading_noise(self.sampler, i))

    def farthest(self, i: int) -> float:
        """Largest distance of a reading from zero over the horizon [rad]."""
        return float(np.abs(self.all_blocks()[:, i]).max())

    def rested(self, i: int) -> float:
        """For how long a reading has not changed [s]."""
        return float(self.sampler.still[i]) * self.sample_time

    def rests_since(self, i: int) -> float:
        """When a reading changed last [s]."""
        return self.last() - self.rested(i)

    def acceleration(self, i: int) -> float:
        """Usual acceleration of a joint [rad/s2]."""
        return usual_acceleration(self.estimator, self.all_blocks(), i)

    def stopped(self, sensors: Sequence[int]) -> float | None:
        """When the joints of some sensors were stopped dead, as brakes do, and rest since then [s].

        None if they move, came to rest as they usually do, or did so before the newest balance.
        """
        n, count, held = self.estimator.joints, self.estimator.plan.blocks, self.blocks(3)
        speeds, length = np.abs(held[:, n : 2 * n][:, sensors]), float(held[-1, 3 * n + 1])
        blocks = range(max(1, len(held) - 2 * count), len(held) - 2)  # which it may have been
        if not (sensors and blocks):
            return None
        # Seldom does a joint lose so much of its rate in two blocks, or seem to by noise.
        usual = 2.0 * length * np.array([self.acceleration(i) for i in sensors])
        most = priors.ACCELERATIONS[1] * np.maximum(usual, self.sampler.usual[sensors] / length)
        for k in blocks:
            before, after = speeds[k - 1], speeds[k + 1 :].max(0)
            fast = before > most
            if fast.any() and (after < 0.5 * most)[fast].all():
                fastest = int((before / most).argmax())
                moved = min(float(speeds[k, fastest] / before[fastest]), 1.0)
                return float(held[k, 3 * n]) + (moved - 0.5) * length
        return None

    def rest(self, sensors: Sequence[int]) -> bool:
        """Whether there are sensors whose joints all rest in the newest interval."""
        n = self.estimator.joints
        rates = self.blocks(1)[:, n : 2 * n].mean(0)
        return len(sensors) > 0 and bool(at_rest(rates, self.estimator.balance.scale, sensors))

    def stop_sigma(self, i: int, acceleration: float) -> float:
        """Standard deviation of the rate that a reading had before it came to rest [rad/s]."""
        measured, grain = BEFORE_STOP * self.sample_time, float(self.sampler.grain[i])
        rounding = grain / measured if math.isfinite(grain) else 0.0
        slow = priors.SLOW_RATE * float(self.estimator.balance.scale[i])
        return math.hypot(rounding, 0.5 * measured * acceleration, slow)

    def rate_is_held(self, i: int) -> bool:
        """Whether a rate with a sensor of its own has not changed since its reading froze."""
        sampler, n = self.sampler, self.estimator.joints
        if sampler.derived[i] == 1.0:
            return False
        blocks, still = self.all_blocks(), int(sampler.still[i])
        rested = blocks[:, 3 * n] - 0.5 * blocks[:, 3 * n + 1] > self.rests_since(i)
        rates = np.concatenate([blocks[rested, n + i], sampler.samples[-still:, 1, i]])
        return bool(np.ptp(rates) <= ROUNDING)
