"""Jumps that end a fault which nobody had noticed, the rival of faults that begin with a jump.

A reading that drifts from s on and jumps back by J at b is right afterwards.  If the jump is taken
for a fault and taken out, what remains is the error

    f(t) = -J (t - s) / (b - s) for s < t < b,    f(t) = -J for t > b,

which the balances of the horizon contradict or support, as does the kinematic row before b where a
rate has a sensor of its own.  A reading that did not change at all before it jumped may have been
frozen, with its joint anywhere.  As many faults end as begin: both are as likely before the data.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import DRIFT, OFFSET
from lpv.core.serial_arm.diagnosis.bank import Bank
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator
from lpv.core.serial_arm.diagnosis.fault_filter import begin_frozen
from lpv.core.serial_arm.diagnosis.information import probability, recent
from lpv.core.serial_arm.diagnosis.linear_bank import STARTS
from lpv.core.serial_arm.diagnosis.onset import weigh_errors
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.sampler import ROUNDING, block_end
from lpv.core.serial_arm.diagnosis.stuck import LINEAR, Frozen, course_of_frozen

ONSETS = len(STARTS)
"""Onsets that are compared, spaced evenly in the logarithm of their age: as many as of others."""


@dataclass
class EndOfFault:
    """The hypothesis that a jump of one reading was the end of a fault.

    The jump [rad] has been taken out of the reading.  Each of S onsets has an entry in ``prior``,
    ``ages`` and ``ramps``: the logarithm of its odds against a fault that began with the jump,
    before the balances; its age at the jump [s]; 1 where the reading drifted, 0 where it was
    frozen.  ``odds`` is the logarithm of the odds of the hypothesis against a fault that began.
    """

    joint: int
    jump: float
    time: float
    prior: FloatArray
    ages: FloatArray
    ramps: FloatArray
    odds: float = 0.0

    @property
    def share(self) -> float:
        """Probability of the hypothesis, against a fault that began."""
        return probability(self.odds)

    def weigh(self, estimator: OffsetEstimator) -> None:
        """Compare the hypothesis with the null hypothesis on all balances at hand."""
        self.odds = float(np.logaddexp.reduce(self.prior + self._gains(estimator)))

    def settle(self, estimator: OffsetEstimator) -> None:
        """Keep what the balances say, which are about to be forgotten."""
        self.prior = self.prior + self._gains(estimator)

    def take_back(self, readings: Readings) -> None:
        """Put the jump back into the readings, and take what was wrong before it out of them.

        The sampler must hold no sample from before the jump.
        """
        sampler, estimator, _ = readings
        n, i, places = estimator.joints, self.joint, readings.places(len(estimator) + 1)
        blocks = sampler.blocks[places]
        time = blocks[:, 3 * n]
        mean, rate, sigma = self._error(estimator, time)
        after = time > self.time
        blocks[:, i] += np.where(after, self.jump, -mean)
        blocks[:, n + i] -= sampler.derived[i] * rate
        sampler.blocks[places] = blocks
        sampler.correction[i] -= self.jump
        sampler.samples[:, 0, i] += self.jump
        sampler.sums[0, i] += self.jump * sampler.state['block_length'][0]
        estimator.replace_last(blocks)
        ends = estimator.times(len(estimator))[::-1]
        wrong = np.interp(ends, time, sigma)
        # The balances that hold the jump were made of readings before and after it.
        wrong[np.abs(ends - self.time) < 2.0 * estimator.plan.interval] = abs(self.jump)
        estimator.doubt_readings(i, wrong)

    def _error(
        self, estimator: OffsetEstimator, time: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Error of the readings before the jump, its rate and its standard deviation."""
        odds = self.prior + self._gains(estimator)
        share = np.exp(odds - np.logaddexp.reduce(odds))
        age = self.ages[:, None]
        since = (time - self.time + age) * (time <= self.time)
        errors = -self.jump / age * np.maximum(since, 0.0)
        mean, rate = share @ errors, share @ (-self.jump / age * (since > 0.0))
        return mean, rate, np.sqrt(share @ (errors - mean) ** 2)

    def _gains(self, estimator: OffsetEstimator) -> FloatArray:
        """Logarithm of the Bayes factor of each onset; the size is known."""
        last, n, window = len(estimator), estimator.joints, estimator.window
        if last == 0 or abs(self.jump) > LINEAR * estimator.balance.scale[self.joint]:
            return np.zeros(len(self.ages))
        at = recent(window, last)
        offset = window.rows[at, :, 1 + OFFSET * n + self.joint]
        drift = window.rows[at, :, 1 + DRIFT * n + self.joint]
        end, span = window.times[at], 2.0 * estimator.plan.interval
        begin = (self.time - self.ages)[:, None]
        rate = (-self.jump * self.ramps / self.ages)[:, None]
        ramps = (end > begin + 0.5 * span) & (end <= self.time)
        shift = begin - estimator.balance.epoch[0]
        columns = (rate * ramps)[:, :, None] * (drift - shift[:, :, None] * offset)
        columns -= np.where(end > self.time, self.jump, 0.0)[None, :, None] * offset
        # What holds the jump itself was made of readings before and after it.
        known = np.where((end > self.time) & (end < self.time + 2.0 * span), 0.0, 1.0)
        # As they are weighed for levels.
        score, square = weigh_errors(estimator, estimator.level, known[:, None] * columns)
        return score - 0.5 * square


