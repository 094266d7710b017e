"""The monitor of an arm for samples by the thousand, each of which is answered."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from lpv.core.monitoring.compensation import FLAGS, AnswerRows, new_compensation, new_known
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.sample_loop import (
    DECIDE,
    JUMP,
    KNOW,
    PROGRESS,
    REPORT,
    SAMPLE,
    UNWATCHED,
    Answering,
    advance,
)
from lpv.core.serial_arm.chain import BoolArray, FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.alarms import Mode, SensorState
from lpv.core.serial_arm.diagnosis.decision import reading_noise
from lpv.core.serial_arm.diagnosis.information import slot
from lpv.core.serial_arm.diagnosis.monitor import LONGEST_STEP, SerialMonitor
from lpv.core.serial_arm.diagnosis.row_noise import UNMEASURED
from lpv.core.serial_arm.diagnosis.sampler import smallest_jump
from lpv.core.support.jit import Entries
from lpv.core.support.records import memory, new_record, plain
from lpv.core.support.timestamps import NANOSECONDS, NEVER
from lpv.core.uio.unknown_input_observer import UnknownInputObserver, no_observer

_OK, _ERROR = int(SensorState.OK), int(SensorState.ERROR)
_NOT_DIAGNOSABLE = int(SensorState.NOT_DIAGNOSABLE)
"""NumPy takes members of an enumeration for objects, in ten times as long."""


class SteppedMonitor(SerialMonitor):
    """`SerialMonitor` with its samples and their answers.

    Parameters
    ----------
    arm : SerialArm
        Arm and sensors.
    parameters : DiagnosisParameters, optional
        Tuning.
    uio : UnknownInputObserver, optional
        The designed observer that runs beside it.

    Attributes
    ----------
    answering : Answering
        What samples are answered with, until the next decision.
    """

    def __init__(
        self,
        arm: SerialArm,
        parameters: DiagnosisParameters | None = None,
        uio: UnknownInputObserver | None = None,
    ) -> None:
        self._uio = uio
        self._call = Entries()
        # Efforts that leave out the weight are none: dynamics without it are not those of an arm.
        known = 1.0 if arm.effort_includes_gravity else np.nan
        self._efforts = known * np.array(arm.torque_gain)
        super().__init__(arm, parameters)
        if uio is not None:
            uio.retune(self.settings.sigmas)
            if uio.certifies:
                self.certify(uio.level)

    def reset(self) -> None:
        """Forget samples, estimates, faults and the time of the first sample."""
        super().reset()
        self._first = None
        self._last_time = -np.inf
        self.alarms = []
        self._removed_variance = np.zeros(self.joints)
        flags = new_record(FLAGS, sample_time=self.arm.sample_time)
        progress = new_record(PROGRESS, next_report=NEVER)
        if self._uio is not None:
            self._uio.reset()
        uio = no_observer() if self._uio is None else self._uio.parts
        self.answering = Answering(
            new_compensation(self.arm), new_known(self.joints), memory(flags), memory(progress), uio
        )
        self.flags, self.progress = plain(flags), plain(progress)
        self._balances = self._balanced = 0  # balances at hand, stamp of the last one [ns]
        self.know(0)

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning; alarms stay as they are."""
        self.settings = parameters
        self.apply_settings()
        if self._uio is not None:
            self._uio.retune(parameters.sigmas)
        self.know(int(self.flags['stamp']))

    @property
    def balances(self) -> int:
        """Balances that were used so far."""
        return int(self._state['balances'])

    @property
    def rates_are_right(self) -> bool:
        """Whether no rate sensor has a confirmed fault, or is none at all."""
        return not (self.misnamed or any(record.active for record in self.rates))

    def run(
        self, stamps: IntArray, samples: FloatArray, rows: AnswerRows, first: int
    ) -> Iterator[tuple[int, int, int | None]]:
        """Take samples, all of them in order, and answer them; yields as `go_on` does.

        Parameters
        ----------
        stamps : ndarray of int64, shape (N,)
            [ns], increasing; at least one.
        samples : ndarray, shape (N, 3, n)
            Readings of the position sensors, their rates, efforts; efforts alone may be NaN.
        rows : AnswerRows
            What receives the answers, from row ``first`` on.
        """
        if self._first is None:
            self._first = int(stamps[0])
        stamps = np.ascontiguousarray(stamps)  # for arrays of another layout all is compiled again
        times, values = (stamps - self._first) / NANOSECONDS, samples.copy()
        values[:, 2] *= self._efforts
        steps = times.copy()
        steps[1:] -= times[:-1]
        steps[0] -= self._last_time
        after_gap = steps > LONGEST_STEP * self.arm.sample_time
        begins = sorted({0, *after_gap.nonzero()[0].tolist()})
        for begin, end in zip(begins, [*begins[1:], len(times)]):
            if after_gap[begin]:
                following = times[begin], values[begin, 0], values[begin, 1]
                self.begin_again(following if steps[begin] < math.inf else None)
                self.know(self.stamp_of(self.readings.last()))
            self.progress['taken'] = self.progress['answered'] = self.progress['reported'] = 0
            part = slice(begin, end)
            taken = stamps[part], times[part], values[part]
            yield from self.go_on(self.answering, rows, first + begin, *taken)
        self._last_time, self.unread[:] = float(times[-1]), False

    def go_on(
        self, answering: Answering, rows: AnswerRows, first: int, *taken: Any
    ) -> Iterator[tuple[int, int, int | None]]:
        """Take samples, decide on them and answer them, from where `advance` left.

        ``taken`` are stamps, times and samples, as of `advance`.  Yields rows, the first and the
        one after the last: of answers whose reports may be due; or, with its stamp [ns], of the
        sample from which on more is known.
        """
        progress = self.progress
        if answering is not self.answering:
            progress = plain(answering.progress[0])
        fixed = answering, rows, first, *taken
        while self._call(advance, self.parts, *fixed) or progress['phase'] != SAMPLE:
            now, row = float(self._state['now']), first + int(progress['taken']) - 1
            if progress['phase'] == REPORT:
                yield first + int(progress['reported']), first + int(progress['answered']), None
                progress['reported'] = progress['answered']
            elif progress['phase'] == KNOW:
                yield row, row + 1, int(progress['stamp'])
                progress['phase'] = SAMPLE
            else:
                if progress['phase'] == JUMP:
                    self._report_samples(now)
                    self._tell()
                    progress['phase'] = DECIDE
                else:
                    self._do_stage(now)
                progress['touched'] = True

    def went_on(self, stamp: int) -> None:
        """Samples up to a stamp [ns] were taken by compiled functions."""
        self._last_time = (stamp - (self._first or 0)) / NANOSECONDS

    def doubt(self, shift: int, stamp: int) -> None:
        """The clock was set ahead by ``shift`` [ns], to ``stamp``: faults may have ended since."""
        self._first = (self._first or 0) + shift
        self._balanced += shift
        for sensor in self.sensors:
            sensor.doubt()
        self.know(stamp)

    def watch_from(self, stamp: int) -> None:
        """Balances are due from a stamp on [ns]."""
        self._balances, self._balanced = self.balances, stamp
        self.know(int(self.flags['stamp']))

    def know(self, stamp: int) -> None:
        """Write what holds from a sample [ns] on, until the next decision."""
        settings, sensors, sampler, scales = self.settings, self.sensors, self.sampler, self.scales
        if self.balances != self._balances:
            self._balances, self._balanced = self.balances, stamp
        state = np.array([int(one.state) for one in sensors], np.uint8)
        is_error = state == _ERROR
        is_level = np.array([one.level and one.active for one in sensors])
        doubts = self.doubts()
        (fault, sigma), changing = self.published(doubts), sum(doubts)
        removed, share = self.followed.certain(settings.sigmas)
        rate = sampler.drift + sampler.share / (1.0 - sampler.share) * sampler.samples[-1, 1]
        jump, variance = self.followed.take_jumps()
        self._removed_variance = np.where(is_error, self._removed_variance + variance, 0.0)
        state[(state == _OK) & (sigma > priors.WIDEST_LEVEL * scales)] = _NOT_DIAGNOSABLE
        self.answering.work.applied[:] += jump
        known, flags = self.answering.known, self.flags
        known.fault[:], known.rate[:] = fault, rate
        # What is beyond doubt: all of a confirmed offset, of others what is removed.
        known.confirmed[:] = np.where(is_level, fault, removed)
        known.growth[:] = np.where(is_level, rate, share * rate)
        known.rate_error[:] = np.where(
            sampler.contrast['replaced'] > 0.0, np.nan, sampler.rate_error
        )
        known.bound[:] = settings.sigmas * sigma
        known.threshold[:] = np.maximum(known.bound, settings.minimum_threshold * scales)
        known.limit[:] = [smallest_jump(sampler, i) for i in range(self.joints)]
        noise = [sampler.noisy[i] and reading_noise(sampler, i) for i in range(self.joints)]
        known.noise[:], known.state[:], known.is_error[:] = noise, state, is_error
        known.predicted[:], known.missed[:] = self._accelerations()
        known.is_derived[:] = sampler.derived == 1.0
        left = np.where(is_level, sigma, np.sqrt(self._removed_variance + changing**2))
        flags['stamp'] = stamp
        flags['mode'] = int(Mode.OBSERVING if self.balances else Mode.INITIALISING)
        flags['trustworthy'] = self._can_be_compensated(is_error, left)
        flags['inconsistent'] = bool(self.suspects)
        flags['until'] = self._balanced + UNWATCHED
        flags['fading'] = settings.compensation_rate
        if self._uio is not None:
            # An offset from the start is not in the set: its estimate is on its way.
            doubtful = is_level.any() or self.suspects
            self._uio.rely(self.rates_are_right and not doubtful)

    def _can_be_compensated(self, is_error: BoolArray, sigma: FloatArray) -> bool:
        """Whether what is removed of confirmed faults is known well enough to go on.

        ``sigma``, shape (n,), is the standard deviation of what is left of each [rad].
        """
        if not is_error.any():
            return True
        if self.contradicts:  # a confirmed fault is not, or not only, what it was taken for
            return False
        unseen = np.array([one.unseen for one in self.sensors])
        uncertain = self.settings.sigmas * sigma > self.settings.safe_stop_bound * self.scales
        return not (is_error & (uncertain | unseen)).any()

    def _accelerations(self) -> tuple[FloatArray, FloatArray]:
        """Shares of the readings' accelerations that torques predict, and variances of the rest.

        A loop that is closed on a noisy reading drives its joint as one that froze does.  What
        torques miss may be more than that, as of wrists with friction and hardly any inertia.
        """
        usual = priors.USUAL_ACCELERATION * self.scales
        if not len(self.estimator):
            return np.zeros(self.joints), usual**2
        if self.sampler.noisy.any():  # then it counts
            usual = np.array([self.readings.acceleration(i) for i in range(self.joints)])
        driven = (priors.ACCELERATIONS[-1] * usual) ** 2
        null, window = self.estimator.posterior, self.estimator.window
        mass = window.momenta[slot(window, 0)]
        tiny = np.finfo(float).eps * np.abs(mass).max()  # of joints without inertia
        per_torque = np.linalg.inv(mass + tiny * np.eye(self.joints))
        torque = null.noise**2 * null.inflation + self.missing_efforts * UNMEASURED
        torque /= self.plan.interval**2
        predicted: FloatArray = driven / (driven + per_torque**2 @ torque)
        return predicted, (1.0 - predicted) * driven
