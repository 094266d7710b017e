"""The whole loop in one process, in the order in which the lockstep graph runs it.

Simulator, monitor and controller are the very functions that the nodes call.

What happens every sample is compiled, and the diagnosis decides every 50 ms; Python does what only
a suspicion needs, or a jump of a reading.  A sample that does not simply follow the one before (the
first one, one after a gap, with missing values, or after such) goes through the monitor's
`take_many`, as in the node.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpv.core.control.estimate_check import Correction, CorrectionLimit, limit_correction
from lpv.core.control.path_follower import PathFollower, approach_speeds
from lpv.core.control.tracking import BANDWIDTH, COMPENSATION, TrackingController
from lpv.core.control.tracking_law import LawParts, track
from lpv.core.control.watchdog import (
    BrakeReason,
    DriveWatchdog,
    DriveWatchdogParts,
    StopReason,
    TrackerLimits,
    TrackerWatchdog,
    TrackerWatchdogParts,
    check_drive,
    check_estimate,
    check_motion,
    latency_limits,
)
from lpv.core.monitoring.answers import answer_type
from lpv.core.monitoring.compensation import AnswerRows, answer_rows
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.sample_loop import PROGRESS, Answering, advance
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.monitoring.stepped_monitor import SteppedMonitor
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm
from lpv.core.serial_arm.diagnosis.decision import Parts
from lpv.core.serial_arm.diagnosis.monitor import LONGEST_STEP
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.simulation.arm_simulator import (
    ArmSimulator,
    PlantParts,
    PlantState,
    brake,
    integrate,
    read_sensors,
    refuse_failure,
    set_torque,
)
from lpv.core.simulation.scenario import Scenario
from lpv.core.simulation.transport import DIRECT, NO_COMMAND, NO_ESTIMATE, NO_MEASUREMENT, Transport
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import entry, pointer
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.limits import MOST_SAMPLES
from lpv.core.support.records import memory, new_record, plain, record_type
from lpv.core.support.timestamps import NANOSECONDS, NEVER
from lpv.core.uio.certificate.gains import Gains

# Where in a sample the loop goes on.  Outside, in Python: the monitor itself takes the sample, the
# diagnosis needs Python to decide, a path that starts or goes on needs references, the plant is
# integrated by an engine of its own.
_SENSE, _MONITOR, _TAKE, _DECIDE, _ESTIMATE, _START, _COMMAND, _ACT, _ADVANCE = range(9)
_NO_REPORT = np.iinfo(int).max
_NONE, _SILENCE = int(StopReason.NONE), int(StopReason.SILENCE)


_LOOP = record_type(
    ('phase', 'i8'),  # where in a sample the loop goes on
    ('external', '?'),  # whether the plant is integrated outside
    ('period', 'f8'),  # sample time [s]
    ('previous', 'i8'),  # sample of the last command, or NEVER
    ('started', '?'),  # whether a command was ever given
    ('offset', 'i8'),  # samples by which the path is late
    ('ran', '?'),  # whether the clock of the path ran at the sample
    ('stop', '?'),  # whether the last command is a safe stop
    ('reason', 'i8'),  # `StopReason` of the tracker
    ('usable', 'i8'),  # the last usable sample, or NEVER
    ('missing', '?'),  # values of the last sample were missing
    ('delay', 'i8'),  # samples between a command and its effect
    ('loss', 'f8'),  # probability that a measurement is lost
    ('answered', 'i8'),  # sample that the last command answers
    ('acting', 'i8'),  # sample of the command that acts, or NEVER
    ('literal', '?'),  # whether eq. (59) integrates the measurement
)


_ROW = record_type(
    ('time', 'f8'),
    ('lost', '?'),
    ('safe_stop', '?'),
    ('answered', 'i8'),  # sample that the command answers
    ('disturbance', 'f8'),
    ('place', 'i8'),
    ('stop_reason', 'u1'),
    ('brake_reason', 'u1'),
)


class _Signals(NamedTuple):
    """Signals of `Run` that the loop writes, one row per sample."""

    rows: np.recarray  # (m,) of `_ROW`
    position: FloatArray  # (m, n), as all that follow
    velocity: FloatArray
    measured: FloatArray
    measured_velocity: FloatArray
    effort: FloatArray
    reference: FloatArray
    fault: FloatArray
    torque: FloatArray
    command: FloatArray


class _Observer(NamedTuple):
    """`advance` and its arguments, for all samples of the run."""

    advance: Callable[..., bool]
    parts: Parts
    plan: tuple[int, int]
    stamps: IntArray
    times: FloatArray
    samples: FloatArray
    answering: Answering
    answers: AnswerRows
    feedback: FloatArray  # those positions of the answers that the loop is closed on
    losses: np.random.Generator  # of measurements


class _Tracker(NamedTuple):
    """Arguments of the tracking law; references of all samples; both watchdogs."""

    law: LawParts
    references: FloatArray
    correction: Correction
    watchdog: TrackerWatchdogParts
    drives: DriveWatchdogParts
    feedback: FloatArray  # (n,) position that the loop is closed on [rad]
    rate: FloatArray  # (n,) rates that the loop is closed on [rad/s]


@njit
def _run(
    shared: np.ndarray,
    plant: PlantParts,
    observer: _Observer,
    tracker: _Tracker,
    signals: _Signals,
    blocked: np.ndarray,
    first: int,
) -> int:
    """Go on from a sample until something is needed from outside.

    ``shared`` is the memory of the loop's record.
    """
    loop = shared[0]
    for k in range(first, len(blocked)):
        if loop.phase == _SENSE:
            _sense(loop, plant, observer, tracker, signals, blocked[k], k)
        if loop.phase == _MONITOR:
            return k
        if loop.phase == _TAKE:
            _take(loop, observer, k)
        if loop.phase == _DECIDE:
            return k
        if loop.phase == _ESTIMATE:
            _estimate(loop, observer, tracker, blocked[k], k)
        if loop.phase == _START:
            return k
        if loop.phase == _COMMAND:
            _command(loop, observer, tracker, k)
        _act(loop, plant, observer, tracker, signals, blocked[k], k)
        if loop.phase == _ADVANCE:
            return k + 1
    return len(blocked)


@njit
def _sense(
    loop: np.record,
    plant: PlantParts,
    observer: _Observer,
    tracker: _Tracker,
    signals: _Signals,
    blocked: int,
    k: int,
) -> None:
    """Read the sensors, and choose the way of the measurement unless it is lost."""
    row, state, sample = signals.rows[k], plant.state, observer.samples[k]
    loop.ran = False
    read_sensors(plant.constants, state, plant.faults, plant.noise, plant.chance)
    row.disturbance = state.own[0].disturbance
    map_vector(plant.constants.sensor, state.measured_position, sample[0])
    map_vector(plant.constants.sensor, state.measured_velocity, sample[1])
    missing = False
    for i in range(sample.shape[1]):
        signals.effort[k, i] = state.effort[i]
        sample[2, i] = state.effort[i] * plant.constants.effort_gain[i]
        if not (abs(sample[0, i]) < np.inf and abs(sample[1, i]) < np.inf):
            missing = True
    row.lost = loop.loss > 0.0 and observer.losses.random() < loop.loss
    row.lost = row.lost or blocked & NO_MEASUREMENT != 0
    waited = 0 if loop.previous == NEVER else observer.stamps[k] - observer.stamps[loop.previous]
    if waited > tracker.watchdog.own[0].silence:
        _stop(loop, tracker, _SILENCE)
    if row.lost:
        loop.phase = _ACT
        return
    follows = loop.usable != NEVER and k - loop.usable <= LONGEST_STEP
    loop.phase = _TAKE if follows and not (missing or loop.missing) else _MONITOR
    loop.missing = missing
    if loop.phase == _TAKE:
        loop.usable = k


@njit
def _take(loop: np.record, observer: _Observer, k: int) -> None:
    """Hand the sample to the diagnosis, which decides and answers as far as it needs no Python."""
    progress = observer.answering.progress[0]
    progress.taken = progress.answered = progress.reported = 0
    waits = observer.advance(
        observer.parts,
        observer.plan,
        observer.answering,
        observer.answers,
        k,
        observer.stamps[k : k + 1],
        observer.times[k : k + 1],
        observer.samples[k : k + 1],
    )
    loop.phase = _DECIDE if waits else _ESTIMATE


@njit
def _estimate(
    loop: np.record, observer: _Observer, tracker: _Tracker, blocked: int, k: int
) -> None:
    """Whether the tracker follows the answer."""
    if blocked & NO_ESTIMATE != 0:
        loop.phase = _ACT
        return
    answers = observer.answers
    for i in range(len(tracker.feedback)):
        tracker.feedback[i], tracker.rate[i] = observer.feedback[k, i], answers.velocity[k, i]
    reason = check_estimate(
        tracker.watchdog,
        observer.stamps[k],
        0,
        answers.mode[k],
        answers.trustworthy[k],
        tracker.rate,
        answers.measured_velocity[k],
    )
    loop.answered = k
    if reason != _NONE:
        _stop(loop, tracker, reason)
    else:
        loop.phase = _START if loop.previous == NEVER else _COMMAND


@njit
def _stop(loop: np.record, tracker: _Tracker, reason: int) -> None:
    loop.stop, loop.previous, loop.reason, loop.phase = True, NEVER, reason, _ACT
    tracker.law.integral[:] = 0.0
    tracker.law.torque[:] = 0.0
    tracker.correction.stamp[0] = NEVER
    tracker.watchdog.own[0].started = False  # the next reference is a start


@njit
def _command(loop: np.record, observer: _Observer, tracker: _Tracker, k: int) -> None:
    """Answer an estimate as the tracker node does."""
    now, loop.ran = observer.stamps[k], True
    reference = tracker.references[k - loop.offset]
    measured = observer.answers.measured[k]
    reason = check_motion(tracker.watchdog, now, reference[0], tracker.feedback, measured)
    if reason != _NONE:
        _stop(loop, tracker, reason)
        return
    limit_correction(tracker.correction, now, tracker.feedback, tracker.rate)
    feedback, rate = tracker.correction.feedback[0], tracker.correction.feedback[1]
    # Eq. (59) literally integrates the faulty measurement.
    integrated = measured if loop.literal else feedback
    interval = (now - observer.stamps[loop.previous]) / NANOSECONDS
    track(tracker.law, reference, feedback, rate, integrated, interval)
    loop.stop, loop.previous, loop.reason, loop.phase = False, k, _NONE, _ACT


@njit
def _act(
    loop: np.record,
    plant: PlantParts,
    observer: _Observer,
    tracker: _Tracker,
    signals: _Signals,
    blocked: int,
    k: int,
) -> None:
    """Log the sample with its command, and let the one that has arrived act over the sample."""
    row, state, now, n = signals.rows[k], plant.state, observer.stamps[k], len(tracker.feedback)
    if loop.stop and loop.started and not loop.ran:
        loop.offset += 1  # the clock of the path stands still
    place = min(max(k - loop.offset, 0), len(tracker.references) - 1)
    for i in range(n):
        signals.command[k, i] = tracker.law.torque[i]
    row.safe_stop, row.answered = loop.stop, loop.answered
    if k >= loop.delay and blocked & NO_COMMAND == 0:
        loop.acting = k - loop.delay
    row.place = place
    row.time, row.stop_reason = k * loop.period, loop.reason
    last = max(loop.acting, 0)
    acts = signals.rows[last]
    age, braking = now - observer.stamps[acts.answered], loop.acting == NEVER or acts.safe_stop
    row.brake_reason = check_drive(tracker.drives, now, age, braking, state.velocity)
    for i in range(n):
        signals.position[k, i], signals.velocity[k, i] = state.position[i], state.velocity[i]
        signals.measured[k, i], signals.fault[k, i] = state.measured_position[i], state.fault[i]
        signals.measured_velocity[k, i] = state.measured_velocity[i]
        signals.reference[k, i] = tracker.references[place, 0, i]
    if row.brake_reason != 0:
        brake(plant.chain, state, plant.scratch[:n])
    else:
        set_torque(plant.constants, state, signals.command[last], plant.push)
        if not loop.external:
            integrate(plant.chain, plant.constants, state, plant.scratch, plant.matrix)
    loop.phase = _ADVANCE if loop.external and row.brake_reason == 0 else _SENSE
    for i in range(n):
        signals.torque[k, i] = state.torque[i]


@dataclass
class Run:
    """Signals of one run of m samples, one row per sample."""

    time: FloatArray  # (m,) [s]
    position: FloatArray  # (m, n) true [rad]
    velocity: FloatArray  # (m, n) true [rad/s]
    measured: FloatArray  # (m, n) NaN in a dropout [rad]
    measured_velocity: FloatArray  # (m, n) [rad/s]
    effort: FloatArray  # (m, n) as reported with the sample, in the unit of the driver
    lost: np.ndarray  # (m,) whether the measurement never reached the observer
    compensated: FloatArray  # (m, n) measured less confirmed faults [rad]
    estimate: FloatArray  # (m, n) measured less estimated faults [rad]
    estimated_velocity: FloatArray  # (m, n) [rad/s]
    trustworthy: np.ndarray  # (m,) whether the estimate may be followed
    reference: FloatArray  # (m, n) [rad]
    fault: FloatArray  # (m, n) of the sensors, NaN in a dropout [rad]
    fault_estimate: FloatArray  # (m, n) [rad]
    bound: FloatArray  # (m, n) of its error [rad]
    threshold: FloatArray  # (m, n) beyond which an offset is a fault [rad]
    alarm: np.ndarray  # (m, n) 1 where the fault is confirmed
    inconsistent: np.ndarray  # (m,) whether readings, torques and model contradict each other
    torque: FloatArray  # (m, n) over the step after the sample [N m]
    command: FloatArray  # (m, n) torques that the tracker asked for last [N m]
    safe_stop: np.ndarray  # (m,) whether it asked for a safe stop instead, or has not begun
    disturbance: np.ndarray  # (m,) d over the step before the sample
    place: np.ndarray  # (m,) row of the path's references that is the sample's
    stop_reason: np.ndarray  # (m,) `StopReason` of the tracker
    brake_reason: np.ndarray  # (m,) `BrakeReason` of the drives
    alarms: list[Alarm]  # events
    # (3, m, n) references of the path: positions, rates, accelerations [rad], [rad/s], [rad/s2]
    path: FloatArray
    tip: FloatArray  # (m, 3) of the path [m]

    @property
    def braked(self) -> np.ndarray:
        """Whether the brakes held the arm over the step after each sample, shape (m,)."""
        return self.brake_reason != 0

    @property
    def stops(self) -> list[str]:
        """Why the brakes engaged, each time after the first release: drives, or the tracker."""
        asked, own, reasons = tuple(StopReason), tuple(BrakeReason), []
        for k in np.flatnonzero(self.braked[1:] & ~self.braked[:-1]) + 1:
            reason = own[self.brake_reason[k]].text
            if self.brake_reason[k] == BrakeReason.SAFE_STOP:
                begin = np.flatnonzero(self.safe_stop[1 : k + 1] & ~self.safe_stop[:k])[-1] + 1
                reason = asked[self.stop_reason[begin]].text
            reasons.append(reason)
        return reasons


def run_closed_loop(
    arm: SerialArm,
    scenario: Scenario,
    gains: Gains | None = None,
    compensation: str = 'confirmed',
    bandwidth: float = BANDWIDTH,
    parameters: DiagnosisParameters | None = None,
    substeps: int = 2,
    transport: Transport = DIRECT,
    observer: str = 'tightest',
) -> Run:
    """Simulate a scenario with diagnosis and tracking.

    Parameters
    ----------
    arm : SerialArm
        Nominal arm.
    scenario : Scenario
        Path, plant, noise, disturbance and faults.
    gains : Gains, optional
        Of a planar arm: the designed observer runs beside the horizon, and the designed law tracks.
        Computed torque otherwise.
    compensation : {'off', 'confirmed', 'always'}, optional
        Which position the loop closes on.
    bandwidth : float, optional
        Of computed torque [rad/s].
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    substeps : int, optional
        Least number of plant steps per sample.
    transport : Transport, optional
        Delay, losses and stalls; none otherwise.
    observer : {'tightest', 'uio', 'horizon'}, optional
        Whose estimate of the faults counts, where gains are given.

    Returns
    -------
    Run
        All signals.

    Raises
    ------
    ConfigError
        If arm, path, plant or faults are not possible together.
    """
    samples = scenario.duration / arm.sample_time
    if not 0.0 < samples < MOST_SAMPLES:
        limit = MOST_SAMPLES * arm.sample_time
        reason = f'must be above 0 and below {limit:g} s, which memory holds'
        raise ConfigError('duration', f'{reason}, got {scenario.duration:g}')
    if compensation not in COMPENSATION:
        reason = f'must be one of {", ".join(COMPENSATION)}, got {compensation!r}'
        raise ConfigError('compensation', reason)
    count = round(samples) + 1
    simulator = ArmSimulator(arm, scenario, substeps)
    monitor = SerialSensorMonitor('loop', arm, parameters, gains, observer)
    controller = TrackingController(arm, gains, bandwidth)
    speeds, scales = approach_speeds(arm, TrackerLimits.speed), arm.scales()
    path = scenario.path(arm)
    follower, start = PathFollower(path, speeds, scales), path.sample(0.0)
    references, tip = np.empty((count, 3, len(arm.joints))), np.empty((count, len(start.tip)))
    start.write(references, tip)
    plant = simulator.parts
    records = np.zeros(count, answer_type(len(arm.joints)))
    answers = answer_rows(records)
    fed_back = (answers.measured, answers.compensated, answers.position)
    feedback = fed_back[COMPENSATION.index(compensation)]
    stepped, answering = monitor.parts
    # A stream of its own: losses must not change noise and faults.
    losses = np.random.default_rng([scenario.seed, 2])
    parts = _new_observer(arm, stepped, answering, answers, feedback, losses)
    latency = latency_limits(controller.tolerated_latency)
    tracker = _Tracker(
        controller.parts,
        references,
        CorrectionLimit(arm, compensation != 'off').parts,
        TrackerWatchdog(arm, TrackerLimits(latency.single, latency)).parts,
        DriveWatchdog(arm, latency).parts,
        *np.zeros((2, len(arm.joints))),
    )
    loop = new_record(
        _LOOP,
        period=arm.sample_time,
        previous=NEVER,
        usable=NEVER,
        stop=True,
        acting=NEVER,
        delay=transport.delay,
        loss=transport.loss,
        external=simulator.engine is not None,
        literal=controller.integrates_measurement,
    )
    rows = np.zeros(count, _ROW).view(np.recarray)
    signals = _Signals(rows, *np.zeros((9, count, len(arm.joints))))
    blocked = transport.blocked(count, arm.sample_time)
    alarms: list[Alarm] = []
    shared, now = memory(loop), plain(loop)
    run = entry(_run, shared, plant, parts, tracker, signals, blocked, 0)
    k = 0
    while k < count:
        k = run(shared, plant, parts, tracker, signals, blocked, k)
        refuse_failure(simulator.state)
        phase = now['phase']
        if phase == _MONITOR:
            alarms += _hand_over(monitor, parts, records, loop, simulator.state, k)
            parts.times[:] = (parts.stamps - stepped.stamp_of(0.0)) / NANOSECONDS
        elif phase == _DECIDE:
            taken = (one[k : k + 1] for one in (parts.stamps, parts.times, parts.samples))
            alarms += monitor.go_on(parts.answering, answers, k, *taken)
            parts = parts._replace(parts=stepped.parts)
            now['phase'] = _ESTIMATE
        elif phase == _START:
            first = k - int(loop.offset)  # row of the references: samples in which the path ran
            if follower.running:
                follower.stop(int(parts.stamps[first - 1]))
            follower.reference(int(parts.stamps[first]), tracker.feedback.copy())
            follower.ahead(parts.stamps[first:]).write(references[first:], tip[first:])
            loop.previous, loop.started, loop.phase = k, True, _COMMAND
        elif phase == _ADVANCE:
            simulator.advance()
            now['phase'] = _SENSE
    # Where a measurement was lost, the answer before stands.
    last = np.maximum.accumulate(np.where(rows.lost, 0, np.arange(count)))
    records[rows.lost] = records[last[rows.lost]]
    return Run(
        **{name: rows[name] for name in rows.dtype.names if name != 'answered'},
        **dict(zip(_Signals._fields[1:], signals[1:])),
        compensated=answers.compensated,
        estimate=answers.position,
        estimated_velocity=answers.velocity,
        trustworthy=answers.trustworthy,
        fault_estimate=answers.estimate,
        bound=answers.bound,
        threshold=answers.threshold,
        alarm=answers.alarm,
        inconsistent=answers.inconsistent,
        alarms=alarms,
        path=np.moveaxis(references, 1, 0),
        tip=tip,
    )


def _hand_over(
    monitor: SerialSensorMonitor,
    observer: _Observer,
    records: np.ndarray,
    loop: np.record,
    state: PlantState,
    k: int,
) -> list[Alarm]:
    """Let the monitor itself take a sample, as the node does; returns alarm events."""
    before, stamps = int(loop.usable), observer.stamps
    if before != NEVER:
        last = records[before : before + 1].view(np.recarray)
        monitor.went_on(int(stamps[before]), observer.samples[before, 0], last)
    measured = state.measured_position, state.measured_velocity, state.effort
    answers = monitor.take_many(stamps[k : k + 1], *(np.array([one]) for one in measured))
    for name in ('answered', 'has_fault', 'restarted', 'inconsistent', 'state', 'fault'):
        records[name][k] = getattr(answers, name)[0]
    if monitor.last_used == stamps[k]:
        loop.usable = k
    loop.phase = _ESTIMATE
    return [event for _, event in answers.events]


def _new_observer(
    arm: SerialArm,
    stepped: SteppedMonitor,
    answering: Answering,
    answers: AnswerRows,
    feedback: FloatArray,
    losses: np.random.Generator,
) -> _Observer:
    count, n = feedback.shape
    stamps = np.rint(arm.sample_time * NANOSECONDS * np.arange(count)).astype(np.int64)
    times, samples = stamps / NANOSECONDS, np.empty((count, 3, n))
    parts, plan = stepped.parts, (stepped.plan.per_block, stepped.plan.blocks)
    answering = answering._replace(progress=memory(new_record(PROGRESS, next_report=_NO_REPORT)))
    given = parts, plan, answering, answers, 0, stamps, times, samples
    return _Observer(
        pointer(advance, *given),
        parts,
        plan,
        stamps,
        times,
        samples,
        answering,
        answers,
        feedback,
        losses,
    )
