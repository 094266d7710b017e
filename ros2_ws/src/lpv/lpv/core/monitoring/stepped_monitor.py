"""A serial arm's monitor that says after which samples it knows more, and what."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.core.serial_arm.diagnosis.healthy_set import Guarantee
from lpv.core.serial_arm.diagnosis.monitor import SerialAlarm, SerialMonitor
from lpv.core.serial_arm.diagnosis.sampling import JUMP_SCALE, Sampler
from lpv.core.support.jit import njit_in_place

_OK, _ERROR = int(SensorState.OK), int(SensorState.ERROR)
_NOT_DIAGNOSABLE = int(SensorState.NOT_DIAGNOSABLE)


class Snapshot(NamedTuple):
    """What is known from a sample on, until the next decision; arrays of shape (n,)."""

    row: int  # of the sample among those that were taken together
    time: float  # of the sample since the first one [s]
    fault: FloatArray  # estimated faults of the sensors [rad]
    sigma: FloatArray  # their standard deviations [rad]
    removed: FloatArray  # jumps and drifts that are beyond doubt: part of fault [rad]
    share: FloatArray  # of a fault that changes, which is beyond doubt
    rate: FloatArray  # at which faults go on to change [rad/s]
    removed_sigma: FloatArray  # standard deviations of what is removed [rad]
    jump: FloatArray  # by which readings were found to have jumped at this sample [rad]
    threshold: FloatArray  # beyond which an offset is a fault [rad]
    jump_limit: FloatArray  # change of a reading that may be a jump [rad]
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

    @property
    def is_error(self) -> npt.NDArray[np.bool_]:
        """Whether each sensor has a confirmed fault."""
        return self.state == _ERROR


class Numbers(NamedTuple):
    """Some fields of `Snapshot`, which `fill_numbers` writes."""

    rate: FloatArray
    removed_sigma: FloatArray
    jump: FloatArray
    threshold: FloatArray
    jump_limit: FloatArray


@njit_in_place
def fill_numbers(
    numbers: Numbers,
    state: npt.NDArray[np.uint8],
    sampler: Sampler,
    sigma: FloatArray,
    changing: FloatArray,
    jumps: tuple[FloatArray, FloatArray, FloatArray],
    limits: tuple[float, float, float],
    scales: FloatArray,
) -> None:
    """Write what follows from standard deviations of faults, and of those that are followed.

    Parameters
    ----------
    numbers : Numbers
        Written.
    state : ndarray of uint8, shape (n,)
        States of the sensors, and, changed, whether their faults are diagnosable.
    sampler : Sampler
        What is known of the readings.
    sigma, changing : ndarray, shape (n,)
        Standard deviations of all faults, and of those that are followed [rad].
    jumps : tuple of ndarray, shape (n,)
        Jumps since the last decision and their variances, which are forgotten; variances of all
        jumps of the present faults [rad], [rad2].
    limits : tuple
        Standard deviations in a bound; smallest level, standard deviation that says nothing [rad].
    scales : ndarray, shape (n,)
        Of thresholds.
    """
    jump, variance, removed = jumps
    sigmas, smallest, widest = limits
    for i in range(sigma.shape[0]):
        removed[i] += variance[i]
        if state[i] != _ERROR:
            removed[i] = 0.0
        if state[i] == _OK and sigma[i] > widest * scales[i]:
            state[i] = _NOT_DIAGNOSABLE
        numbers.rate[i], numbers.jump[i] = sampler.drift[i], jump[i]
        numbers.removed_sigma[i] = np.sqrt(removed[i] + changing[i] * changing[i])
        numbers.threshold[i] = max(sigmas * sigma[i], smallest * scales[i])
        numbers.jump_limit[i] = max(JUMP_SCALE * sampler.scale[i], sampler.smallest[i])
        jump[i], variance[i] = 0.0, 0.0


_Around = tuple[Callable[[int], None], Callable[[Snapshot], None]]


class SteppedMonitor(SerialMonitor):
    """`SerialMonitor` for samples by the thousand, each of which is answered.

    Parameters
    ----------
    arm : SerialArm
        The arm.

    Attributes
    ----------
    blind : bool
        Efforts are missing: only jumps of readings are looked for.
    """

    def __init__(self, arm: SerialArm) -> None:
        self.blind = False
        super().__init__(arm)

    def reset(self) -> None:
        """Forget samples, estimates, faults and the time of the first sample."""
        super().reset()
        self._first = None
        self.alarms = []
        self._balances, self._row = 0, 0
        self._around: _Around | None = None
        self._removed_variance = np.zeros(self.joints)

    def tune(self, parameters: DiagnosisParameters) -> None:
        """Change what is asked of the decisions; alarms stay."""
        self.settings = replace(
            self.settings,
            hours_between_false_alarms=parameters.hours_between_false_alarms,
            probability_of_wrong_name=parameters.probability_of_wrong_name,
            smallest_level=parameters.minimum_threshold,
            smallest_step=parameters.smallest_step,
            clear_dwell=parameters.clear_dwell,
            latch=parameters.latch,
            sigmas=parameters.sigmas,
        )
        self.apply_settings()

    @property
    def has_rate_fault(self) -> bool:
        """Whether a rate sensor has a confirmed fault."""
        return any(record.active for record in self.rates)

    @property
    def uses_balances(self) -> bool:
        """As of `SerialMonitor`; missing efforts say nothing either."""
        return super().uses_balances and not self.blind

    def run(
        self,
        stamps: IntArray,
        samples: FloatArray,
        before: Callable[[int], None],
        after: Callable[[Snapshot], None],
    ) -> None:
        """Take samples as `take_readings`.

        Parameters
        ----------
        stamps, samples : ndarray
            As of `take_readings`.
        before : callable
            Called with the row of a sample at which something is about to be decided.
        after : callable
            Called with what is known from that sample on.
        """
        self._row, self._around = 0, (before, after)
        try:
            self.take_readings(stamps, samples)
        finally:
            self._around = None

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
        super()._take(times, samples)
        self._row += len(times)

    def decide(self, now: float, complete: bool) -> None:
        """As of `SerialMonitor`."""
        super().decide(now, complete)
        self._balances += complete and self.uses_balances

    def _after(self, count: int, now: float, complete: bool) -> None:
        row = self._row + count - 1
        if self._around:
            self._around[0](row)
        self.decide(now, complete)
        if self._around:
            self._around[1](self.snapshot(row))

    def snapshot(self, row: int = 0) -> Snapshot:
        """What is known now."""
        settings, sensors = self.settings, self.sensors
        state = np.array([one.state for one in sensors], np.uint8)
        fault, sigma = self.faults()
        numbers = Numbers(*np.empty((5, self.joints)))
        limits = settings.sigmas, settings.smallest_level, settings.widest_level
        jumps = self.jump, self.jump_variance, self._removed_variance
        self._call(
            fill_numbers, numbers, state, self.sampler, sigma,
            self.changing_sigma() + self.jump_doubt(), jumps, limits, self.scales,
        )  # fmt: skip
        alarms, self.alarms = tuple(self.alarms), []
        return Snapshot(
            row, self._last(), fault, sigma, *self.certain(), *numbers, state,
            np.array([one.level and one.active for one in sensors]),
            np.array([one.unseen for one in sensors]),
            self._suspects, self.in_contact, self._balances, alarms, self.guarantee,
            self.healthy is not None, self.estimator.misfit(),
        )  # fmt: skip
