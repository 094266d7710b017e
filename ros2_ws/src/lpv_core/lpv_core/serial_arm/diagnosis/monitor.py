"""Diagnosis of the sensors of a serial arm: one object, one call a sample.

Jumps of readings are found sample by sample; everything else by momentum balances, every 50 ms.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from lpv_core.serial_arm.certificate.jump_bound import jump_bound
from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.estimator import NOISE_KNOWN_AFTER, HorizonPlan, OffsetEstimator
from lpv_core.serial_arm.diagnosis.healthy_set import Guarantee, HealthySet
from lpv_core.serial_arm.diagnosis.hypotheses import (
    CONTACT,
    Explanation,
    all_windows,
    excludes_contact,
    explanations,
    new_search,
    offset_against_contact,
)
from lpv_core.serial_arm.diagnosis.information import NEXT
from lpv_core.serial_arm.diagnosis.learning import Learned, learned_of
from lpv_core.serial_arm.diagnosis.moving_fault import MovingFault, begin_moving_fault, follow
from lpv_core.serial_arm.diagnosis.parameter_set import is_stated
from lpv_core.serial_arm.diagnosis.rate_check import RateCheck
from lpv_core.serial_arm.diagnosis.sampling import (
    BLOCKS,
    SPIKE,
    STEP,
    Sampler,
    new_sampler,
    restart,
    take_samples,
)
from lpv_core.support.errors import SampleError

BoolArray = npt.NDArray[np.bool_]

NANOSECONDS = 1_000_000_000
LONGEST_STEP = 10.0
"""Sample times after which the next sample begins anew."""
NAMED_AFTER = {'stuck': 0.0, 'drift': 0.0, 'scale': 0.6, 'slip': 1.7}
"""Shortest windows that tell a fault from a torque from outside [s]; a slip, which changes the
torques of gravity only, takes longest."""
MARGINS = {'stuck': 4.0, 'drift': 4.0, 'scale': 10.0, 'slip': 12.0}
"""By which a fault's evidence must exceed that of all that is not this sensor's."""
CONTACT_MARGIN = 9.0
"""The same for torques from outside, which are commoner than faults of encoders."""
CONTACT_PAUSE = 1.0
"""What is around a contact by less is not learned from [s]."""
RARE = 0.3
"""Share of repeated readings below which a reading that rests is frozen."""
GUARANTEE_EVERY = 20
"""Balances after which guaranteed thresholds are evaluated anew."""
FROZEN_DWELL = 2
"""Balances for which a frozen reading must be to blame: joints that turn round rest shortly."""
FROZEN_EVIDENCE = 2.0
"""What balances must say for a frozen reading to be stuck; that it froze is evidence of its own."""
STILL_TIME = 0.05
"""A reading without any change for longer rests [s]."""


class SensorState(str, Enum):  # noqa: UP042 - Python 3.10 has no StrEnum
    """State of a position sensor."""

    OK = 'ok'
    WARN = 'warn'
    """A fault that may be this sensor's, or something else's."""
    ERROR = 'error'
    """A fault of this sensor."""
    NOT_DIAGNOSABLE = 'not_diagnosable'
    """Gravity and motion do not tell its offset; changes are still seen."""


@dataclass(frozen=True)
class MonitorSettings:
    """Thresholds of the decisions."""

    evidence: float = 8.0  # logarithm of the ratio of marginal likelihoods of a fault
    margin: float = 4.0  # by which the best explanation must beat those it excludes
    level_sigmas: float = 4.0  # offset over its standard deviation
    smallest_level: float = 0.05  # smallest offset that is a fault [rad]
    smallest_step: float = 0.005  # smallest jump of a reading [rad]
    widest_level: float = 0.1  # standard deviation of an offset that says nothing [rad]
    dwell: int = 1  # balances in a row for which a decision must hold
    contact_dwell: int = 8  # the same for torques from outside
    level_dwell: int = 20  # the same for the level
    horizon: float = 10.0  # [s]


@dataclass(frozen=True)
class SerialAlarm:
    """A fault that was found."""

    sensor: str  # name; '' where none is named
    kind: str  # bias, drift, scale, slip, stuck, spike, contact, torque_offset, ...
    onset: float  # [s]
    detected: float  # [s]
    size: float  # [rad], or [rad/s] of a drift
    sigma: float  # standard deviation of size
    suspects: tuple[str, ...]  # what explains the data about as well
    guaranteed: bool = False  # whether no healthy arm inside its file shows this; else statistical


@dataclass(frozen=True)
class SerialEstimate:
    """What is known after a sample."""

    stamp: int  # of the sample [ns]
    fault: FloatArray  # estimated faults f of the position sensors, y = q + f, shape (n,) [rad]
    sigma: FloatArray  # their standard deviations, shape (n,) [rad]
    state: tuple[SensorState, ...]  # of each sensor
    suspects: tuple[str, ...]  # what explains a contradiction, best first; empty if there is none


class SerialMonitor:
    """Monitor of one arm; where efforts leave out gravity, only jumps of readings are found.

    Parameters
    ----------
    arm : SerialArm
        Arm and sensors.
    settings : MonitorSettings, optional
        Thresholds.
    """

    def __init__(self, arm: SerialArm, settings: MonitorSettings | None = None) -> None:
        self.arm = arm
        self.settings = settings or MonitorSettings()
        self.joints = len(arm.joints)
        self.alarms: list[SerialAlarm] = []
        self._efforts = np.array([joint.torque_gain for joint in arm.joints])
        self._push = 0.3 * np.array([min(joint.limits.torque, 1e3) for joint in arm.joints])
        self._jump_bound = jump_bound(arm)
        self._first: int | None = None
        self.reset()

    def reset(self) -> None:
        """Forget samples, estimates and faults."""
        n, arm = self.joints, self.arm
        self.plan = HorizonPlan.of(arm.sample_time, horizon=self.settings.horizon)
        self.estimator = OffsetEstimator(arm, self.plan)
        noise = np.array([
            np.hypot(joint.sensors.position_noise, joint.sensors.quantization)
            for joint in arm.joints
        ])  # fmt: skip
        self._capacity = self.plan.blocks * (self.plan.capacity + 1)
        self.healthy = HealthySet(arm, self.estimator) if is_stated(arm) else None
        self.guarantee: Guarantee | None = None
        self._unproved: set[int] = set()  # sensors with level alarms that are statistical so far
        self.search = new_search(self.estimator, self._push)
        smallest = np.full(n, self.settings.smallest_step)
        self.sampler: Sampler = new_sampler(
            self.estimator.balance.derived, np.maximum(2.0 * noise, 0.2 * smallest), smallest,
            self._capacity)  # fmt: skip
        self.rate_check = RateCheck(arm, self.plan)
        self._rate_faults: set[int] = set()
        self._state = [SensorState.OK] * n
        self._held: deque[tuple[str, int]] = deque(maxlen=self.settings.contact_dwell)
        self._level_held = np.zeros(n, int)
        self._moving: MovingFault | None = None
        self._suspects: tuple[str, ...] = ()
        self._last_time = -np.inf
        self._contact_until = -np.inf

    def update(
        self, stamp: int, q: npt.ArrayLike, v: npt.ArrayLike, torque: npt.ArrayLike
    ) -> SerialEstimate:
        """Take a sample.

        Parameters
        ----------
        stamp : int
            [ns]; later than that of the sample before.
        q, v, torque : array_like, shape (n,)
            Readings of the position sensors, rates and efforts [rad], [rad/s].

        Returns
        -------
        SerialEstimate
            What is known now; `alarms` has grown where a fault was found.

        Raises
        ------
        SampleError
            If a value is missing or not finite, or the stamp is not later.
        """
        try:
            values = np.array([[q, v, torque]], dtype=float)
        except ValueError as error:
            raise SampleError('positions, rates and efforts differ in number') from error
        if values.shape != (1, 3, self.joints):
            raise SampleError(f'samples must have shape (3, {self.joints}), got {values.shape[1:]}')
        if not np.isfinite(values).all():
            raise SampleError('samples must be finite')
        if self._first is None:
            self._first = int(stamp)
        times = np.array([(int(stamp) - self._first) / NANOSECONDS])
        step = float(times[0]) - self._last_time
        if not step > 0.0:
            raise SampleError('stamps must increase')
        values[:, 2] *= self._efforts
        if step > LONGEST_STEP * self.arm.sample_time:
            self.begin_again()
        self._take(times, values)
        self._last_time = float(times[0])
        return self.estimate(stamp)

    def update_many(self, stamps: npt.ArrayLike, samples: npt.ArrayLike) -> None:
        """Take many samples; the same as `update` one by one.

        Parameters
        ----------
        stamps : array_like of int, shape (N,)
            [ns], increasing.
        samples : array_like, shape (N, 3, n)
            Readings, rates, efforts.

        Raises
        ------
        SampleError
            As `update`.
        """
        values = np.array(samples, dtype=float, order='C')
        moments = np.asarray(stamps, dtype=np.int64)
        if values.shape != (len(moments), 3, self.joints):
            raise SampleError(
                f'samples must have shape ({len(moments)}, 3, {self.joints}), got {values.shape}'
            )
        if not np.isfinite(values).all():
            raise SampleError('samples must be finite')
        if len(moments) == 0:
            return
        if self._first is None:
            self._first = int(moments[0])
        times = (moments - self._first) / NANOSECONDS
        steps = np.diff(times, prepend=self._last_time)
        if not (steps > 0.0).all():
            raise SampleError('stamps must increase')
        values[:, 2] *= self._efforts
        gaps = np.nonzero(steps > LONGEST_STEP * self.arm.sample_time)[0]
        for begin, end in zip([0, *gaps], [*gaps, len(times)]):
            if begin > 0 or (len(gaps) > 0 and gaps[0] == 0):
                self.begin_again()
            self._take(times[begin:end], values[begin:end])
        self._last_time = float(times[-1])

    def begin_again(self) -> None:
        """Begin new balances, as after a gap in the samples."""
        restart(self.sampler, self.estimator.balance)
        if self.healthy is not None:
            self.healthy.restart()
        self.estimator.restart()

    def _take(self, times: FloatArray, samples: FloatArray) -> None:
        """Take samples without a gap between them."""
        k, plan = 0, (self.plan.per_block, self.plan.blocks)
        while k < len(times):
            k, complete = take_samples(
                self.sampler, self.estimator.balance, times, samples, k, plan
            )
            self._after(k, float(times[k - 1]), complete)

    def _after(self, count: int, now: float, complete: bool) -> None:
        """So many samples of those at hand have been taken, and a decision is due."""
        self.decide(now, complete)

    @property
    def uses_balances(self) -> bool:
        """Whether momentum balances say anything: the efforts have to hold the weight."""
        return self.arm.effort_includes_gravity

    def decide(self, now: float, complete: bool) -> None:
        """Decide on what `take_samples` has found; for loops that call it themselves.

        Parameters
        ----------
        now : float
            Time of the last sample, from the first one on [s].
        complete : bool
            Whether a balance is complete.
        """
        self._report_jumps(now)
        if complete and self.uses_balances:
            self._decide(now)

    def estimate(self, stamp: int) -> SerialEstimate:
        """What is known after the last sample."""
        posterior = self.estimator.level
        offsets, sigma = posterior.mean[: self.joints], posterior.sigma
        state = tuple(
            SensorState.NOT_DIAGNOSABLE
            if one is SensorState.OK and sigma[i] > self.settings.widest_level
            else one
            for i, one in enumerate(self._state)
        )
        fault, sigma = self.sampler.correction + offsets, sigma.copy()
        if self._moving is not None:
            i = self._moving.joint
            fault[i] = self.sampler.correction[i] + self._moving.fault(self._last())
            sigma[i] = self._moving.sigma
        return SerialEstimate(stamp, fault, sigma, state, self._suspects)

    def learned(self) -> Learned:
        """What has been learned of the arm: payload, friction, torque offsets, noise."""
        return learned_of(self.arm, self.estimator)

    def _report_jumps(self, now: float) -> None:
        """Alarms of steps and spikes."""
        for i in range(self.joints):
            if self.sampler.found[i] == STEP:
                sigma = float(self.sampler.scale[i])
                size = float(self.sampler.size[i])
                self._raise(i, 'bias', now, size, sigma, abs(size) > self._jump_bound[i])
            elif self.sampler.found[i] == SPIKE:
                self.alarms.append(SerialAlarm(self._sensor(i), 'spike', now, now, 0.0, 0.0, ()))
            self.sampler.found[i] = 0

    def _sensor(self, i: int) -> str:
        return self.arm.sensor_names[i] if i >= 0 else ''

    def _raise(
        self, i: int, kind: str, onset: float, size: float, sigma: float, guaranteed: bool = False
    ) -> None:
        """A fault of sensor i is confirmed."""
        self._state[i] = SensorState.ERROR
        self.alarms.append(SerialAlarm(
            self._sensor(i), kind, onset, self._last(), size, sigma, (), guaranteed))  # fmt: skip

    def _last(self) -> float:
        return float(self.sampler.time[-1])

    def _blocks(self, intervals: int) -> FloatArray:
        """The last blocks, oldest first."""
        written = int(self.sampler.counters[BLOCKS])
        count = min(intervals * self.plan.blocks, written, self._capacity)
        return self.sampler.blocks[np.arange(written - count, written) % self._capacity]

    def _decide(self, now: float) -> None:
        """A balance is complete: estimate, compare explanations, decide."""
        if self._moving is not None:
            self.estimator.take(now, False)
            follow(self._moving, self.estimator, self.sampler, now)
            return
        if self.healthy is not None:
            self.healthy.take(self._blocks(2), not self._suspects)
        self.estimator.add(now, not self._suspects)
        if self.estimator.must_linearise():
            self.estimator.linearise(self._blocks(len(self.estimator) + 1))
        if self.estimator.window.counters[NEXT] % GUARANTEE_EVERY == 0:
            self._evaluate_guarantee()
        self.rate_check.take(self._blocks(self.rate_check.intervals))
        if self._decide_rates():
            return
        found = explanations(
            self.search, self.estimator, self._rest(), np.nonzero(self._is_frozen())[0],
            0.5 * self.settings.evidence, self._blocks)  # fmt: skip
        found = [one for one in found if not self.rate_check.excludes(one, now)]
        if self._frozen(found) is None and (not found or found[0].gain < self.settings.evidence):
            self._suspects = ()
            self._held.clear()
            self._decide_level()
            return
        margin = found[0].gain - self.settings.margin
        rivals = [one for one in found if one.gain > margin]
        self._suspects = tuple(dict.fromkeys(self._label(one) for one in rivals))
        verdict = self._verdict(found)
        if verdict is None:
            self._held.append(('', -1))
            return
        kind = CONTACT if verdict.kind == CONTACT else 'encoder'
        self._held.append((kind, verdict.joint))
        if verdict.kind == CONTACT:
            learned = len(self.estimator) * self.plan.interval > NOISE_KNOWN_AFTER
            if learned and self._has_held(verdict, self.settings.contact_dwell):
                self._report_contact(now)
            return
        dwell = FROZEN_DWELL if self._is_frozen()[verdict.joint] else self.settings.dwell
        if self._has_held(verdict, dwell) and now > self._contact_until:
            self._blame(verdict)

    def _decide_rates(self) -> bool:
        """Encoders that contradict their independent rates; whether one does."""
        joints = [i for i in self.rate_check.joints if i not in self._rate_faults]
        if not joints:
            return False
        begins = all_windows(self.search, self.estimator)
        for i in joints:
            rivals = self.rate_check.explanations(self.search, int(i), begins)
            self._suspects = tuple(self._label(one) for one in rivals)
            if len(rivals) < 2 or rivals[0].gain < rivals[1].gain + self.settings.margin:
                continue
            if rivals[0].kind == 'drift':
                self._blame(rivals[0])
                return True
            kind, begin, size, sigma = (
                getattr(rivals[0], name) for name in ('kind', 'begin', 'size', 'sigma')
            )
            self.alarms.append(
                SerialAlarm(self._sensor(int(i)), kind, begin, self._last(), size, sigma, ())
            )
            self._rate_faults.add(int(i))
        return True

    def _has_held(self, verdict: Explanation, balances: int) -> bool:
        """Whether the same has been to blame for the last balances."""
        held = list(self._held)[-balances:]
        kind = CONTACT if verdict.kind == CONTACT else 'encoder'
        return held == [(kind, verdict.joint)] * balances

    def _verdict(self, found: list[Explanation]) -> Explanation | None:
        """The explanation that is beyond doubt for now, if there is one.

        A reading that froze is evidence of its own.  Else an encoder is named only where its fault
        explains clearly more than faults of other sensors, and than torques from outside of any
        course do; those that are smooth are evaluated only here, for they cost most.
        """
        frozen = self._frozen(found)
        if frozen is not None:
            return frozen
        contact = max(one.gain for one in found if one.kind == CONTACT)
        encoder = [one for one in found if one.is_encoder]
        if contact > max(3.0 * self.settings.evidence, *(2.0 * one.gain for one in encoder)):
            return next(one for one in found if one.kind == CONTACT)
        late = [one for one in encoder if self._last() - one.begin > NAMED_AFTER[one.kind]]
        if not late or late[0].gain < self.settings.evidence:
            return None
        joint = late[0].joint
        rival = max(one.gain for one in found if one.joint != joint or not one.is_encoder)
        own = [one for one in late if one.joint == joint and one.gain > contact + CONTACT_MARGIN]
        best = next((one for one in own if one.gain > rival + MARGINS[one.kind]), None)
        if best and not excludes_contact(self.search, self.estimator, best, CONTACT_MARGIN):
            self._suspects = tuple(dict.fromkeys((*self._suspects, CONTACT)))
            return None
        return best

    def _frozen(self, found: list[Explanation]) -> Explanation | None:
        """What explains a reading that froze, if balances say that the joint moves."""
        for i in np.nonzero(self._is_frozen())[0]:
            own = [one for one in found if one.joint == i and one.is_encoder]
            if own and own[0].gain > FROZEN_EVIDENCE:
                return own[0]
        return None

    def _is_frozen(self) -> BoolArray:
        """Whether a reading stopped dead while it moved, or has lost its noise."""
        still = self.sampler.still * self.arm.sample_time > STILL_TIME
        stopped = self.sampler.stop * STILL_TIME > self.settings.smallest_step
        return still & (stopped | (self.sampler.repeats < RARE))

    def _rest(self) -> tuple[IntArray, FloatArray]:
        """For how many balances each reading rests, and its speed before [rad/s]."""
        time = self.sampler.still * self.arm.sample_time
        resting = np.where(time > STILL_TIME, np.ceil(time / self.plan.interval) + 1, 0)
        return resting.astype(np.int64), np.maximum(self.sampler.stop, 0.1)

    def _report_contact(self, now: float) -> None:
        """Something pushes the arm: no sensor is to blame, and nothing is learned from it."""
        if now > self._contact_until:
            self.alarms.append(SerialAlarm('', CONTACT, now, now, 0.0, 0.0, ()))
        self._contact_until = now + CONTACT_PAUSE
        self.healthy = self.guarantee = None  # the load may be another one from now on
        self.estimator.distrust(round(CONTACT_PAUSE / self.plan.interval))

    def _label(self, one: Explanation) -> str:
        """Name of an explanation for people."""
        return one.kind if one.kind == CONTACT else f'{self._sensor(one.joint)}:{one.kind}'

    def _blame(self, best: Explanation) -> None:
        """A position sensor explains what nothing else does: its fault is followed from now on."""
        i = best.joint
        kind = 'stuck' if self.sampler.still[i] * self.arm.sample_time > STILL_TIME else best.kind
        self._raise(i, kind, best.begin, best.size, best.sigma)
        self.healthy = self.guarantee = None  # readings will be changed
        self._moving = begin_moving_fault(self.estimator, i, kind, best.begin)
        self._suspects = ()

    def _decide_level(self) -> None:
        """Offsets that gravity and motion show."""
        posterior = self.estimator.level
        offsets, sigma = posterior.mean[: self.joints], posterior.sigma
        beyond = np.abs(offsets) > np.maximum(
            self.settings.level_sigmas * sigma, self.settings.smallest_level
        )
        beyond &= sigma < self.settings.widest_level
        self._level_held = np.where(beyond, self._level_held + 1, 0)
        for i in np.nonzero(self._level_held >= self.settings.level_dwell)[0]:
            if self._state[i] is SensorState.ERROR:
                continue
            if offset_against_contact(self.search, self.estimator, int(i)) < self.settings.margin:
                self._suspects = (f'{self._sensor(int(i))}:bias', CONTACT)
                continue
            self._raise_level(int(i), float(offsets[i]), float(sigma[i]))

    def _raise_level(self, i: int, offset: float, sigma: float) -> None:
        """The offset of a sensor is confirmed."""
        self._evaluate_guarantee()
        guaranteed = self.guarantee is not None and bool(self.guarantee.exceeded[i])
        self._raise(i, 'bias', 0.0, offset, sigma, guaranteed)
        if not guaranteed:
            self._unproved.add(i)

    def _evaluate_guarantee(self) -> None:
        """Guaranteed thresholds now; statistical alarms of offsets beyond them are confirmed."""
        if self.healthy is None:
            return
        self.guarantee = self.healthy.evaluate()
        sigma = self.estimator.level.sigma
        for i in [one for one in self._unproved if self.guarantee.exceeded[one]]:
            size = float(self.guarantee.estimate[i])
            self._raise(i, 'bias', 0.0, size, float(sigma[i]), True)
            self._unproved.discard(i)
