"""Jumps of scale errors, the rival of offsets that begin with a jump.

A reading that jumps by J where it reads y0 has from then on the offset J, the null hypothesis, or
the scale error s = J / y0, and is off by s / (1 + s) (y - y0) once the jump has been taken out.
All balances since the jump tell the two apart, as does the kinematic row where a rate has a sensor
of its own.  Both are as likely before the data; what neither explains, as brakes, tells nothing.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import OFFSET, SCALE
from lpv.core.serial_arm.diagnosis.bank import Bank
from lpv.core.serial_arm.diagnosis.estimator import set_residuals
from lpv.core.serial_arm.diagnosis.fault_filter import FaultFilter
from lpv.core.serial_arm.diagnosis.information import ROBUST, probability, recent
from lpv.core.serial_arm.diagnosis.onset import weigh_errors
from lpv.core.serial_arm.diagnosis.readings import Readings

KIND_ODDS = 2.0
"""A hypothesis is the likelier one when it is so many times as likely.  Which sensor is to blame is
known; until the kind is sure, bounds hold both."""


@dataclass
class ScaleOfJump:
    """The hypothesis that a jump of one reading was a scale error's; the jump was taken out."""

    joint: int
    time: float  # of the jump [s]
    reading: float  # y0, as corrected [rad]
    size: float  # s [-]
    sigma: float  # its standard deviation
    odds: float = 0.0  # logarithm of its odds against an offset
    before: float = 0.0  # the part of it by balances that are forgotten
    by_rate: float = 0.0  # the part of it by the kinematic rows
    likely_since: float = np.inf  # since when it is the likelier one by `KIND_ODDS` [s]

    @property
    def _of_way(self) -> float:
        """Of the way since the jump, as read, that is the fault's: s / (1 + s)."""
        return self.size / (1.0 + self.size)

    @property
    def share(self) -> float:
        """Probability of the hypothesis, against an offset."""
        return probability(self.odds)

    def weigh(self, readings: Readings, bank: Bank) -> None:
        """Compare the hypothesis with an offset on all balances since the jump."""
        self._ask_rate(readings, bank)
        self.odds = self.before + self.by_rate + self._gain(bank)
        likely = self.odds > np.log(KIND_ODDS)
        self.likely_since = min(self.likely_since, readings.last()) if likely else np.inf

    def settle(self, bank: Bank) -> None:
        """Keep what the balances say, which are about to be forgotten."""
        self.before += self._gain(bank)

    def is_named(self, now: float, sure: float) -> bool:
        """Whether it is the likelier one by odds that are sure, or for as long as a pose lasts.

        What the model misses in a pose makes the wrong one likely for as long.
        """
        return self.odds > sure or now - self.likely_since >= priors.POSE_TIME

    def error(self, reading: float) -> float:
        """What a reading, as corrected by the jump, is off by if the hypothesis is true [rad]."""
        return self._of_way * (reading - self.reading)

    def filter(self, now: float, spread: float) -> FaultFilter:
        """Filter of the scale error, at the end of the newest balance.

        The fault was J at y0; how it grows with the way is known as far as an offset is excluded.
        While the jump may have ended a fault, ``spread`` is the share of the error that is one
        standard deviation, so that bounds hold none.
        """
        way = np.array([1.0, -self.reading, 0.0])
        one = FaultFilter(self.joint, 'scale', self.time, updated=now)
        one.mean = self.size * way
        variance = self.sigma**2 + (1.0 - self.share) * self.size**2
        one.covariance = variance * np.outer(way, way)
        one.covariance[1, 1] += (self.sigma * self.reading) ** 2
        # A reading is off by its share s / (1 + s).
        one.covariance[0, 0] += (spread * self.size * (1.0 + self.size)) ** 2
        return one

    def _gain(self, bank: Bank) -> float:
        """Logarithm of the Bayes factor; the size is known as well as the jump."""
        estimator = bank.estimator
        window, null, n = estimator.window, estimator.posterior, estimator.joints
        # What holds the jump itself was made of readings before and after it.
        whole = self.time + 2.0 * estimator.plan.interval
        last = int((estimator.times(len(estimator)) > whole).sum())
        if last == 0:
            return 0.0
        at = recent(window, last)
        column = window.rows[at, :, 1 + SCALE * n + self.joint]
        # Columns are those of readings from the point of linearisation on.
        began = self.reading - estimator.balance.reference[self.joint]
        column = column - began * window.rows[at, :, 1 + OFFSET * n + self.joint]
        size, known = self._of_way, (1.0 + self.size) ** 4 / self.sigma**2
        estimator.call(set_residuals, window, null, last)
        apart, left = size * column, null.residual[:last]
        # What the better one leaves is more than both differ by, and than noise is.
        least = np.minimum(np.abs(left), np.abs(left + apart))
        noise = ROBUST / np.sqrt(null.weights[at])
        counts = (least <= np.maximum(np.abs(apart), noise)).all(axis=1)[:, None]
        score, square = weigh_errors(estimator, null, column * counts)
        # Noise of a rate is in the column and in what is left, as if the reading were too large.
        mass = counts * window.momenta[at, :, self.joint]
        common = bank.parts.evidence.noise[self.joint] * (null.weights[at] * mass**2).sum()
        score -= np.clip(score, 0.0, common)
        power, pull = known + float(square), size * known + float(score)
        return 0.5 * (pull**2 / power - size**2 * known - float(np.log(power / known)))

    def _ask_rate(self, readings: Readings, bank: Bank) -> None:
        """What the rate says of the way since the jump, while all of its rows are at hand."""
        plan, since = readings.estimator.plan, readings.last() - self.time
        count = int(since / plan.interval) - 1
        way = bank.kinematics.way(self.joint, count) if 0 < count <= bank.kinematics.held else None
        if way is not None:
            blocks = readings.blocks(count + 1)
            began = blocks[-1 - count * plan.blocks, self.joint]
            more = self._of_way * float(blocks[-1, self.joint] - began)
            self.by_rate = (-way[0] * more - 0.5 * more**2) / way[1] ** 2
