"""Diagnosis of the sensors of a serial arm: one object, one call a sample.

Jumps, noise and frozen readings are found sample by sample; everything else by the bank of
hypotheses, at every balance.  A sensor is OK, SUSPECT (what is seen may be its fault), FAULT, or
RECOVERING: a fault ends as it begins, by evidence.  A fault that has been named is followed as an
unknown, and its sensor's readings are corrected by it, so that the next fault is looked for beside
it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.certificate.jump_bound import jump_bound
from lpv.core.serial_arm.chain import COULOMB, BoolArray, FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.alarms import (
    GUARANTEED,
    STATISTICAL,
    Alarm,
    AlarmEvent,
    SensorState,
)
from lpv.core.serial_arm.diagnosis.bank import (
    CONTACT_TIME,
    ENCODER_KINDS,
    QUIET,
    STUCK_FOR,
    Bank,
    Compared,
    Hypothesis,
    in_columns,
)
from lpv.core.serial_arm.diagnosis.decision import DECISION, STILL_TIME, Certified, Parts, Stage
from lpv.core.serial_arm.diagnosis.end_of_fault import EndOfFault, end_of_fault
from lpv.core.serial_arm.diagnosis.estimator import (
    HORIZON,
    NOISE_KNOWN_AFTER,
    HorizonPlan,
    OffsetEstimator,
)
from lpv.core.serial_arm.diagnosis.fault_filter import (
    FaultFilter,
    begin_filter,
    correct_rates_since,
)
from lpv.core.serial_arm.diagnosis.followed_faults import FollowedFaults
from lpv.core.serial_arm.diagnosis.frozen_readings import frozen_readings, frozen_with
from lpv.core.serial_arm.diagnosis.healthy_set import Guarantee, HealthySet
from lpv.core.serial_arm.diagnosis.information import ROBUST, probability
from lpv.core.serial_arm.diagnosis.learning import Learned, learned_of
from lpv.core.serial_arm.diagnosis.linear_bank import STARTS
from lpv.core.serial_arm.diagnosis.lines import BEND
from lpv.core.serial_arm.diagnosis.parameter_set import is_stated
from lpv.core.serial_arm.diagnosis.published_rates import CONTRADICTIONS
from lpv.core.serial_arm.diagnosis.rate_sources import RateSources
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.row_noise import NOISE_SAMPLES
from lpv.core.serial_arm.diagnosis.sampler import (
    CONTRARY,
    DELAY,
    HIDDEN,
    JUMP_SCALE,
    LEFT,
    MOST,
    NOISE_MEMORY,
    NOISY,
    SPIKE,
    STEP,
    new_sampler,
)
from lpv.core.serial_arm.diagnosis.sampling import restart
from lpv.core.serial_arm.diagnosis.sensor_state import SensorRecord
from lpv.core.serial_arm.diagnosis.settings import DiagnosisParameters
from lpv.core.serial_arm.diagnosis.stuck import Frozen, at_rest
from lpv.core.serial_arm.diagnosis.undecided_jumps import UndecidedJumps
from lpv.core.support.records import memory, new_record, plain
from lpv.core.support.timestamps import NANOSECONDS

LONGEST_STEP = 10.0
"""Sample times after which the next sample begins anew."""
OUTSIDE = (priors.CONTACT, 'torque_offset')
"""Causes that are torques from outside, as far as can be told."""
_ALMOST_SURE = math.nextafter(1.0, 0.0)
"""Largest confidence that is not a guarantee."""
_MADE_UP = 20
"""Balances on which is compiled what only a fault needs."""


@dataclass
class _Contact:
    """Torques from outside."""

    begin: float = math.inf  # when something began that they explain as well [s]
    since: float = math.inf  # when they began to be the cause [s]
    until: float = -math.inf  # nothing is learned before [s]
    leant: float = -math.inf  # when they were last the cause of what looks like an offset [s]


class SerialMonitor:
    """Monitor of one arm; where efforts leave out gravity, only jumps of readings are found.

    Parameters
    ----------
    arm : SerialArm
        Arm and sensors.
    settings : DiagnosisParameters, optional
        What is asked of the decisions.

    Attributes
    ----------
    alarms : list of Alarm
        Events so far, those of no sensor (contact, load) included; the caller may empty it.
    parts : Parts
        What samples are decided on with.
    statistic : float
        Logarithm of the statistic of detection at the last balance.
    suspects : tuple of str
        What explains a contradiction, the best explanation first; empty if there is none.
    misnamed : tuple of str
        Joints whose rates the file calls independent, and that are derived from their readings.
    unread : ndarray of bool, shape (n,)
        Sensors without a reading since the last sample, as the caller says.
    """

    def __init__(self, arm: SerialArm, settings: DiagnosisParameters | None = None) -> None:
        self.arm = arm
        self.settings = settings or DiagnosisParameters()
        self.joints = len(arm.joints)
        self.alarms: list[Alarm] = []
        self._first: int | None = None  # stamp of the first sample, from which times count [ns]
        self.scales, kinds = arm.scales(), (*ENCODER_KINDS, 'bias', 'rate_bias')
        self._labels = [{f'{name}:{kind}' for kind in kinds} for name in arm.sensor_names]
        self._steps = {
            Stage.FOLLOW: self._follow,
            Stage.LINEARISE: self._linearise,
            Stage.ENDS: self._weigh_jumps,
            Stage.GUARANTEE: self._renew_guarantee,
            Stage.REST: self._find_stuck,
            Stage.NAME: self._find_cause,
            Stage.RAISE: self._raise_levels,
            Stage.END: self._end_faults,
            Stage.RATES: self._judge_rates,
        }
        self._certify_nothing()
        self.misnamed: tuple[str, ...] = ()
        self.reset()

    def apply_settings(self) -> None:
        """Let changed `settings` count from now on; lengths stay as they are."""
        settings, state = self.settings, self._state
        self.sampler.smallest[:] = settings.smallest_jump * self.scales
        # Noise is beyond z standard deviations with a probability of at most exp(-z^2 / 2).
        tests = settings.threshold(self.arm.sample_time / self.joints)
        self.sampler.lines['limit'] = math.sqrt(2.0 * tests)
        state['threshold'] = settings.threshold(self.plan.interval)
        state['widest'], state['smallest'] = priors.WIDEST_LEVEL, settings.minimum_threshold
        state['sigmas'], state['later'] = settings.sigmas, settings.threshold(HORIZON)
        state['at_start'] = -math.log(priors.FAULT_AT_START)
        self._tell()

    def _certify_nothing(self) -> None:
        """Do without another observer."""
        self._certified = np.zeros(self.joints), np.full(self.joints, np.inf), np.zeros(1, bool)

    def reset(self) -> None:
        """Forget samples, estimates and faults."""
        n, arm, settings = self.joints, self.arm, self.settings
        self._jump_bound = jump_bound(arm)
        self.plan = plan = HorizonPlan.of(arm.sample_time)
        self.estimator = OffsetEstimator(arm, plan)
        sensors = arm.sensors()
        noise = np.hypot(sensors.position_noise, sensors.quantization)
        sizes = plan.blocks * (plan.capacity + 1), plan.per_block, plan.blocks
        self._healthy = HealthySet(arm, self.estimator)
        self.guarantee: Guarantee | None = None
        self._uncorrected: FloatArray | None = None  # offsets of readings as they were, after a gap
        self.bank = Bank(arm, self.estimator)
        smallest = settings.smallest_jump * self.scales
        # Before any e was seen, jumps count from twice the smallest one.
        usual = np.maximum(2.0 * noise, 2.0 * smallest / JUMP_SCALE)
        self._rate_sources = RateSources(arm)
        self.sampler = new_sampler(
            self.estimator.balance.derived, usual, smallest, sizes, self._rate_sources.probe,
            self.scales, arm.sample_time)  # fmt: skip
        self.readings = Readings(self.sampler, self.estimator, arm.sample_time)
        self.sensors = [SensorRecord() for _ in range(n)]
        self.unread = np.zeros(n, bool)
        self.rates = [SensorRecord() for _ in range(n)]
        self.followed = FollowedFaults(self.readings, self.bank, self.sensors, self.rates)
        self._jumps = UndecidedJumps(self.readings, self.bank)
        self._contact = _Contact()
        self._rival = -np.inf  # largest evidence of an encoder's fault while something is suspected
        self.suspects: tuple[str, ...] = ()
        self._suspected = np.zeros(n)  # sizes of the faults among these [rad]
        self._stuck: list[Hypothesis] = []
        stated = is_stated(arm)
        decision = new_record(
            DECISION, sample_time=arm.sample_time, held=2 * plan.per_interval + DELAY,
            guarantees=stated, sound=stated, lost=-1)  # fmt: skip
        self._state, count = plain(decision), 2 * plan.blocks
        self.parts = Parts(
            memory(decision), self.sampler, self.estimator.horizon, self._healthy.ring,
            self.bank.parts, self.estimator.prior, np.zeros(n), self._certified, np.zeros((2, n)),
            np.zeros((count, 3 * n + 4)), np.zeros((count, n)), np.zeros(n), np.zeros((3, n)),
        )  # fmt: skip
        self.apply_settings()

    def certify(self, certified: Certified) -> None:
        """Raise offsets that another observer certifies, too."""
        self._certified = certified
        self.parts = self.parts._replace(certified=certified)

    @property
    def healthy(self) -> HealthySet | None:
        """What bounds the estimates of a healthy arm, unless the horizon holds something else."""
        return self._healthy if self._state['sound'] else None

    @property
    def statistic(self) -> float:
        """Logarithm of the statistic of detection at the last balance."""
        return self.bank.statistic

    def begin_again(self, following: tuple[float, FloatArray, FloatArray] | None = None) -> None:
        """Begin new balances, as after a gap in the samples.

        ``following`` is the sample after it, if it is known: time [s], readings and rates.
        """
        if following is not None:
            self._compare_after_gap(*following)
        self._jumps.settle()
        for i, sensor in enumerate(self.sensors):
            sensor.wrong_until = -math.inf  # of no new balance
            if sensor.active and sensor.level:  # new balances know of no offset
                self._jumps.take_out(i, self.followed.take_out_level(i))
                sensor.level = sensor.unproved = False
        removed = self.followed.taken_out()
        self._uncorrected = -removed if removed.any() else None
        restart(self.sampler, self.estimator.balance)
        self._healthy.restart()
        self.estimator.restart()
        self.bank.kinematics.restart()
        self._see_nothing_wrong()
        self._mark_suspects()
        self._tell()

    def _compare_after_gap(self, time: float, reading: FloatArray, rate: FloatArray) -> None:
        """Faults may have begun or ended since the last sample.

        Both are rare, and less so where the sensor itself had no readings meanwhile.  A fault goes
        on where usual motion may explain that; else it is over, or has begun, where nothing but
        that explains the way of the reading.
        """
        sampler, gap, sigmas = self.sampler, time - self.readings.last(), self.settings.sigmas
        level = self.estimator.level
        offset = np.array([one.level for one in self.sensors]) * level.mean[: self.joints]
        fault, change = self.followed.taken_out() + offset, reading - sampler.raw
        known = self.followed.sigma(), (offset != 0.0) * level.sigma
        reach = sigmas * np.hypot(*known) + self._reach(gap, rate)
        growth = sampler.drift * gap + sampler.share * change
        way = change - growth - 0.5 * gap * (sampler.samples[-1, 1] + rate)
        least = self.settings.minimum_threshold * self.scales
        for i, sensor in enumerate(self.sensors):
            lasts = abs(way[i]) < reach[i]
            is_over = abs(way[i] + growth[i] + fault[i]) < reach[i]
            if not sensor.active:
                if self.unread[i] and not lasts and abs(way[i]) > least[i]:
                    jump, sigma = float(way[i]), float(reach[i]) / sigmas
                    end = end_of_fault(self.readings, self.bank, i, jump, 0.0)
                    ends = end.share > self.settings.beyond or self._may_end_offset(i, jump)
                    self.followed.take_jump(i, jump, sigma)
                    self._raise(i, 'bias', time, jump, sigma + ends * abs(jump) / sigmas)
            elif sensor.kind == 'noise' or abs(fault[i]) < least[i]:
                continue
            elif is_over and not lasts:
                self._jumps.forget(i)
                self.followed.take_jump(i, -float(fault[i]), 0.0)
                self.followed.end(i)
                sensor.recover(time)
            elif not lasts or (self.unread[i] and is_over):
                sensor.doubt()

    def _reach(self, gap: float, rate: FloatArray) -> FloatArray:
        """How far off the mean of the rates before and after a gap [s] may be, (n,) [rad].

        A rate changes from one to the other at any time, and besides as it usually does.
        """
        sampler, every = self.sampler, range(self.joints)
        bend = 0.25 * gap * gap * np.array([self.readings.acceleration(i) for i in every])
        own, differenced = self.arm.sensors().velocity_noise, sampler.usual / self.arm.sample_time
        noise = gap * np.where(sampler.derived == 1.0, differenced, own)
        usual: FloatArray = np.sqrt(sampler.usual**2 + noise**2 + bend**2)
        return self.settings.sigmas * usual + 0.5 * gap * np.abs(rate - sampler.samples[-1, 1])

    @property
    def missing_efforts(self) -> BoolArray:
        """Joints whose efforts are missing in the newest balance, or later."""
        return np.asarray(self.sampler.measured < self._state['held'])

    def _do_stage(self, now: float) -> None:
        """Do the stage of a decision at which `decide` left."""
        self._state['stage'] = int(self._steps[self._state['stage']](now))
        self._tell()

    def _tell(self) -> None:
        """Say what decisions have to know."""
        state, suspects = self._state, bool(self.suspects)
        state['learns'] = not (suspects or self.followed.known)
        state['follows'] = len(self.followed) > 0
        state['ends'] = len(self._jumps) > 0
        known = self.followed.known or any(rate.active for rate in self.rates)
        state['disturbed'] = bool(known) or self.followed.taken_out().any()
        if state['disturbed']:
            self._lose_guarantee()
        state['suspects'] = suspects or bool(self._suspected.any())
        state['pushed'] = self._contact.since < math.inf
        alarm = self._has_alarm()
        state['active'] = alarm
        state['usual'] = state['learns'] and not (self._jumps.ends or state['pushed'] or alarm)

    def faults(
        self, doubts: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Faults f of the position sensors and their standard deviations, shape (n,) [rad].

        ``doubts`` are those of `doubts`, where they are at hand.
        """
        level, (changing, doubt) = self.estimator.level, doubts or self.doubts()
        fault = self.followed.taken_out() + level.mean[: self.joints]
        return fault, np.hypot(level.sigma, changing) + doubt

    def published(
        self, doubts: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """As `faults`; bounds hold 0, too, where an offset is not confirmed.

        Torques from outside may be what looks like one.
        """
        fault, sigma = self.faults(doubts)
        quiet = np.array([not one.active for one in self.sensors])
        offset = quiet * np.abs(self.estimator.level.mean[: self.joints])
        return fault, np.maximum(sigma, offset / self.settings.sigmas)

    def doubts(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations of what changes, and of what is not decided, shape (n,) [rad]."""
        return self.followed.sigma(), self._undecided_sigma()

    def _undecided_sigma(self) -> FloatArray:
        """What is not decided adds to standard deviations, shape (n,) [rad].

        While a jump may have been the end of a fault, or a scale error's, bounds hold that as well,
        and so they do of a fault that `_hold` finds or that is suspected, and the ways of a joint
        whose reading is frozen while all others rest, or rests again while the alarm that it was
        frozen is up.
        """
        error = self._jumps.errors(self.settings.beyond)
        filters, now = self.followed.filters, self.readings.last()
        for i, sensor in enumerate(self.sensors):
            if i in filters:
                error[i] = max(error[i], filters[i].since_rest(now))
            elif sensor.active and sensor.kind == 'stuck':
                # Balances of less than that time were made of readings before it.
                rested = self.readings.rested(i)
                if rested < STUCK_FOR[0] or not self._rests(i):
                    error[i] = max(error[i], priors.USUAL_RATE * float(self.scales[i]) * rested)
        return np.maximum(self._suspected, error) / self.settings.sigmas

    def learned(self) -> Learned:
        """What has been learned of the arm: payload, friction, torque offsets, noise."""
        return learned_of(self.arm, self.estimator)

    def warm_up(self) -> None:
        """Compile what only a fault needs, on made-up balances: no sample may have been taken."""
        plan = self.estimator.plan
        count, length = (_MADE_UP + 1) * plan.blocks, plan.interval / plan.blocks
        blocks = np.zeros((count, *self.readings.all_blocks().shape[1:]))
        blocks[:, -4], blocks[:, -3] = length * np.arange(count), length  # times, lengths [s]
        self.estimator.pretend(_MADE_UP)
        with np.errstate(all='ignore'):
            self.estimator.linearise(blocks)
            self.bank.offset_against_contact(0)
            self.bank.warm_up(blocks)
            self.readings.noise(0)

    def _report_samples(self, now: float) -> None:
        """Events of what was found at a sample."""
        self.followed.note_jumps()
        for i in range(self.joints):
            found, self.sampler.found[i] = self.sampler.found[i], 0
            if found == STEP:
                self._jumped(i, float(self.sampler.size[i]), now)
            elif found == SPIKE:
                if not (self.sensors[i].active or self._is_small(i, self.sampler.size[i])):
                    self._event(i, 'spike', now, AlarmEvent.RAISED, 0.0, 0.0)
                    self._event(i, 'spike', now, AlarmEvent.CLEARED, 0.0, 0.0)
            elif found == CONTRARY:
                self._blame_derived_rate(i, now)
            elif found == HIDDEN:
                self.estimator.doubt_readings(i, abs(float(self.sampler.size[i])))
            elif found == NOISY:
                if i in self.followed.filters:
                    self._forget(i)
                self._jumps.forget(i)
                self.followed.trust_rate(i)
                noise, since = self.readings.noise(i), now - NOISE_MEMORY * self.arm.sample_time
                self.estimator.doubt_rates(i, noise, since)
                self._raise(i, 'noise', now, noise, 0.0)
        self.followed.note_correction()

    def _jumped(self, i: int, size: float, now: float) -> None:
        """A reading jumped; what remains of its fault is over, or another fault."""
        sensor, sigma = self.sensors[i], float(self.sampler.usual[i])
        fault = float(self.followed.taken_out()[i] + self.estimator.level.mean[i] * sensor.level)
        back, scaled = self.followed.filters.get(i), self._jumps.scaled.get(i)
        if sensor.state is SensorState.ERROR and back is not None and back.is_scale:
            fault = float(size + self.sampler.share[i] * self.sampler.raw[i])
        elif scaled is not None:  # if it was one, it jumps back by its share of the reading now
            fault = min(fault, size + scaled.size * float(self.sampler.raw[i]), key=abs)
        # Beside a fault that is followed, an offset from before may remain, if that explains more.
        before = float(self.sampler.correction[i]) - size
        beside = back is not None and not back.is_scale and abs(fault - before) < abs(fault)
        kept = before if beside else 0.0
        # A frozen reading that jumps is where its joint is, however uncertain that was.
        if sensor.state is SensorState.ERROR and (
            (back is not None and back.kind == 'stuck')
            or abs(fault - kept) < max(LEFT * abs(size), self._smallest_step(i))
        ):
            if sensor.level:
                self._forget(i)
            else:
                self._release(i, int(self.sampler.since[i]), kept)
            self._remains(i, kept, now)
            return
        self._jumps.forget(i)
        if not sensor.active and self._is_small(i, size):
            self._forget(i)
            self.bank.kinematics.note_jump(i, sigma**2)
            self._lose_guarantee()
            return
        if back is None:
            end = self._jumps.begin(i, size, sigma, self._freezes_again(i))
            sigma += float(self._undecided_sigma()[i])
            if sensor.active and end.share >= 1.0 - self.settings.probability_of_wrong_name:
                self.bank.kinematics.note_jump(i, sigma**2)
                return  # of a fault that is known
        self.bank.kinematics.note_jump(i, sigma**2)
        kind, guaranteed = sensor.kind if back else 'bias', self._is_no_motion(i, abs(size))
        if sensor.active:
            self._raise(i, kind, now, fault, guaranteed=guaranteed)
        else:
            if self._may_end_offset(i, size):
                least = abs(size) / self.settings.sigmas
                sigma = max(sigma, float(self.sampler.usual[i]) + least)
            self._raise(i, kind, now, size, sigma, guaranteed)

    def _may_end_offset(self, i: int, jump: float) -> bool:
        """Whether a jump may end an offset that nobody named.

        It may have been there at the start; gravity and motion tell, where they show offsets.
        """
        level, scale = self.estimator.level, float(self.scales[i])
        mean, sigma = float(level.mean[i]), float(level.sigma[i])
        odds = math.log(priors.FAULT_AT_START) - jump * (mean + 0.5 * jump) / sigma**2
        return probability(odds) > self.settings.beyond and sigma < priors.WIDEST_LEVEL * scale

    def _is_no_motion(self, i: int, jump: float) -> bool:
        """Whether no healthy arm moves so far between two of the last samples.

        The way of an acceleration grows with the square of a period, and what differences of
        readings say of a long one with its ratio to a short one.
        """
        periods, bound = np.diff(self.sampler.time), float(self._jump_bound[i])
        if self.sampler.lines['found'][i] == 1.0:
            bound *= BEND
        longest, shortest = float(periods.max()), float(periods.min())
        is_far = jump > bound * (longest / self.arm.sample_time) ** 2
        return is_far and jump * shortest > bound * longest

    def _freezes_again(self, i: int) -> float:
        """Logarithm of the odds that a reading froze before it jumped, against another fault.

        While its alarm is up a freeze comes back, or not, and another fault as rarely as ever.
        """
        if self.sensors[i].kind != 'stuck':
            return 0.0
        dwell = max(self.settings.clear_dwell, self.plan.interval)
        return -math.log(priors.OCCURRENCE['slip'] * dwell / 3600.0)

    def _smallest_step(self, i: int) -> float:
        """Smallest jump of a reading that is a fault [rad]."""
        return float(self.settings.smallest_step * self.scales[i])

    def _is_small(self, i: int, jump: float) -> bool:
        """Whether a jump of a reading, or what is left of one, is no fault."""
        return abs(jump) < self._smallest_step(i)

    def _raise(
        self, i: int, kind: str, onset: float, size: float, sigma: float | None = None,
        guaranteed: bool = False, confidence: float = 1.0
    ) -> None:  # fmt: skip
        """A fault of sensor i is confirmed, or changed.

        A fault is as uncertain as it is published to be; ``sigma`` is that of another ``size``, of
        a jump or of noise.
        """
        sensor = self.sensors[i]
        event = AlarmEvent.UPDATED if sensor.active else AlarmEvent.RAISED
        sensor.confirm(kind, onset, abs(size))
        if sigma is None:
            sigma = float(self.faults()[1][i])
        self._event(i, kind, onset, event, size, sigma, guaranteed, confidence)

    def _event(
        self, i: int, kind: str, onset: float, event: AlarmEvent, size: float, sigma: float,
        guaranteed: bool = False, confidence: float = 1.0
    ) -> None:  # fmt: skip
        if event is not AlarmEvent.UPDATED:
            self.bank.note_change()
        name, bound = self.arm.sensor_names[i] if i >= 0 else '', self.settings.sigmas * sigma
        self.alarms.append(Alarm(
            event, i, name, self.stamp_of(onset), self.stamp_of(self.readings.last()), size, bound,
            kind, 1.0 if guaranteed else min(confidence, _ALMOST_SURE),
            basis=GUARANTEED if guaranteed else STATISTICAL, unit=self.arm.position_units[i],
            rate=float(self.sampler.drift[i]) if kind == 'drift' else 0.0))  # fmt: skip

    def stamp_of(self, seconds: float) -> int:
        """Stamp [ns] of a time since the first sample [s]."""
        return (self._first or 0) + round(seconds * NANOSECONDS)

    def _follow(self, _: float) -> Stage:
        self.followed.update()
        return Stage.ESTIMATE

    def _linearise(self, _: float) -> Stage:
        other = self._uncorrected if len(self.estimator) < NOISE_SAMPLES else None
        self.estimator.linearise(self.readings.all_blocks(), other)
        return Stage.ENDS

    def _find_stuck(self, now: float) -> Stage:
        """Readings that rest while their joints move: nobody has named them, nor did they jump."""
        known, jumps = self.followed.filters, self._jumps
        frozen = {
            i: one
            for i, one in self._frozen().items()
            if i not in known and jumps.is_settled(i, now)
        }
        self._stuck = self.bank.stuck(frozen, self.readings.blocks)
        self._state['rests'] = bool(self._stuck)
        return Stage.ASK

    def _find_cause(self, now: float) -> Stage:
        """Compare hypotheses, name a cause."""
        found, stuck = Compared(in_columns([]), []), self._stuck if self._state['rests'] else []
        if self._state['asked']:
            found = self.bank.compare(self.readings.blocks, stuck, self._wrong_of_late(now))
        seen = self._seen(found)
        self._suspected[:] = 0.0
        if seen is not None:
            self._blame(*seen, now)
        elif self.bank.statistic < self._state['threshold']:
            self._see_nothing_wrong()
            self._hold(found, now)
        else:
            self._name(found, now)
        self._mark_suspects()
        quiet = seen is None and self.bank.statistic < self._state['threshold']
        return Stage.LEVELS if quiet else Stage.END

    def _wrong_of_late(self, now: float) -> set[int]:
        """Sensors that do not tell of all intervals of the balances whether their joints rested."""
        first = now - STARTS[-1] - 2.0 * self.plan.interval
        late = (i for i, one in enumerate(self.sensors) if one.wrong_until > first)
        return {*self.followed.known, *late}

    def _weigh_jumps(self, now: float) -> Stage:
        """Whether jumps were scale errors, or the ends of faults that nobody had noticed."""
        following = Stage.GUARANTEE
        for scaled, ended in self._jumps.scale_errors(now, self._sure):
            spread = 1.0 / self.settings.sigmas if ended > self.settings.beyond else 0.0
            self._begin_following(scaled.filter(self.readings.ended(), spread), 1.0)
            following = Stage.END  # the estimate is still that of the readings before
        for end in self._jumps.ended_faults(now, self.settings.probability_of_wrong_name):
            self._end_unnoticed(end, now)
        return following

    def _end_unnoticed(self, one: EndOfFault, now: float) -> None:
        """A jump was the end of a fault; what the reading had before it may remain."""
        i = one.joint
        one.take_back(self.readings)
        self.followed.note_correction()
        self.bank.kinematics.forget(i)
        self._lose_guarantee()
        left = float(self.followed.taken_out()[i])
        if self._is_small(i, left):
            self._forget(i)
        self._remains(i, left, now)

    def _remains(self, i: int, left: float, now: float) -> None:
        """A fault of sensor i is over, and an offset beside it remains, if that is one."""
        sensor = self.sensors[i]
        if sensor.level or self._is_small(i, left):
            sensor.recover(now)
            return
        sensor.peak = 0.0  # it never was as large as the other one
        self._raise(i, 'bias', sensor.onset, left)

    def _seen(self, found: Compared) -> tuple[Hypothesis, float] | None:
        """What explains a reading that froze, if balances say that its joint went on; confidence.

        That it froze, out of motion or without its noise, is evidence of its own: a push or another
        fault would have to come within the same few seconds.  Brakes stop readings as well: where
        all joints came to rest with this one, they must be less likely than that all readings which
        stopped in the same sample froze.
        """
        finite = [one for one in found.single if math.isfinite(one.gain)]
        shown = [one for one in finite if one.seen and one.joint not in self.followed.filters]
        best = max(shown, key=lambda one: one.gain, default=None)
        if best is None or best.gain <= self._sure:
            return None
        still, together = self.sampler.still, dict[int, float]()
        for one in shown:
            if still[one.joint] == still[best.joint]:
                together[one.joint] = max(one.gain, together.get(one.joint, 0.0))
        brakes = self._brakes(best.joint, finite)
        gain = min(best.gain, sum(together.values()) - brakes)
        return (best, 1.0 - math.exp(-gain)) if gain > self._sure else None

    def _brakes(self, i: int, found: list[Hypothesis]) -> float:
        """What brakes explain that stopped the joint of reading i; 0 where no other one moved."""
        n, blocks, rested = self.joints, self.readings.all_blocks(), self.readings.rests_since(i)
        first = rested - priors.STEADY_FOR - 2.0 * self.plan.interval  # brakes take a time
        between = (blocks[:, 3 * n] > first) & (blocks[:, 3 * n] < rested)
        others = [j for j in range(n) if j != i]
        if at_rest(blocks[between, n : 2 * n], self.scales, others).all():
            return 0.0
        last = rested + self.plan.interval
        stops = (one for one in found if one.kind == priors.CONTACT and first < one.begin < last)
        return max((one.gain for one in stops), default=0.0)

    def margin(self, kind: str) -> float:
        """By how much a fault must be more likely than torques from outside."""
        ratio = priors.OCCURRENCE[priors.CONTACT] * self.joints / priors.OCCURRENCE[kind]
        return math.log(ratio / self.settings.probability_of_wrong_name)

    def _name(self, found: Compared, now: float) -> None:
        """What explains the balances is beyond doubt, or several causes are suspected."""
        known, wrong = self.followed.known, self.settings.probability_of_wrong_name
        if known:
            found = found.where(~np.isin(found.rows['joint'], list(known)))
        every, explained = found, self._jumps.explain(found, wrong)
        found = found.where(~explained)
        if not found.rows.size:
            self._suspect_nothing()
            return
        rival = float(found.rows['gain'][found.is_encoder].max(initial=-math.inf))
        self._rival = max(self._rival, rival)
        shares = self.bank.shares(found)
        likely = [one for one, share in shares if share > wrong]
        self.suspects = tuple(self._label(one) for one in likely)
        self._hold(every, now)
        one, share = shares[0]
        # What a jump explains is weighed on its own, and stays a rival of other causes.
        own = (every.rows['joint'] == one.joint) & (every.is_encoder == one.is_encoder)
        share *= math.exp(found.odds - every.where(~(explained & own)).odds)
        for i, (gain, largest) in self.bank.free_courses(found, self.settings.sigmas).items():
            self._rival = max(self._rival, gain)
            if not one.is_encoder:
                self._suspected[i] = max(self._suspected[i], largest)
        # An offset of a torque sensor cannot be told from a torque on its joint.
        begins = (other.begin for other in likely if other.kind in OUTSIDE)
        self._contact.begin = min(self._contact.begin, *begins, math.inf)
        outside = sum(other for cause, other in shares if cause.kind in OUTSIDE)
        outside *= math.exp(found.odds - every.odds)
        if outside >= 1.0 - wrong:
            self._contact.since = min(self._contact.since, now)
            if self._knows_noise and now - self._contact.since >= CONTACT_TIME:
                self._report_contact(now)
            return
        self._contact.since = math.inf
        if not share >= 1.0 - wrong:  # also where no share can be told
            return
        if one.doubt is not None:
            if one.gain - rival > self._sure:
                self.estimator.doubt_balances(one.doubt)
                self._suspect_nothing()
        elif one.change is not None:
            # A fault would be forgotten with it; what that explains is not found at every decision.
            # A rate that is right again, and still corrected, looks like a load.
            rated = any(record.active for record in self.rates)
            explains_more = one.gain - self._rival > self._sure and not rated
            if explains_more and one.gain - self.bank.friction_gain() > self._sure:
                self._change_load(one.begin, one.change)
        elif one.is_encoder:
            # What acts from outside is not told from unknown noise by balances alone.
            told = self._knows_noise or self.sampler.derived[one.joint] == 0.0
            if told and self.bank.excludes_contact(one, self.margin(one.kind)):
                self._blame(one, share, now)
            else:
                self.suspects = tuple(dict.fromkeys((*self.suspects, priors.CONTACT)))
        elif one.kind == 'rate_bias':
            self._blame_rate(one, share)

    @property
    def _knows_noise(self) -> bool:
        """Whether the noise of balances has been learned; before, it is what the file expects."""
        return len(self.estimator) * self.plan.interval > NOISE_KNOWN_AFTER

    def _hold(self, found: Compared, now: float) -> None:
        """Let bounds hold faults of encoders that are more probable than what lies beyond bounds.

        A healthy arm is one of the explanations.  What a jump explains is weighed on its own.
        """
        beyond, rows = self.settings.beyond, found.rows
        healthy = math.log(3600.0 / self.plan.interval)  # odds are those of causes per hour
        surplus = rows['odds'] - np.logaddexp(found.odds, healthy) - math.log(beyond)
        held = found.is_encoder & (surplus > 0.0) & ~self._jumps.explain(found, beyond)
        held &= ~np.isin(rows['joint'], list(self.followed.known))
        # Normal sizes that are as probable as what lies beyond.
        reach = np.sqrt(2.0 * np.maximum(surplus, 0.0)) * rows['sigma']
        largest = (np.abs(rows['size']) + reach) * self._growth(found, now)
        np.maximum.at(self._suspected, rows['joint'][held], largest[held])

    def _growth(self, found: Compared, now: float) -> FloatArray:
        """How large a fault of an encoder is by now, over its size."""
        joints, since = found.rows['joint'], now - found.rows['begin']
        farthest = np.array([self.readings.farthest(i) for i in range(self.joints)])
        grown = np.where(found.of_kind('scale'), farthest[joints], 1.0)
        return np.where(found.of_kind('drift'), since, grown)

    def _frozen(self) -> dict[int, Frozen]:
        """Readings that may be frozen."""
        smallest = self.settings.smallest_step * self.scales
        is_wrong = self.bank.statistic > QUIET * self._state['threshold']
        return frozen_readings(self.readings, self.sensors, smallest, is_wrong)

    def _report_contact(self, now: float) -> None:
        """Something pushes the arm: no sensor is to blame, and nothing is learned from it."""
        if now > self._contact.until:
            self._event(-1, priors.CONTACT, now, AlarmEvent.RAISED, 0.0, 0.0)
        self._contact.until = now + CONTACT_TIME
        self._lose_guarantee()  # the load may be another one from now on
        acted = max(now - self._contact.begin, CONTACT_TIME)
        # Beginnings are ends of balances, but for rounding.
        self.estimator.distrust(round(acted / self.plan.interval))

    def _change_load(self, begin: float, change: FloatArray) -> None:
        """The arm has taken a load, or put it down: it is another arm from now on."""
        self.estimator.change_load(begin, change)
        self.bank.restart_statistic()
        self._lose_guarantee()
        self._event(-1, priors.LOAD, begin, AlarmEvent.RAISED, 0.0, 0.0)
        self._suspect_nothing()

    @property
    def in_contact(self) -> bool:
        """Whether torques act from outside."""
        return bool(self._contact.until > self._state['now'])

    @property
    def contradicts(self) -> bool:
        """Whether readings, corrected as they are, go on to contradict the model."""
        recently = max(round(CONTACT_TIME / self.plan.interval), 1)
        return bool(self.suspects) and self.estimator.contradiction(recently) > ROBUST

    def _label(self, one: Hypothesis) -> str:
        """Name of a hypothesis for people."""
        if one.joint < 0:
            return one.kind
        is_position = one.is_encoder or one.kind == 'rate_bias'
        names = self.arm.sensor_names if is_position else self.arm.joint_names
        return f'{names[one.joint]}:{one.kind}'

    def _blame(self, one: Hypothesis, share: float, now: float) -> None:
        """A position sensor explains what nothing else does: its fault is followed from now on."""
        i = one.joint
        frozen = self._frozen()
        rests = i in frozen or self.readings.rested(i) > max(STILL_TIME, now - one.begin)
        if not (rests or one.kind == 'stuck'):
            self._begin_following(self._begin(one), share)
            return
        together = frozen_with(self.readings, frozen, i, self.followed.known)
        course = None if together else one.course  # balances took what froze with it for known
        for j in (*together, i):
            begin = one.begin if j == i else self.readings.rests_since(j)
            self._begin_following(self.followed.frozen(j, begin, course), share)

    def _begin_following(self, one: FaultFilter, share: float) -> None:
        """A fault has been named, with some confidence: it is followed from now on."""
        i = one.joint
        self.followed.begin(one)
        self._suspect_nothing()
        name, fault = {'slip': 'bias'}.get(one.kind, one.kind), float(self.faults()[0][i])
        self._raise(i, name, one.begin, fault, confidence=share)

    def _begin(self, one: Hypothesis) -> FaultFilter:
        """Filter of a fault of a reading that goes on."""
        blocks = self.readings.all_blocks()
        origin = float(np.interp(one.begin, blocks[:, 3 * self.joints], blocks[:, one.joint]))
        # Uniform over the starts that the named one stands for.
        spread = one.starts * self.plan.interval / math.sqrt(12.0)
        scale = float(self.scales[one.joint])
        return begin_filter(one, self.readings.ended(), origin, spread, scale)

    def _blame_rate(self, one: Hypothesis, share: float) -> None:
        """A rate sensor contradicts its encoder, and balances say that it is the one to blame."""
        record = self.rates[one.joint]
        if record.active:
            return
        size, sigma = one.size, one.sigma
        newest = self.bank.kinematics.last(one.joint)
        if newest is not None:
            # It began somewhere in the first interval of its window; the last one has all of it.
            size, sigma = -newest[0] / self.plan.interval, newest[1] ** 0.5 / self.plan.interval
        record.confirm('rate_bias', one.begin, abs(size))
        self.followed.trust_rate(one.joint)
        self.sampler.rate_error[one.joint] = size
        correct_rates_since(one.joint, one.begin, size, self.readings)
        self._event(one.joint, 'rate_bias', one.begin, AlarmEvent.RAISED, size, sigma,
                    confidence=share)  # fmt: skip

    def _blame_derived_rate(self, i: int, now: float) -> None:
        """A rate contradicts the reading that it is said to be derived from, as one that wraps."""
        apart = float(self.sampler.contrast['apart'][i])
        onset = now - CONTRADICTIONS * self.arm.sample_time
        self.rates[i].confirm('rate_bias', onset, abs(apart))
        self.sampler.contrast['replaced'][i] = 1.0
        self._event(i, 'rate_bias', onset, AlarmEvent.RAISED, apart, 0.0)

    def _rate_agrees(self, i: int, now: float) -> bool:
        """Whether a rate has agreed with its reading of late."""
        if i in self.followed.held_rates:
            return False
        if self.sampler.derived[i] == 1.0:
            agrees_since = now - float(self.sampler.contrast['contrary_at'][i])
            return agrees_since > STARTS[-1] - self.settings.clear_dwell
        return self.bank.kinematics.agrees(i, float(self.sampler.rate_error[i])) > 0.0

    def _raise_levels(self, now: float) -> Stage:
        """Offsets that gravity and motion show."""
        if self._is_held():
            self._report_contact(now)
            return Stage.END
        gain, excluded = self.parts.beyond
        suspected, guaranteed = (gain > 0.0) | (excluded > 0.0), excluded > 0.0
        if self._state['exceeds'] and self.guarantee is not None:
            guaranteed |= self.guarantee.exceeded
        self._state['exceeds'] = False
        for i in np.flatnonzero(suspected | guaranteed).tolist():
            sensor = self.sensors[i]
            if sensor.active or self.sampler.noisy[i]:
                continue
            # From the start on, or since; as where they are found.
            later = priors.OCCURRENCE['slip'] * HORIZON / 3600.0
            prior = priors.FAULT_AT_START if self.parts.known[i] < HORIZON else later
            odds = self.bank.offset_against_contact(i) + math.log(prior)
            # Torques from outside that were the cause remain it when their onset, which told them
            # from an offset, has left the horizon.
            leans = now - self._contact.leant < HORIZON
            if not suspected[i] and (leans or odds < self._sure):
                continue
            if leans or odds < -self._sure:
                self._contact.leant, odds = now, -math.inf
            if odds < self._sure:
                label = f'{self.arm.sensor_names[i]}:bias'
                self.suspects = tuple(dict.fromkeys((*self.suspects, label, priors.CONTACT)))
                continue
            sensor.level = True
            fault = float(self.faults()[0][i])
            if guaranteed[i]:
                # Sets bound what a healthy arm shows, not how fast an offset is found.
                self._raise(i, 'bias', now, fault, guaranteed=True)
                continue
            self._evaluate_guarantee()
            sensor.unproved = self.guarantee is None or not self.guarantee.exceeded[i]
            share = 1.0 / (1.0 + math.exp(-odds))
            self._raise(i, 'bias', 0.0, fault, guaranteed=not sensor.unproved, confidence=share)
        self._mark_suspects()
        return Stage.END

    def _is_held(self) -> bool:
        """Whether brakes may hold the arm: nothing has moved, and efforts are friction at most.

        Drives that are off report none, or noise.
        """
        one, n = self.estimator, self.joints
        if one.window.rested.min() < len(one):
            return False
        efforts = np.abs(self.readings.all_blocks()[:, 2 * n : 3 * n]).mean(0)
        friction = one.balance.chain.friction[:, COULOMB]
        return bool((efforts <= friction + priors.MODEL_ERROR * one.typical).all())

    @property
    def _sure(self) -> float:
        """Log Bayes factor by which a cause is named against another one."""
        return -math.log(self.settings.probability_of_wrong_name)

    def _has_alarm(self) -> bool:
        """Whether an alarm is up."""
        return any(one.active for one in self.sensors) or any(one.active for one in self.rates)

    def _end_faults(self, now: float) -> Stage:
        """Faults that are over are cleared once they have been over for long enough."""
        sigma, level, sigmas = self.faults()[1], self.estimator.level, self.settings.sigmas
        clears, dwell = not self.settings.latch, self.settings.clear_dwell
        contradicts = self.contradicts
        for i in self.followed.known:
            self.sensors[i].wrong_until = now
        for i, sensor in enumerate(self.sensors):
            if not sensor.active:
                continue
            # Gravity's word counts where it was confirmed, or is sure beside the fault.
            counts = sensor.level or sigmas * level.sigma[i] < sensor.peak
            left = self.followed.largest(i) + float(counts * level.mean[i])
            if sensor.kind == 'noise':
                over = self.sampler.noisy[i] == 0
            elif sensor.kind == 'stuck':
                moves = self.readings.rested(i) < STILL_TIME
                # For long enough for a jump to have been seen.
                moved_on = sensor.over_since is not None and self.sampler.state['pending'][0] < 0
                if moves and moved_on and i in self.followed.filters:
                    self._lose_count(i)
                over = moves or (i not in self.followed.filters and self._rests(i))
            else:
                smallest = self.settings.minimum_threshold * self.scales[i]
                limit = MOST * max(smallest, sigmas * sigma[i])
                over = abs(left) < min(LEFT * sensor.peak, limit)
            over &= not contradicts
            sensor.unseen &= over or not self._shows(i)
            if sensor.watch_end(over, now, dwell, abs(left)) and clears:
                before = float(self.followed.taken_out()[i])
                if sensor.kind == 'noise' and not self._is_small(i, before):
                    self._remains(i, before, now)
                    self.followed.trust_rate(i)
                    continue
                self._forget(i)
                self._event(i, sensor.kind, sensor.onset, AlarmEvent.CLEARED, left, float(sigma[i]))
                sensor.clear()
        for i, record in enumerate(self.rates):
            if not record.active:
                continue
            if record.watch_end(self._rate_agrees(i, now), now, dwell, 0.0) and clears:
                error = float(self.sampler.rate_error[i])
                since = now - dwell - self.bank.kinematics.agrees(i, error)
                correct_rates_since(i, since, -error, self.readings)
                self.sampler.rate_error[i] = self.sampler.contrast['replaced'][i] = 0.0
                # When exactly the rate was right again is not known.
                self.bank.restart_statistic()
                self._event(i, record.kind, record.onset, AlarmEvent.CLEARED, 0.0, 0.0)
                record.clear()
                self.followed.trust_rate(i)
        return Stage.RATES

    def _judge_rates(self, now: float) -> Stage:
        """Whether rates that the file calls independent are derived from their readings."""
        derived = self._rate_sources.judge(self.sampler, bool(self._state['usual']))
        if derived:
            self._derive_rates(derived, now)
        return Stage.DONE

    def _derive_rates(self, joints: list[int], now: float) -> None:
        """Rates are derived, whatever the file says: the arm is another one from now on."""
        changed = list(self.arm.joints)
        for i in joints:
            changed[i] = replace(changed[i], sensors=replace(changed[i].sensors, rates='derived'))
        self.arm = replace(self.arm, joints=tuple(changed))
        self.misnamed += tuple(self.arm.joint_names[i] for i in joints)
        self._certify_nothing()
        SerialMonitor.reset(self)  # what answers samples goes on
        self._state['now'] = now

    def _rests(self, i: int) -> bool:
        """Whether the joint of a reading that rests does so, too, as balances say."""
        gains = [one.gain for one in self._stuck if one.joint == i]
        return bool(gains) and max(gains) < 0.0

    def _shows(self, i: int) -> bool:
        """Whether a fault of sensor i would be seen to be over, if it were."""
        sensor = self.sensors[i]
        largest = max(sensor.peak, self.settings.minimum_threshold * float(self.scales[i]))
        bound = self.settings.sigmas * self.estimator.level.sigma[i]
        return sensor.kind in {'noise', 'stuck'} or bool(bound < largest)

    def _lose_count(self, i: int) -> None:
        """A frozen reading moves on without a jump: its joint may be where it was lost.

        What an absolute encoder reads is right again, an incremental one has not counted the way.
        """
        one, reading = self.followed.filters[i], float(self.sampler.raw[i])
        fault, sigma = one.fault(reading, self.readings.last())
        self._release(i, DELAY)
        self.estimator.doubt_readings(i, math.hypot(fault, sigma))

    def _release(self, i: int, since: int, kept: float = 0.0) -> None:
        """The readings of sensor i are right again, for so many samples, but for an offset."""
        sigma = float(self.faults()[1][i])
        self._jumps.forget(i)
        self.followed.release(i, since, sigma, kept)

    def _forget(self, i: int) -> None:
        """Take nothing out of the readings of sensor i any more; what is estimated stays true."""
        self._jumps.forget(i)
        self.followed.forget(i)

    def _suspect_nothing(self) -> None:
        """What was suspected is known, or over."""
        self.suspects = ()
        self._suspected[:] = 0.0

    def _see_nothing_wrong(self) -> None:
        """There is no contradiction that wants a cause."""
        self._suspect_nothing()
        self._contact.begin = self._contact.since = math.inf
        self._rival = -math.inf

    def _mark_suspects(self) -> None:
        """Sensors whose fault may explain a contradiction."""
        for labels, sensor in zip(self._labels, self.sensors):
            sensor.suspect(not labels.isdisjoint(self.suspects))

    def _renew_guarantee(self, _: float) -> Stage:
        self._evaluate_guarantee()
        exceeded = self.guarantee is not None and self.guarantee.exceeded.any()
        self._state['exceeds'], self._state['rests'] = exceeded, False
        return Stage.REST

    def _lose_guarantee(self) -> None:
        """The horizon holds what no healthy arm does, or readings that were changed."""
        self.guarantee, state = None, self._state
        state['lost'], state['sound'] = state['balances'], False

    def _evaluate_guarantee(self) -> None:
        """Guaranteed thresholds now; statistical alarms of offsets beyond them are confirmed."""
        healthy = self.healthy
        if healthy is None:
            return
        self.guarantee = healthy.evaluate()
        for i, sensor in enumerate(self.sensors):
            if sensor.active and sensor.unproved and self.guarantee.exceeded[i]:
                size = float(self.guarantee.estimate[i])
                sensor.unproved = False
                self._raise(i, 'bias', sensor.onset, size, guaranteed=True)
