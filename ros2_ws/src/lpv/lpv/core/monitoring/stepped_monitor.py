"""A serial arm's monitor that says after which samples it knows more, and what."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.monitoring.compensation import AnswerRows
from lpv.core.monitoring.sample_loop import DECIDE, JUMP, KNOW, REPORT, SAMPLE, Answering, advance
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.core.serial_arm.diagnosis.decision import Parts, reading_noise
from lpv.core.serial_arm.diagnosis.healthy_set import Guarantee
from lpv.core.serial_arm.diagnosis.information import slot
from lpv.core.serial_arm.diagnosis.monitor import SerialAlarm, SerialMonitor
from lpv.core.serial_arm.diagnosis.priors import ACCELERATIONS, USUAL_ACCELERATION, WIDEST_LEVEL
from lpv.core.serial_arm.diagnosis.sampler import JUMP_SCALE, REPLACED
from lpv.core.support.records import plain

_OK, _ERROR, _NOT_DIAGNOSABLE = SensorState.OK, SensorState.ERROR, SensorState.NOT_DIAGNOSABLE


class Snapshot(NamedTuple):
    """What is known from a sample on, until the next decision; arrays of shape (n,)."""

    fault: FloatArray  # estimated faults of the sensors [rad]
    sigma: FloatArray  # their standard deviations [rad]
    removed: FloatArray  # jumps and drifts that are beyond doubt: part of fault [rad]
    share: FloatArray  # of a fault that changes, which is beyond doubt
    rate: FloatArray  # at which faults go on to change [rad/s]
    rate_error: FloatArray  # of rate sensors; NaN where readings are differenced [rad/s]
    removed_sigma: FloatArray  # standard deviations of what is removed [rad]
    jump: FloatArray  # by which readings were found to have jumped at this sample [rad]
    threshold: FloatArray  # beyond which an offset is a fault [rad]
    jump_limit: FloatArray  # change of a reading that may be a jump [rad]
    noise: FloatArray  # variances of readings that are noisy, 0 of others [rad2]
    predicted: FloatArray  # shares of accelerations that torques predict
    missed: FloatArray  # variances of those that they do not predict [rad2/s4]
    state: npt.NDArray[np.uint8]  # of `SensorState`
    is_level: npt.NDArray[np.bool_]  # whether all of fault is confirmed, not only what is removed
    unseen: npt.NDArray[np.bool_]  # confirmed before the clock was set, not seen since
    suspects: tuple[str, ...]  # what explains a contradiction
    contact: bool  # whether torques act from outside
    balances: int  # that were used so far
    alarms: tuple[SerialAlarm, ...]  # found at this sample
    guarantee: Guarantee | None = None  # of the offsets, evaluated last
    is_guaranteed: bool = True  # whether guaranteed thresholds can be evaluated
    misfit: float = 0.0  # standard deviations by which the arm differs from its file
    contradicts: bool = False  # whether readings, corrected, go on to contradict the model

    @property
    def is_error(self) -> npt.NDArray[np.bool_]:
        """Whether each sensor has a confirmed fault."""
        return self.state == _ERROR


class Told(NamedTuple):
    """Who is told between two samples."""

    report: Callable[[int, int], None]  # rows that have been answered, and reports may be due
    known: Callable[[Snapshot, int, int], None]  # what holds from a row and its stamp [ns] on


class SteppedMonitor(SerialMonitor):
    """`SerialMonitor` for samples by the thousand, each of which is answered.

    It is ``blind`` where efforts are missing: only jumps of readings are looked for then.
    """

    def __init__(self, arm: SerialArm) -> None:
        self.blind = False
        super().__init__(arm)

    def reset(self) -> None:
        """Forget samples, estimates, faults and the time of the first sample."""
        super().reset()
        self._first = None
        self.alarms = []
        self._removed_variance = np.zeros(self.joints)

    @property
    def balances(self) -> int:
        """Balances that were used so far."""
        return int(self._state['balances'])

    @property
    def parts(self) -> Parts:
        """What samples are decided on with."""
        return self._parts

    @property
    def rates_are_right(self) -> bool:
        """Whether no rate sensor has a confirmed fault, or is none at all."""
        return not (self.misnamed or any(record.active for record in self.rates))

    @property
    def uses_balances(self) -> bool:
        """As of `SerialMonitor`; missing efforts say nothing either."""
        return super().uses_balances and not self.blind

    def run(
        self,
        stamps: IntArray,
        samples: FloatArray,
        answering: Answering,
        rows: AnswerRows,
        first: int,
        told: Told,
    ) -> None:
        """Take samples as `take_readings`, and answer them from row ``first`` on."""
        self._out, self._row, self._stamps = (answering, rows, told), first, stamps
        self.take_readings(stamps, samples)

    def go_on(
        self, answering: Answering, rows: AnswerRows, row: int, told: Told, *taken: Any
    ) -> None:
        """Go on where `advance` needs Python, with stamps, times and samples that it has taken."""
        self._out, self._row = (answering, rows, told), row
        self._go_on(*taken)

    def went_on(self, stamp: int) -> None:
        """Samples up to a stamp [ns] were taken by compiled functions."""
        self._last_time = (stamp - (self._first or 0)) / 1e9

    def doubt(self, shift: int) -> None:
        """The clock was set ahead by ``shift`` [ns]: faults may have ended since."""
        self._first = (self._first or 0) + shift
        for sensor in self.sensors:
            sensor.doubt()

    def stamp_of(self, seconds: float) -> int:
        """Stamp [ns] of a time since the first sample [s]."""
        return (self._first or 0) + round(seconds * 1e9)

    def _take(self, times: FloatArray, samples: FloatArray) -> None:
        count, progress = len(times), self._out[0].progress[0]
        progress['taken'] = progress['answered'] = progress['reported'] = 0
        self._go_on(self._stamps[:count], times, samples)
        self._row, self._stamps = self._row + count, self._stamps[count:]

    def _go_on(self, stamps: IntArray, times: FloatArray, samples: FloatArray) -> None:
        """Take samples, decide on them and answer them."""
        (answering, rows, told), first = self._out, self._row
        progress, plan = plain(answering.progress[0]), (self.plan.per_block, self.plan.blocks)
        fixed = plan, answering, rows, first, stamps, times, samples
        while self._call(advance, self._parts, *fixed) or progress['phase'] != SAMPLE:
            now, row = float(self._state['now']), first + int(progress['taken']) - 1
            if progress['phase'] == REPORT:
                told.report(first + int(progress['reported']), first + int(progress['answered']))
                progress['reported'] = progress['answered']
            elif progress['phase'] == KNOW:
                told.known(self.snapshot(), row, int(progress['stamp']))
                progress['phase'] = SAMPLE
            else:
                if progress['phase'] == JUMP:
                    self._report_samples(now)
                    self._tell()
                    progress['phase'] = DECIDE
                else:
                    self._do_stage(now)
                progress['touched'] = True

    def snapshot(self) -> Snapshot:
        """What has been known since the last decision."""
        settings, sensors, sampler, scales = self.settings, self.sensors, self.sampler, self.scales
        state = np.array([one.state for one in sensors], np.uint8)
        doubts = self.doubts()
        (fault, sigma), changing = self.published(doubts), sum(doubts)
        jump, variance = self.followed.take_jumps()
        self._removed_variance = np.where(state == _ERROR, self._removed_variance + variance, 0.0)
        state[(state == _OK) & (sigma > WIDEST_LEVEL * scales)] = _NOT_DIAGNOSABLE
        alarms, self.alarms = tuple(self.alarms), []
        return Snapshot(
            fault, sigma, *self.followed.certain(settings.sigmas),
            sampler.drift + sampler.share / (1.0 - sampler.share) * sampler.samples[-1, 1],
            np.where(sampler.contrast[REPLACED] > 0.0, np.nan, sampler.rate_error),
            np.sqrt(self._removed_variance + changing**2), jump,
            np.maximum(settings.sigmas * sigma, settings.minimum_threshold * scales),
            np.maximum(JUMP_SCALE * sampler.usual, sampler.smallest),
            np.array([sampler.noisy[i] and reading_noise(sampler, i) for i in range(self.joints)]),
            *self._accelerations(), state,
            np.array([one.level and one.active for one in sensors]),
            np.array([one.unseen for one in sensors]),
            self._suspects, self.in_contact, self.balances, alarms, self.guarantee,
            self.healthy is not None, self.estimator.misfit(), self.contradicts,
        )  # fmt: skip

    def _accelerations(self) -> tuple[FloatArray, FloatArray]:
        """Shares of the readings' accelerations that torques predict, and variances of the rest.

        A loop that is closed on a noisy reading drives its joint as one that froze does.  What
        torques miss may be more than that, as of wrists with friction and hardly any inertia.
        """
        usual = USUAL_ACCELERATION * self.scales
        if not (self.uses_balances and len(self.estimator)):
            return np.zeros(self.joints), usual**2
        if self.sampler.noisy.any():  # then it counts
            usual = np.array([self.readings.acceleration(i) for i in range(self.joints)])
        driven = (ACCELERATIONS[-1] * usual) ** 2
        null, window = self.estimator.posterior, self.estimator.window
        mass = self.bank.parts.mass[slot(window, 0)]
        tiny = np.finfo(float).eps * np.abs(mass).max()  # of joints without inertia
        per_torque = np.linalg.inv(mass + tiny * np.eye(self.joints))
        torque = null.noise**2 * null.inflation / self.plan.interval**2
        predicted: FloatArray = driven / (driven + per_torque**2 @ torque)
        return predicted, (1.0 - predicted) * driven
