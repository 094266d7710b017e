"""Observers and diagnosis of an arm together: what the observer node and a replay run.

`lpv.core.serial_arm.diagnosis` finds faults in samples that are in order.  What is here decides
which measurements are, and turns what was found into messages.  The node takes measurements one by
one, a replay many at a time; both go through `SerialSensorMonitor.take_many`, and the answers do
not depend on how measurements are divided.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np

from lpv.core.control.watchdog import LONGEST_UNUSABLE
from lpv.core.monitoring.alarm_text import (
    UNUSED,
    SampleCounters,
    count_texts,
    other_unit,
    unusable_text,
)
from lpv.core.monitoring.answers import Answer, Answers, answer_type
from lpv.core.monitoring.compensation import AnswerRows
from lpv.core.monitoring.idle_efforts import IdleSignal
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.monitoring.message_fields import Report
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.plausibility import (
    Driver,
    Stream,
    count_regular,
    find_unread,
    is_plausible,
    new_repeats,
)
from lpv.core.monitoring.sample_loop import Answering
from lpv.core.monitoring.stamp_gate import StampGate
from lpv.core.monitoring.stepped_monitor import SteppedMonitor
from lpv.core.serial_arm.chain import BoolArray, FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, Mode, SensorState
from lpv.core.serial_arm.diagnosis.decision import decide
from lpv.core.serial_arm.diagnosis.healthy_set import Guarantee
from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.monitor import LONGEST_STEP
from lpv.core.serial_arm.diagnosis.sampler import LATE
from lpv.core.serial_arm.sensor_map import map_rows, mixing
from lpv.core.serial_arm.turns import Turns
from lpv.core.support.errors import SampleError
from lpv.core.support.jit import Entries, compile_ahead
from lpv.core.support.limits import LARGEST, MAX_GAP, PATIENCE, SMALL, STALE_AFTER
from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS, NEVER
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.unknown_input_observer import CHOICES, UnknownInputObserver, uio_answers

METHOD = 'moving horizon'
_REPORT_INTERVAL = NANOSECONDS
"""A diagnostics report is due after each such time of the data [ns], and at every alarm event."""
_STALE_AFTER, _REPEATED_AFTER = round(STALE_AFTER * NANOSECONDS), round(PATIENCE * NANOSECONDS)
"""Time without use until it is reported, and until it is reported again [ns]."""
_MANY = 0.1
"""Share of measurements that cannot be used from which on it is said."""
_WARM_UP = 0.3
"""Motion that makes every compiled function run that samples of no fault need [s]."""
CONTACT = 'torques from outside: something pushes or holds the arm, or its load has changed'
_JUMPS_ALONE = 'jumps of readings are found, offsets and drifts are not diagnosable'
MISFIT = (
    'motion and efforts do not fit the arm file, whatever sensor is blamed; unless brakes held it '
    'for long, lpv doctor (or lpv identify --calibrate, from a recording) names the likely cause: '
    'load, mounting, units, signs, names or delays'
)
_MISNAMED = (
    'rates of {} are derived from the readings, and are taken for such; the arm file calls them '
    'independent'
)
_TOO_RARE = f'measurements are more than ten sample times of the arm file apart: {_JUMPS_ALONE}'
_LOST = (
    'measurements are lost, or come too rarely; more than ten sample times passed {} times within '
    'a second'
)
_UNUSED = 'many measurements cannot be used; of {} within a second: {}'
_PERIOD = (
    'measurements come at another rate than the arm file says; one in {:.3g} s, sample_time is '
    '{:.3g} s: correct it, bounds depend on it'
)
_SURE = 3
"""Reports in a row until that is said: samples that are lost, or come unevenly, are no rate."""
_UNITS = 'readings are in another unit, or of another arm; {}'
_NO_EFFORT = f'no efforts: {_JUMPS_ALONE}'
_SOME_EFFORTS = 'no efforts of {}: offsets and drifts show in those of other joints alone'
_NO_WEIGHT = f'efforts leave out the weight: {_JUMPS_ALONE}'


class SerialSensorMonitor:
    """Diagnosis of the position sensors of an arm.

    The horizon and the bank of hypotheses watch every arm.  Where gains were designed, the
    unknown-input observer runs beside them, sample by sample: the estimate with the smaller bound
    is published, and what its reachable set excludes is a certified alarm.

    Degraded modes: without rates, those of sensors that have none of their own are differences of
    the readings; without efforts, jumps are found and offsets are NOT_DIAGNOSABLE; without those of
    some joints, those of others go on; a sample with other values that are not finite is answered
    with the last estimate, marked STALE.

    Parameters
    ----------
    name : str
        Name in diagnostics: the node's fully qualified name.
    arm : SerialArm
        The arm.
    parameters : DiagnosisParameters, optional
        Tuning.
    gains : Gains, optional
        Of a planar arm with designed gains.
    observer : {'tightest', 'uio', 'horizon'}, optional
        Whose estimate of the faults is published, where gains are given.
    initial_samples : int, optional
        Samples over which the designed observer's start value is averaged.
    max_gap : float, optional
        Longest interval that the designed observer integrates [s].

    Attributes
    ----------
    rejected : int
        Messages that did not fit the arm.
    counters : SampleCounters
        Samples that were not usable as they came.
    method : str
        How faults are found.

    Raises
    ------
    ConfigError
        If the arm cannot be monitored.
    """

    def __init__(
        self,
        name: str,
        arm: SerialArm,
        parameters: DiagnosisParameters | None = None,
        gains: Gains | None = None,
        observer: str = CHOICES[0],
        initial_samples: int = 1,
        max_gap: float = MAX_GAP,
    ) -> None:
        self.name, self.arm, self.rejected, self.method = name, arm, 0, METHOD
        self.counters = SampleCounters()
        self._joints = len(arm.joints)
        self.answer_type = answer_type(self._joints)
        self._call = Entries()
        self._one = Answers(self.answer_type, 1)  # of `take`
        self._order = JointOrder(arm.joint_names)
        rates = [joint.sensors.rates for joint in arm.joints]
        self._independent = arm.sensors().independent
        self._to_sensors, self._to_joints = mixing(arm.joints_to_sensors()), arm.sensors_to_joints()
        self._without_rates = np.array([rate == 'none' for rate in rates])
        self._torque_gain = np.array(arm.torque_gain)
        endless = np.array([joint.is_endless for joint in arm.joints])
        self._endless = np.abs(arm.joints_to_sensors()) @ endless > 0.0
        self._gains = gains
        uio: UnknownInputObserver | None = None
        if gains is not None:
            uio = UnknownInputObserver(
                arm, gains, observer, initial_samples=initial_samples, max_gap=max_gap
            )
            self.method = f'{METHOD}, unknown-input observer ({uio.method})'
        self._monitor = SteppedMonitor(arm, parameters, uio)
        self._gap = round(LONGEST_STEP * arm.sample_time * NANOSECONDS)
        self._turns = Turns(arm)
        self._read = Driver(np.full(self._joints, np.nan), np.zeros(1, np.int64))
        self._small = SMALL * arm.scales()
        self._efforts = IdleSignal(self._small, self._monitor.plan.per_interval)
        self._rates = IdleSignal(self._small, given=bool(self._independent.any()))
        self._patience = NEVER  # since the last use; when it ends [ns]
        self._begin()

    @property
    def log_statistic(self) -> float | None:
        """Logarithm of the statistic of detection at the last decision, if there was one."""
        return self._monitor.statistic if self.decisions else None

    @property
    def decisions(self) -> int:
        """Decisions so far."""
        return self._monitor.balances

    def guarantee(self) -> Guarantee | None:
        """Guaranteed thresholds of the offsets now; None where nothing is guaranteed."""
        monitor = self._monitor
        if monitor.healthy is None or len(monitor.estimator) == 0:
            return None
        return monitor.healthy.evaluate()

    def restart_statistic(self) -> None:
        """Let causes begin from now on only; what was learned stays."""
        self._monitor.bank.restart_statistic()

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running; alarms stay as they are."""
        self._monitor.retune(parameters)

    def reset(self) -> None:
        """Forget estimates and alarms; counters stay."""
        self._read.position[:] = np.nan
        self._turns = Turns(self.arm)
        self._start_again()

    def _start_again(self) -> None:
        """Forget estimates and alarms, but not what the driver has read."""
        self._monitor.reset()
        self._begin()

    def _begin(self) -> None:
        """Estimates and alarms of a monitor that has just been reset."""
        self._gate = StampGate()
        self._stamp = NEVER  # of the last usable sample [ns]
        self._counted = 0  # rows of the samples at hand
        self._reading = np.zeros(self._joints)  # of that sample [rad]
        self._repeats = new_repeats(self._joints)
        self._older = 0  # measurements in a row that were older than the last one
        self._gaps_before = self.counters.gaps
        self._used = 0  # samples that were
        self._before = NEVER, 0, 0, replace(self.counters)  # as of `_note_losses`, one time before
        self._losses = ''
        self._other_period = 0  # reports in a row
        # The shortest and the longest time between samples since the last one [ns].
        self._steps, self._stepped = (LAST_STAMP, 0), NEVER
        self._missing_since = np.full(self._joints, NEVER)  # readings, stamps [ns]
        self._is_missing = False
        self._dropped = np.zeros(self._joints, bool)  # sensors whose dropout has been reported
        self._newest = np.zeros(1, self.answer_type)  # row with the last estimate
        self._warned: set[str] = set()

    def warm_up(self) -> None:
        """Compile with a made-up motion, and forget it: the first real samples must not wait."""
        other = self._unused()
        step = round(self.arm.sample_time * NANOSECONDS)
        stamps = 1 + step * np.arange(max(20, round(_WARM_UP / self.arm.sample_time)))
        t = (stamps / NANOSECONDS)[:, None] + np.arange(self._joints)
        other.take_many(stamps, np.sin(t), np.cos(t), np.ones_like(t))
        other._monitor.estimator.linearise(other._monitor.readings.blocks(2))  # noqa: SLF001

    def warm_up_faults(self) -> None:
        """Compile what only a suspected fault needs."""
        self._unused()._monitor.warm_up()  # noqa: SLF001

    def compile_ahead(self) -> None:
        """Compile decisions, what faults need and the designed observer, beside `warm_up`."""
        one, rows = self._monitor.answering, self._one.rows
        compile_ahead(decide, self._monitor.parts)
        self.warm_up_faults()
        samples, stamps = np.zeros((1, 3, self._joints)), np.zeros(1, np.int64)
        compile_ahead(uio_answers, one.uio, rows, 0, (0, 0), stamps, samples)

    def _unused(self) -> 'SerialSensorMonitor':
        """Another monitor like this one, as new."""
        return SerialSensorMonitor(self.name, self.arm, self._monitor.settings, self._gains)

    def take(
        self, stamp: int, message: Any, torque: Sequence[float] | None = None
    ) -> Answer | None:
        """Use one measurement; None for an old stamp, which needs no answer.

        Parameters
        ----------
        stamp : int
            Its time [ns].
        message : sensor_msgs/JointState
            The measurement; any object with its fields.
        torque : sequence of float, optional
            Torques in place of the message's effort [N m].

        Raises
        ------
        SampleError
            If the message does not fit the arm; it is counted.
        """
        try:
            measured = np.array(self._order.pick(message, torque), dtype=float)
        except SampleError:
            self.rejected += 1
            raise
        if torque is not None:
            measured[2] /= self._torque_gain  # in the unit of efforts, as all that is taken
        one = self._one
        one.bytes.fill(0)
        one.stamps[0] = stamp
        for found in (one.events, one.due, one.warnings):
            found.clear()
        self._take(one, *measured[:, None])
        if not one.rows.answered[0]:
            return None
        return Answer(
            stamp,
            one.record(0)[0],
            one.due[0][1].statuses() if one.due else None,
            [event for _, event in one.events],
            [text for _, text in one.warnings],
        )

    def take_many(
        self,
        stamps: IntArray,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        arrived: IntArray | None = None,
    ) -> Answers:
        """Use many measurements; the same as `take` one by one.

        Parameters
        ----------
        stamps : ndarray of int64, shape (m,)
            [ns].
        position, velocity, effort : ndarray, shape (m, n)
            Of the joints, in the order of the arm file; NaN where missing [rad], [rad/s], [unit].
        arrived : ndarray of int64, shape (m,), optional
            Times at which they came [ns]; where none could be used for a while, it is reported as
            by a node that hears them then.

        Returns
        -------
        Answers
            One row a measurement.
        """
        answers = Answers(self.answer_type, len(stamps))
        answers.stamps[:] = stamps
        self._take(answers, position, velocity, effort, arrived)
        return answers

    def _take(
        self,
        answers: Answers,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        arrived: IntArray | None = None,
    ) -> None:
        """Use measurements, whose stamps are there."""
        stamps, samples = answers.stamps, answers.samples
        samples[:, 0], samples[:, 1] = position, velocity
        samples[:, 2] = np.where(np.abs(effort) <= LARGEST, effort, np.nan)  # others are none
        unread = np.empty(len(stamps), bool)
        self._call(find_unread, stamps, samples, self._small, self._read, unread)
        position, velocity = self._turns.continued(stamps, samples[:, 0], samples[:, 1])
        self._rates.leave_out(position, velocity)
        idle = self._efforts.leave_out(position, samples[:, 2])
        samples[:, 0], samples[:, 1] = position, velocity
        samples[:, :2] = map_rows(self._to_sensors, samples[:, :2])
        begin = 0
        while begin < len(stamps):
            if begin == idle:
                self._start_again()  # what was learned from them is wrong
            regular = self._regular(answers, begin)
            if begin < idle:
                regular = min(regular, idle - begin)
            if not regular:
                row = answers.plain[begin : begin + 1]
                if not self._is_of_stream(int(stamps[begin]), row):
                    self._report_silence(arrived, begin, answers)
                    begin += 1
                    continue
                usable = self._prepare(int(stamps[begin]), samples[begin], unread[begin], row)
            if (self._is_missing or not regular) and not unread[begin]:
                self._watch_dropouts(answers, begin)
            end = begin + max(1, regular)
            if regular or usable:
                self._run(answers, begin, end)
                self._patience = NEVER
            elif answers.rows.answered[begin] and self._is_due(int(stamps[begin])):
                self._report(answers, begin)
            else:
                self._report_silence(arrived, begin, answers)
            begin = end

    def _report_silence(self, arrived: IntArray | None, row: int, answers: Answers) -> None:
        """Report that no measurement could be used for a while, if it is known when they came."""
        if arrived is None:
            return
        now = int(arrived[row])
        if self._patience == NEVER:
            self._patience = now + _STALE_AFTER
        elif now > self._patience:
            self._patience = now + _REPEATED_AFTER
            note = unusable_text(self.counters)
            answers.due.append((row, self._report_of(Mode.STALE, note)))

    def _regular(self, answers: Answers, begin: int) -> int:
        """Number of samples from ``begin`` on that can be used as they are, after the last one."""
        if self._gate.last is None or self._is_set_back():
            return 0
        stream = Stream(
            self._stamp, self._gate.last, self._gap, self._independent, self._endless,
            self._reading, self._repeats,
        )  # fmt: skip
        return int(self._call(count_regular, stream, answers.stamps, answers.samples, begin))

    def _lacks_rates(self, rates: FloatArray) -> np.ndarray:
        """Which rates, shape (..., n), have to be made of the readings."""
        return ~np.isfinite(rates) | self._without_rates

    def _is_of_stream(self, stamp: int, row: np.ndarray) -> bool:
        """Whether a stamp is of the stream, which goes on where it was if its clock was set.

        ``row`` receives the answer to one that is not.
        """
        if not self._gate.accept(stamp):
            self.counters.refused_stamps += 1
            self._answer_stale(stamp, row)
            return False
        if self._gate.shift:
            self.counters.restarts += 1
            row['restarted'] = True
            self._set_clock(self._gate.shift - 2 * self._gap)
        return True

    def _set_clock(self, shift: int) -> None:
        """Move all stamps to a clock that is ahead by ``shift`` [ns]; faults may have ended."""
        for moments in (self._missing_since, self._monitor.answering.work.stamp):
            moments[moments != NEVER] += shift
        self._monitor.progress['next_report'] = NEVER
        if self._stamp == NEVER:
            return
        self._before = (NEVER, *self._before[1:])
        self._stamp += shift
        self._monitor.doubt(shift, self._stamp)

    def _prepare(self, stamp: int, sample: FloatArray, unread: np.bool_, row: np.ndarray) -> bool:
        """Get ready for a sample that does not simply follow; False if it is used up so.

        ``row`` receives the answer in this case.
        """
        if not self._is_new(stamp):
            return False
        wrong = ''
        if self._repeats.own['stalled'][0]:
            wrong = 'repeated'
        elif unread:
            wrong = 'unread'
        elif not is_plausible(sample, self._independent, self._endless, self._reading):
            needed = np.concatenate([sample[0], sample[1, self._independent]])
            wrong = 'implausible' if np.isfinite(needed).all() else 'not_finite'
        if wrong:
            setattr(self.counters, wrong, getattr(self.counters, wrong) + 1)
            self._answer_stale(stamp, row)
            return False
        was_back = self._is_set_back()  # and samples are missing since
        if was_back:
            self._monitor.begin_again()
        gap = self._stamp == NEVER or stamp - self._stamp > self._gap or was_back
        self.counters.gaps += self._stamp != NEVER and gap
        if gap and self._lacks_rates(sample[1]).any():
            # The first difference needs two readings.
            self._monitor.begin_again()
            self._answer_stale(stamp, row)
            self._stamp, self._reading = stamp, sample[0].copy()
            return False
        return True

    def _watch_dropouts(self, answers: Answers, row: int) -> None:
        """Report sensors whose readings are missing, or are there again."""
        stamp, missing = int(answers.stamps[row]), ~np.isfinite(answers.samples[row, 0])
        if not missing.any() and not self._is_missing:
            return
        self._missing_since[missing & (self._missing_since == NEVER)] = stamp
        self._monitor.unread |= missing
        long = missing & (stamp - self._missing_since > LONGEST_UNUSABLE)
        events = self._dropouts(long, stamp)
        answers.events += [(row, event) for event in events]
        self._missing_since[~missing] = NEVER
        self._is_missing = bool(missing.any())
        if events:
            self._monitor.progress['next_report'] = NEVER

    def _dropouts(self, long: BoolArray, stamp: int) -> list[Alarm]:
        """Events of sensors that have failed to deliver for ``long``, or deliver again.

        The end of a dropout does not clear another fault of the sensor.
        """
        events = []
        for i in np.flatnonzero(long != self._dropped).tolist():
            other, is_over = self._monitor.sensors[i].active, not long[i]
            if not (is_over and other):
                begun = AlarmEvent.UPDATED if other else AlarmEvent.RAISED
                event, since = AlarmEvent.CLEARED if is_over else begun, int(self._missing_since[i])
                name = self.arm.sensor_names[i]
                events.append(Alarm(event, i, name, since, stamp, 0.0, 0.0, 'dropout', 1.0))
        self._dropped = long
        return events

    def _is_new(self, stamp: int) -> bool:
        """Whether a stamp is later than that of the last sample."""
        delta = stamp - self._stamp
        if self._stamp == NEVER or delta > 0:
            return True
        self.counters.duplicates += delta == 0
        self.counters.out_of_order += delta < 0
        self._older += delta < 0
        return False

    def _is_set_back(self) -> bool:
        """Whether the clock was, by what is older than the last measurement, one after another.

        One may be late, and as many as were missing before the last one, unless all began anew.
        """
        if self._older <= 1:
            return False
        time = self._monitor.sampler.time
        period = (time[-1] - time[-2]) / self.arm.sample_time
        return period > LONGEST_STEP or self._older > round(period) - 1

    def _run(self, answers: Answers, begin: int, end: int) -> None:
        """Use samples that are in order."""
        stamps, samples = answers.stamps[begin:end], answers.samples[begin:end]
        self._add_rates(stamps, samples)
        if self._stamp == NEVER:
            self._monitor.watch_from(int(stamps[0]))
        self._stamp, self._reading = int(stamps[-1]), samples[-1, 0].copy()
        self._gate.follow(self._stamp)
        self._older, self._counted = 0, begin
        self._lacks_efforts = bool(np.isnan(samples[:, 2]).any())
        for first, until, stamp in self._monitor.run(stamps, samples, answers.rows, begin):
            if stamp is None:
                self._report_due(answers, first, until)
            else:
                events = self._note(stamp)
                answers.events += [(first, event) for event in events]
                if events:
                    self._monitor.progress['next_report'] = NEVER
        self._count_used(answers, end)
        self._newest = answers.record(end - 1)

    @property
    def parts(self) -> tuple[SteppedMonitor, Answering]:
        """What loops call `advance` with, until `go_on`."""
        return self._monitor, self._monitor.answering

    def go_on(self, answering: Answering, rows: AnswerRows, row: int, *taken: Any) -> list[Alarm]:
        """As `SteppedMonitor.go_on`, for those who call `advance` with `parts`; alarm events."""
        known = self._monitor.go_on(answering, rows, row, *taken)
        return [event for *_, stamp in known if stamp is not None for event in self._note(stamp)]

    @property
    def _last(self) -> np.recarray:
        """Row with the last estimate."""
        return self._newest.view(np.recarray)

    @property
    def last_used(self) -> int:
        """Stamp of the last sample that was usable [ns]."""
        return self._stamp

    def went_on(self, stamp: int, reading: FloatArray, record: np.ndarray) -> None:
        """Samples up to this one were taken with `parts`; ``record`` is its answer, of one row."""
        if stamp <= self._stamp:
            return  # the gate has seen later stamps, of samples without use
        self._stamp, self._reading, self._newest = stamp, reading.copy(), record.copy()
        self._read.stamp[0], self._read.position[:] = stamp, self._to_joints @ reading
        self._turns.went_on(stamp, self._read.position)
        self._gate.follow(stamp)
        self._monitor.went_on(stamp)

    def _note(self, stamp: int) -> list[Alarm]:
        """Take note of what has been decided at a sample [ns]; its alarm events."""
        monitor = self._monitor
        monitor.know(stamp)
        found, monitor.alarms = monitor.alarms, []
        return [replace(alarm, detected=stamp) for alarm in found if alarm.sensor]

    def _add_rates(self, stamps: IntArray, samples: FloatArray) -> None:
        """Rates that are missing are differences of the readings."""
        missing = self._lacks_rates(samples[:, 1])
        if missing.any():
            before = np.concatenate([self._reading[None], samples[:-1, 0]])
            interval = np.diff(stamps, prepend=self._stamp) / NANOSECONDS
            rates = (samples[:, 0] - before) / interval[:, None]
            samples[:, 1] = np.where(missing, rates, samples[:, 1])

    def _answer_stale(self, stamp: int, row: np.ndarray) -> None:
        """Answer an unusable sample with the last estimate; never with silence."""
        restarted = bool(row['restarted'][0])
        row[:] = self._newest
        row['restarted'], row['answered'] = restarted, True
        state, has_fault = row['state'], bool(row['has_fault'][0])
        state['mode'] = int(Mode.STALE if has_fault else Mode.NO_ESTIMATE)
        row['fault']['state'] = int(SensorState.STALE)
        if not has_fault or abs(stamp - self._stamp) > LONGEST_UNUSABLE:
            state['trustworthy'] = False

    def _is_due(self, stamp: int) -> bool:
        return bool(stamp >= self._monitor.progress['next_report'])

    def _count_used(self, answers: Answers, until: int) -> None:
        """Time and count measurements that were used up to a row, and those without all efforts."""
        self._used += until - self._counted
        if self._lacks_efforts:
            missing = np.isnan(answers.samples[self._counted : until, 2])
            self.counters.without_effort += int(missing.any(axis=1).sum())
        self._note_steps(answers.stamps[self._counted : until])
        self._counted = until

    def _note_steps(self, stamps: IntArray) -> None:
        """Note the shortest and the longest time between samples that were used."""
        if len(stamps) == 0:
            return
        steps = [int(stamps[0]) - self._stepped] if self._stepped != NEVER else []
        if len(stamps) > 1:
            between = np.diff(stamps)
            steps += [int(between.min()), int(between.max())]
        self._stepped = int(stamps[-1])
        shortest, longest = self._steps
        self._steps = min([shortest, *steps]), max([longest, *steps])

    def _report_due(self, answers: Answers, first: int, until: int) -> None:
        """Diagnostics reports of samples between two decisions."""
        while first < until and self._is_due(int(answers.stamps[until - 1])):
            due = self._monitor.progress['next_report']
            first += int(answers.stamps[first:until].searchsorted(due))
            if first < until:
                self._count_used(answers, first + 1)
                self._report(answers, first)

    def _note_losses(self, stamp: int) -> None:
        """Note what was lost up to a stamp [ns], once a second has passed since the last time."""
        since, used, balances, counted = self._before
        if since != NEVER and stamp - since < _REPORT_INTERVAL:
            return
        is_new = self.counters != counted
        kept = replace(self.counters) if is_new else counted
        self._before = stamp, self._used, self.decisions, kept
        if since == NEVER:
            return
        self._losses = ''
        if not is_new:
            return
        new = {name: count - getattr(counted, name) for name, count in vars(self.counters).items()}
        unused = SampleCounters(**{name: new[name] for name in UNUSED})
        total = sum(vars(unused).values())
        due = (stamp - since) / NANOSECONDS / self._monitor.plan.interval
        if total > _MANY * (total + self._used - used):
            texts = '; '.join(count_texts(unused))
            self._losses = _UNUSED.format(total + self._used - used, texts)
        # A gap takes decisions for two intervals more than it lasts.
        if new['gaps'] and self.decisions - balances < 0.5 * due:
            self._losses = _LOST.format(new['gaps'])

    def _report(self, answers: Answers, row: int) -> None:
        stamp = int(answers.stamps[row])
        self._monitor.progress['next_report'] = stamp + _REPORT_INTERVAL
        self._note_losses(stamp)
        answer = answers.plain[row]
        state, fault = answer['state'], answer['fault'] if answer['has_fault'] else None
        note, other = self._remark(state), self._period_text()
        notes = [text for text in (note, other if note != _TOO_RARE else '') if text]
        said = notes[:1] if int(state['mode']) < Mode.STALE else [unusable_text(self.counters)]
        answers.due.append((row, self._make_report(state, fault, *(said or ['']))))
        for note in notes:
            subject = note.partition(';')[0]
            if subject not in self._warned:  # whatever its details
                answers.warnings.append((row, note))
            self._warned.add(subject)

    def _period_text(self) -> str:
        """That samples come more or less often than the arm file says; empty if they do not."""
        stated = self.arm.sample_time
        shortest, longest = (step / NANOSECONDS for step in self._steps)
        self._steps = LAST_STAMP, 0
        is_other = shortest > LATE * stated or longest < stated / LATE
        is_other &= longest > 0.0 and not self._losses
        self._other_period = self._other_period + 1 if is_other else 0
        return _PERIOD.format(shortest, stated) if self._other_period >= _SURE else ''

    def stale_fault(self) -> np.record | None:
        """The last ``fault`` of an answer, if there is one, marked as such."""
        if not self._last.has_fault[0]:
            return None
        last = self._last.copy()
        last.fault.state = SensorState.STALE
        return last.fault[0]

    def status(self, mode: Mode, note: str | None = None) -> list[dict[str, Any]]:
        """Statuses for /diagnostics; of the last answer, with a mode and, if given, a note."""
        return self._report_of(mode, note).statuses()

    def _report_of(self, mode: Mode, note: str | None) -> Report:
        """Report of the last answer, with a mode and, if given, a note."""
        last = self._last.copy()
        last.state.mode = mode
        if mode == Mode.STALE:
            last.fault.state = SensorState.STALE
        state, fault = last.state[0], last.fault[0] if last.has_fault[0] else None
        if note is None:
            note = self._remark(state) if mode < Mode.STALE else unusable_text(self.counters)
        return self._make_report(state, fault, note)

    def _make_report(self, state: np.void, fault: np.void | None, note: str) -> Report:
        monitor = self._monitor
        return Report(
            self.name, self.arm, state, fault, note, dict(vars(self.counters)), self.rejected,
            self.method, monitor.settings.sigmas, monitor.settings.safe_stop_bound,
            monitor.healthy is not None, monitor.guarantee,
        )  # fmt: skip

    def _remark(self, state: np.void) -> str:
        """What else is to be said of the diagnosis as a whole, with an answer's ``state``."""
        monitor = self._monitor
        position = state['compensated_position'].tolist()
        if text := other_unit(self.arm, position, position):
            return _UNITS.format(text)
        missing = monitor.missing_efforts.tolist()
        if all(missing) and not monitor.suspects:
            return _NO_EFFORT if self.arm.effort_includes_gravity else _NO_WEIGHT
        if not monitor.balances and self.counters.gaps - self._gaps_before > LONGEST_STEP:
            return _TOO_RARE
        if self._losses:
            return self._losses
        if monitor.in_contact:
            return CONTACT
        if monitor.suspects:
            return 'inconsistent; what explains it: ' + ', '.join(monitor.suspects)
        if any(missing):
            return _SOME_EFFORTS.format(', '.join(compress(self.arm.joint_names, missing)))
        if monitor.estimator.misfit() > ROBUST:
            return MISFIT
        wrong = ', '.join(monitor.misnamed)
        return _MISNAMED.format(wrong) if wrong else ''
