"""Jumps of readings that may have been the ends of faults, or scale errors that began."""

from collections.abc import Iterator

import numpy as np

from lpv.core.serial_arm.chain import BoolArray, FloatArray
from lpv.core.serial_arm.diagnosis.bank import Bank, Compared
from lpv.core.serial_arm.diagnosis.end_of_fault import EndOfFault, end_of_fault
from lpv.core.serial_arm.diagnosis.estimator import HORIZON
from lpv.core.serial_arm.diagnosis.fault_filter import LARGEST_SCALE
from lpv.core.serial_arm.diagnosis.information import probability
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.scale_of_jump import ScaleOfJump


class UndecidedJumps:
    """The last jump of each reading, while it is open what it was.

    Attributes
    ----------
    ends : dict of int to EndOfFault
        By sensor: the fault that the jump may have ended.
    scaled : dict of int to ScaleOfJump
        By sensor: the scale error that may have begun with it.
    """

    def __init__(self, readings: Readings, bank: Bank) -> None:
        self._readings, self._bank = readings, bank
        self._two_intervals = 2.0 * readings.estimator.plan.interval
        self.ends: dict[int, EndOfFault] = {}
        self.scaled: dict[int, ScaleOfJump] = {}

    def __len__(self) -> int:
        """Number of hypotheses."""
        return len(self.ends) + len(self.scaled)

    def begin(self, i: int, size: float, sigma: float, again: float) -> EndOfFault:
        """Doubt a jump of sensor i at the newest sample; ``again`` is as of `end_of_fault`."""
        now, reading = self._readings.last(), self._readings.newest(i)
        if abs(size) < LARGEST_SCALE * abs(reading):  # else no scale error explains it
            ratios = size / reading, max(sigma, 1e-9) / abs(reading)
            self.scaled[i] = ScaleOfJump(i, now, reading, *ratios)
        self.ends[i] = end_of_fault(self._readings, self._bank, i, size, again)
        return self.ends[i]

    def forget(self, i: int) -> None:
        """What the last jump of sensor i was is known, or matters no more."""
        self.ends.pop(i, None)
        self.scaled.pop(i, None)

    def take_out(self, i: int, offset: float) -> None:
        """An offset is taken out of the readings of sensor i from now on [rad]."""
        if i in self.scaled:
            self.scaled[i].reading -= offset

    def settle(self) -> None:
        """Keep what the balances say, which are about to be forgotten."""
        for end in self.ends.values():
            end.settle(self._readings.estimator)
        for scaled in self.scaled.values():
            scaled.settle(self._bank)

    def scale_errors(self, now: float, sure: float) -> Iterator[tuple[ScaleOfJump, float]]:
        """Jumps that are named scale errors; they are open no more.

        With each comes the probability that it ended a fault instead.

        ``sure`` is the log Bayes factor by which a cause is named against another one.
        """
        for i, one in list(self.scaled.items()):
            one.weigh(self._readings, self._bank)
            end = self.ends.get(i)
            over = -np.inf if end is None else end.odds - np.logaddexp(0.0, one.odds)
            if one.is_named(now, sure) and over < -sure:
                self.forget(i)
                yield one, probability(float(over))
            elif now - one.time > HORIZON:
                del self.scaled[i]

    def ended_faults(self, now: float, wrong: float) -> Iterator[EndOfFault]:
        """Jumps that are named the ends of faults, wrongly with a probability; open no more."""
        for i, one in list(self.ends.items()):
            one.weigh(self._readings.estimator)
            if self.is_settled(i, now) and one.share >= 1.0 - wrong:
                self.forget(i)
                yield one
            elif now - one.time > HORIZON:
                del self.ends[i]  # the level has been estimated without what was before

    def is_settled(self, i: int, now: float) -> bool:
        """Whether all samples at hand are later than the jump of sensor i that may be an end."""
        return i not in self.ends or now - self.ends[i].time > self._two_intervals

    def errors(self, least: float) -> FloatArray:
        """Largest error of each reading by what is open beyond a probability, shape (n,) [rad]."""
        error = np.zeros(self._readings.estimator.joints)
        for i, end in self.ends.items():
            if end.share > least:
                error[i] = abs(end.jump)
        for i, scaled in self.scaled.items():
            if scaled.share > least:
                error[i] = max(error[i], abs(scaled.error(self._readings.newest(i))))
        return error

    def explain(self, found: Compared, wrong: float) -> BoolArray:
        """Which causes a jump of their reading explains, which is weighed on its own, shape (N,).

        A fault may have ended with it.  Nor is a rate to blame for a reading that has rested since
        its jump: that it froze, the rival, is compared as late.  Nor for one that may have a scale
        error since, which parts it from its rate as well.
        """
        explained, is_rate = np.zeros(found.rows.shape, bool), found.of_kind('rate_bias')
        for i, scaled in self.scaled.items():
            if scaled.share > wrong:
                explained |= is_rate & (found.rows['joint'] == i)
        for i, end in self.ends.items():
            rests = self._readings.rests_since(i) <= end.time
            early = (found.rows['joint'] == i) & (
                found.rows['begin'] < end.time + self._two_intervals
            )
            explained |= early & (found.is_encoder | (is_rate & rests))
        return explained
