"""Faults that are known, and what they take out of the readings."""

import math
from collections.abc import Sequence

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.bank import Bank
from lpv.core.serial_arm.diagnosis.fault_filter import (
    FaultFilter,
    begin_frozen,
    correct_rates_since,
    correct_since,
    doubt_ended,
    follow_all,
)
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.sampler import put_back
from lpv.core.serial_arm.diagnosis.sensor_state import SensorRecord
from lpv.core.serial_arm.diagnosis.stuck import Course


class FollowedFaults:
    """Faults of the n sensors that are taken out of the readings, and followed while they change.

    Attributes
    ----------
    filters : dict of int to FaultFilter
        By sensor.
    held_rates : dict of int to tuple of float
        Rates that froze with their readings, by sensor: what they read, and how much of it was
        their known error before [rad/s].
    """

    def __init__(
        self,
        readings: Readings,
        bank: Bank,
        sensors: Sequence[SensorRecord],
        rates: Sequence[SensorRecord],
    ) -> None:
        self._readings, self._bank = readings, bank
        self._sensors, self._rates = sensors, rates
        n = len(sensors)
        self.filters: dict[int, FaultFilter] = {}
        self._ended: list[FaultFilter] = []  # of readings that balances still hold
        self.held_rates: dict[int, tuple[float, float]] = {}
        self._jumped = np.zeros((2, n))  # sum of jumps that nobody has taken, their variance
        self._noted = np.zeros(n)  # correction of which the caller knows [rad]

    @property
    def known(self) -> set[int]:
        """Sensors of which a fault is followed, or whose readings are noisy."""
        return {*self.filters, *self._noisy()}

    def _noisy(self) -> list[int]:
        """Sensors whose readings are noisy."""
        return [i for i, one in enumerate(self._readings.sampler.noisy.tolist()) if one]

    def __len__(self) -> int:
        """Number of faults that balances hold."""
        return len(self.filters) + len(self._ended)

    def taken_out(self) -> FloatArray:
        """What is taken out of the readings now, shape (n,) [rad]."""
        sampler = self._readings.sampler
        return sampler.correction + sampler.followed + sampler.share * sampler.raw

    def certain(self, sigmas: float) -> tuple[FloatArray, FloatArray]:
        """What of `taken_out` is beyond doubt, and its share of faults that are followed."""
        removed, share = self.taken_out(), np.ones(len(self._sensors))
        now = self._readings.last()
        for i, one in self.filters.items():
            reading = float(self._readings.sampler.raw[i])
            share[i] = one.share(reading, now, sigmas)
            removed[i] -= (1.0 - share[i]) * one.fault(reading, now)[0]
        return removed, share

    def sigma(self) -> FloatArray:
        """Standard deviations of faults that change, and of noise, shape (n,) [rad]."""
        sigma, readings = np.zeros(len(self._sensors)), self._readings
        now = readings.last()
        for i, one in self.filters.items():
            sigma[i] = one.fault(float(readings.sampler.raw[i]), now)[1]
        for noisy in self._noisy():
            sigma[noisy] = math.hypot(sigma[noisy], readings.noise(noisy))
        return sigma

    def largest(self, i: int) -> float:
        """What is taken out of a reading; of a scale error, where that was farthest from zero."""
        one = self.filters.get(i)
        if one is None or not one.is_scale:
            return float(self.taken_out()[i])
        fault = one.mean[0] * self._readings.all_blocks()[:, i] + one.mean[1]
        return float(fault[np.abs(fault).argmax()])

    def note_jumps(self) -> None:
        """Jumps were found at the last sample."""
        sampler = self._readings.sampler
        change = sampler.correction - self._noted
        self._jumped[0] += change
        self._jumped[1] += np.where(change != 0.0, sampler.usual**2, 0.0)

    def take_jump(self, i: int, size: float, sigma: float) -> None:
        """The reading of sensor i jumped in a gap [rad], of a size that is that uncertain."""
        self._readings.sampler.correction[i] += size
        self._noted[i] += size
        self._jumped[:, i] += size, sigma**2

    def take_jumps(self) -> tuple[FloatArray, FloatArray]:
        """Jumps of readings since the last call, and their variance, shape (n,) [rad], [rad2]."""
        (jump, variance), self._jumped = self._jumped, np.zeros(self._jumped.shape)
        return jump, variance

    def note_correction(self) -> None:
        """What the correction is now is no jump of the readings."""
        self._noted = self._readings.sampler.correction.copy()

    def take_out_level(self, i: int) -> float:
        """Take the estimated offset of sensor i [rad] out of the readings from now on."""
        level, sampler = self._readings.estimator.level, self._readings.sampler
        offset = float(level.mean[i])
        self._jumped[1, i] += level.sigma[i] ** 2
        sampler.correction[i] += offset
        self._noted[i] += offset
        self._readings.estimator.move_reference(i, -offset)
        return offset

    def begin(self, one: FaultFilter) -> None:
        """Follow a fault, and take it out of the readings since it began."""
        self.filters[one.joint] = one
        self.trust_rate(one.joint)
        correct_since(one, self._readings)
        self._noted[one.joint] = self._readings.sampler.correction[one.joint]

    def update(self) -> None:
        """Let the newest balance measure the faults."""
        readings, bank = self._readings, self._bank
        end, span = readings.ended(), 2.0 * readings.estimator.plan.interval
        self._ended = [one for one in self._ended if end - one.updated < span]
        for one in self._ended:
            doubt_ended(one, readings.estimator)
        for i in [*self.held_rates]:
            if readings.sampler.published[0, i] != self.held_rates[i][0]:
                self._use_rate(i)
        kinematic = [
            None if i in self.held_rates else bank.kinematics.last(i) for i in self.filters
        ]
        if self.filters:
            known = self.known
            others = [i for i in range(len(self._sensors)) if i not in known]
            rests = readings.rest(others)
            for (i, one), way in zip(self.filters.items(), kinematic):
                one.watch_rest(rests and way is None)  # a rate of its own tells
                if one.stopped is not None and not rests:
                    one.go_on(readings.acceleration(i))
            faults = zip(self.filters.values(), kinematic)
            may_stop = any(one.may_stop and way is None for one, way in faults)
            stopped = readings.stopped(others) if may_stop else None
            follow_all([*self.filters.values()], readings, kinematic, stopped)
        for i, one in self.filters.items():
            rates = bank.kinematics.parts.edges[-1]
            sure = not (self._rates[i].active or readings.sampler.noisy[i])
            bank.kinematics.follow(i, one.rate_sigma(float(rates[i])) if sure else math.inf)

    def trust_rate(self, i: int) -> None:
        """Use the kinematic rows of a joint while no fault of its sensors is known."""
        noisy = bool(self._readings.sampler.noisy[i])
        self._bank.kinematics.leave_out(i, self._rates[i].active or i in self.filters or noisy)

    def frozen(self, i: int, begin: float, course: Course | None) -> FaultFilter:
        """Filter of a reading that froze [s].

        How its joint goes on is told by the rate that it has; else by the ``course`` that balances
        tell, unless these were made with a rate that froze, too; else by the rate that it had.
        """
        readings = self._readings
        acceleration = readings.acceleration(i)
        scale = float(readings.estimator.balance.scale[i])
        if readings.rate_is_held(i):
            self._do_without_rate(i, begin)
            course = None
        course = self._course_by_rate(i, begin) or course
        if course is None:
            time, sigma = readings.rests_since(i), readings.stop_sigma(i, acceleration)
            mean = np.array([0.0, float(readings.sampler.stop[i]), 0.0])
            covariance = np.diag([0.0, sigma, acceleration]) ** 2
            course = Course(0.0, time, time, mean, covariance)
        fault = begin_frozen(i, course, acceleration, scale)
        fault.predict(readings.ended())
        return fault

    def _course_by_rate(self, i: int, begin: float) -> Course | None:
        """How a joint went on while its reading rested, by a rate of its own; None without one."""
        # Rows go from the middle of a block to that of another one.
        readings = self._readings
        interval = readings.estimator.plan.interval
        end = float(readings.blocks(1)[-1, 3 * len(self._sensors)])
        way = self._bank.kinematics.way(i, math.ceil((end - begin) / interval))
        newest = self._bank.kinematics.last(i)
        if way is None or newest is None or i in self.held_rates:
            return None
        # The newest row has the mean rate of its interval.
        acceleration = readings.acceleration(i)
        sigma = math.hypot(newest[1] ** 0.5 / interval, 0.5 * interval * acceleration)
        mean = np.array([way[0], -newest[0] / interval, 0.0])
        return Course(0.0, begin, end, mean, np.diag([way[1], sigma, acceleration]) ** 2)

    def _do_without_rate(self, i: int, begin: float) -> None:
        """A rate froze with its reading [s]: it is that of the reading, 0, until it changes."""
        estimator, sampler = self._readings.estimator, self._readings.sampler
        held, error = float(sampler.published[0, i]), float(sampler.rate_error[i])
        self.held_rates[i] = held, error
        correct_rates_since(i, begin, held - error, self._readings)
        sampler.rate_error[i] = held
        sampler.derived[i] = estimator.balance.derived[i] = 1.0
        self._bank.kinematics.forget(i)

    def _use_rate(self, i: int) -> None:
        """A rate that had frozen with its reading changes, and is that of a sensor again."""
        estimator, sampler = self._readings.estimator, self._readings.sampler
        _, sampler.rate_error[i] = self.held_rates.pop(i)
        sampler.samples[-1, 1, i] = sampler.published[0, i] - sampler.rate_error[i]
        sampler.derived[i] = estimator.balance.derived[i] = 0.0
        self._bank.kinematics.forget(i)

    def release(self, i: int, since: int, sigma: float, kept: float = 0.0) -> None:
        """The readings of sensor i are right again, for so many samples, but for an offset.

        Those before it were wrong by ``sigma`` [rad].
        """
        sampler = self._readings.sampler
        put_back(sampler, i, since)
        sampler.samples[-since:, 0, i] -= kept
        if sampler.derived[i] == 1.0 and since > 1:  # the first difference holds the jump
            sampler.samples[-since, 1, i] = sampler.samples[1 - since, 1, i]
        one = self.filters.get(i)
        if one is not None and not one.is_scale:
            one.predict(self._readings.last() - since * self._readings.sample_time)
            self._ended.append(one)
        self.end(i)
        self._bank.kinematics.note_jump(i, sigma**2)
        sampler.correction[i] = self._noted[i] = kept

    def forget(self, i: int) -> None:
        """Take nothing out of the readings of sensor i any more; what is estimated stays true."""
        sampler = self._readings.sampler
        out = float(self.taken_out()[i])
        self.end(i)
        if out == 0.0:
            return
        sampler.samples[:, 0, i] += out
        sampler.blocks[:, i] += out
        sampler.sums[0, i] += out * sampler.state['block_length'][0]
        self._readings.estimator.move_reference(i, out)

    def end(self, i: int) -> None:
        """Samples to come of sensor i are taken as they are."""
        sampler = self._readings.sampler
        if i in self.held_rates:
            self._use_rate(i)
        if self.filters.pop(i, None) is not None or self._sensors[i].kind == 'noise':
            self.trust_rate(i)
        sampler.correction[i] = sampler.followed[i] = sampler.drift[i] = sampler.share[i] = 0.0
        sampler.curve[i] = 0.0
        self._noted[i] = 0.0