def end_of_fault(
    readings: Readings, bank: Bank, joint: int, jump: float, again: float
) -> EndOfFault:
    """The hypothesis at the moment of a jump [rad].

    The estimator's horizon bounds how long the fault may have lasted, the sampler's last blocks
    tell whether the reading was frozen, and the bank's kinematic rows how far the joint went
    before.  ``again`` is the logarithm of the odds that it froze, before the data; 0 where it was
    healthy.
    """
    sampler, estimator, _ = readings
    interval, scale = estimator.plan.interval, float(estimator.balance.scale[joint])
    longest = max(len(estimator), 2) * interval
    ages = np.geomspace(interval, longest, ONSETS)
    # Uniform over the horizon, and as the sizes of drifts are: their rates grow with the jump.
    edges = np.sqrt(ages[1:] * ages[:-1])
    prior = np.log(np.diff(np.concatenate([[0.0], edges, [longest]])) / longest)
    prior += _normal(jump / scale / ages, priors.SIZE['drift']) - np.log(ages) - _slip(jump / scale)
    for k, age in enumerate(ages):
        way = bank.kinematics.way(joint, round(age / interval))
        if way is not None:
            held = min(round(age / interval), bank.kinematics.held) * interval
            # The reading went as far as it jumped back, and its rate knew nothing of it.
            expected = jump * min(held / age, 1.0)
            prior[k] += (way[0] * expected - 0.5 * expected**2) / way[1] ** 2
    ramps = np.ones(len(ages))
    blocks = readings.all_blocks()
    frozen = _frozen(estimator, blocks, joint)
    if frozen is not None:
        # Where it was frozen before, balances begin with a rate that was not measured.
        says = abs(jump) < LINEAR * scale and again == 0.0
        held = readings.balanced()  # balances are of whole intervals; a jump comes in between
        course = course_of_frozen(estimator, joint, frozen, 0, held) if says else None
        gain, went, sigma = 0.0, 0.0, LINEAR * scale
        if course is not None:
            one = begin_frozen(joint, course, readings.acceleration(joint), scale)
            fault, sigma = one.fault(0.0, readings.last())
            gain, went, sigma = course.gain, -fault, max(sigma, float(sampler.usual[joint]))
        gain += float(_normal((jump - went) / scale, sigma / scale) - _slip(jump / scale)) + again
        age = blocks[-1, 3 * estimator.joints] - frozen.time
        prior, ages, ramps = np.append(prior, gain), np.append(ages, age), np.append(ramps, 0.0)
    end = EndOfFault(joint, jump, readings.last(), prior, ages, ramps)
    end.weigh(estimator)
    return end


def _frozen(estimator: OffsetEstimator, blocks: FloatArray, joint: int) -> Frozen | None:
    """A reading that had not changed at all for an interval before the samples at hand."""
    moved = np.abs(blocks[:, joint] - blocks[-1:, joint]) > ROUNDING
    n, changes = estimator.joints, np.flatnonzero(moved)
    if len(changes) == 0 or len(blocks) - 1 - changes[-1] < estimator.plan.blocks:
        return None
    last = max(int(changes[-1]), 1)
    sigma = priors.SIZE['drift'] * float(estimator.balance.scale[joint])
    return Frozen(block_end(blocks[last]), float(blocks[last - 1, n + joint]), sigma, False)


def _slip(jump: float) -> float:
    """Logarithm of the density of jumps that begin a fault: usual ones, or anywhere in a turn."""
    return float(np.logaddexp(_normal(jump, priors.SIZE['slip']), -0.5 * np.log(2.0 * np.pi)))


def _normal(value: float | FloatArray, sigma: float) -> FloatArray:
    """Logarithm of a normal density, times the root of 2 pi."""
    return np.asarray(-0.5 * (np.asarray(value) / sigma) ** 2 - np.log(sigma))
