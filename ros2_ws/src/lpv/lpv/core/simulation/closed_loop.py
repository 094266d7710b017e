"""The whole loop in one process, in the order in which the lockstep graph runs it.

Simulator, monitor and controller are the very functions that the nodes call.

What happens every sample is compiled, and the diagnosis decides every 50 ms; Python does what only
a suspicion needs, or a jump of a reading.  A sample that does not simply follow the one before (the
first one, one after a gap, with missing values, or after such) goes through the monitor's
`take_many`, as in the node.
"""

from collections import namedtuple
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
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm
from lpv.core.serial_arm.diagnosis.decision import Parts
from lpv.core.serial_arm.diagnosis.monitor import LONGEST_STEP
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.simulation.arm_simulator import (
    ArmSimulator,
    Chances,
    PlantParts,
    brake,
    drive,
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


_Signals = namedtuple(
    '_Signals',
    'position velocity measured measured_velocity effort reference fault torque command lost '
    'safe_stop disturbance place answered stop_reason brake_reason',
)
"""Signals of `Run` that the loop writes, and the sample that each command answers."""


def _new_signals(count: int, joints: int) -> _Signals:
    flags, numbers = np.zeros((2, count), bool), np.zeros((2, count), np.int64)
    reasons = np.zeros((2, count), np.uint8)
    vectors = np.zeros((9, count, joints))
    return _Signals._make([*vectors, *flags, np.zeros(count), *numbers, *reasons])


class _Loop(NamedTuple):
    """What the compiled loop works on, for all samples of the run."""

    own: np.ndarray  # memory of a record of `_LOOP`
    plant: PlantParts
    chances: Chances
    losses: np.random.Generator  # of measurements
    blocked: np.ndarray  # of the transport
    advance: Callable[..., bool]  # that of the diagnosis, and its arguments
    parts: Parts
    answering: Answering
    answers: AnswerRows
    stamps: IntArray
    times: FloatArray
    samples: FloatArray
    feedback: FloatArray  # those positions of the answers that the loop is closed on
    law: LawParts
    references: FloatArray
    correction: Correction
    watchdog: TrackerWatchdogParts
    drives: DriveWatchdogParts
    signals: _Signals
    position: FloatArray  # (n,) that the loop is closed on [rad]
    rate: FloatArray  # (n,) that the loop is closed on [rad/s]


@njit
def _run(loop: _Loop, first: int) -> int:
    """Go on from a sample until something is needed from outside."""
    own = loop.own[0]
    for k in range(first, len(loop.blocked)):
        if own.phase == _SENSE:
            _sense(loop, k)
        if own.phase == _MONITOR:
            return k
        if own.phase == _TAKE:
            _take(loop, k)
        if own.phase == _DECIDE:
            return k
        if own.phase == _ESTIMATE:
            _estimate(loop, k)
        if own.phase == _START:
            return k
        if own.phase == _COMMAND:
            _command(loop, k)
        _act(loop, k)
        if own.phase == _ADVANCE:
            return k + 1
    return len(loop.blocked)


@njit
def _sense(loop: _Loop, k: int) -> None:
    """Read the sensors, and choose the way of the measurement unless it is lost."""
    own, plant, sample = loop.own[0], loop.plant, loop.samples[k]
    state, signals = plant.state, loop.signals
    own.ran = False
    read_sensors(plant, loop.chances.noise, loop.chances.fault)
    signals.disturbance[k] = state.own[0].disturbance
    map_vector(plant.constants.sensor, state.measured_position, sample[0])
    map_vector(plant.constants.sensor, state.measured_velocity, sample[1])
    missing = False
    for i in range(sample.shape[1]):
        signals.effort[k, i] = state.effort[i]
        sample[2, i] = state.effort[i] * plant.constants.effort_gain[i]
        if not (abs(sample[0, i]) < np.inf and abs(sample[1, i]) < np.inf):
            missing = True
    lost = own.loss > 0.0 and loop.losses.random() < own.loss
    signals.lost[k] = lost = lost or loop.blocked[k] & NO_MEASUREMENT != 0
    waited = 0 if own.previous == NEVER else loop.stamps[k] - loop.stamps[own.previous]
    if waited > loop.watchdog.own[0].silence:
        _stop(loop, _SILENCE)
    if lost:
        own.phase = _ACT
        return
    follows = own.usable != NEVER and k - own.usable <= LONGEST_STEP
    own.phase = _TAKE if follows and not (missing or own.missing) else _MONITOR
    own.missing = missing
    if own.phase == _TAKE:
        own.usable = k


@njit
def _take(loop: _Loop, k: int) -> None:
    """Hand the sample to the diagnosis, which decides and answers as far as it needs no Python."""
    progress = loop.answering.progress[0]
    progress.taken = progress.answered = progress.reported = 0
    stamps, times, samples = loop.stamps[k : k + 1], loop.times[k : k + 1], loop.samples[k : k + 1]
    waits = loop.advance(loop.parts, loop.answering, loop.answers, k, stamps, times, samples)
    loop.own[0].phase = _DECIDE if waits else _ESTIMATE


@njit
def _estimate(loop: _Loop, k: int) -> None:
    """Whether the tracker follows the answer."""
    own, answers = loop.own[0], loop.answers
    if loop.blocked[k] & NO_ESTIMATE != 0:
        own.phase = _ACT
        return
    for i in range(len(loop.position)):
        loop.position[i], loop.rate[i] = loop.feedback[k, i], answers.velocity[k, i]
    mode, trustworthy, measured = (
        answers.mode[k],
        answers.trustworthy[k],
        answers.measured_velocity[k],
    )
    reason = check_estimate(
        loop.watchdog, loop.stamps[k], 0, mode, trustworthy, loop.rate, measured
    )
    own.answered = k
    if reason != _NONE:
        _stop(loop, reason)
    else:
        own.phase = _START if own.previous == NEVER else _COMMAND


@njit
def _stop(loop: _Loop, reason: int) -> None:
    own = loop.own[0]
    own.stop, own.previous, own.reason, own.phase = True, NEVER, reason, _ACT
    loop.law.integral[:] = 0.0
    loop.law.torque[:] = 0.0
    loop.correction.stamp[0] = NEVER
    loop.watchdog.own[0].started = False  # the next reference is a start


@njit
def _command(loop: _Loop, k: int) -> None:
    """Answer an estimate as the tracker node does."""
    own, now, measured = loop.own[0], loop.stamps[k], loop.answers.measured[k]
    own.ran, reference = True, loop.references[k - own.offset]
    reason = check_motion(loop.watchdog, now, reference[0], loop.position, measured)
    if reason != _NONE:
        _stop(loop, reason)
        return
    limit_correction(loop.correction, now, loop.position, loop.rate)
    feedback, rate = loop.correction.feedback[0], loop.correction.feedback[1]
    # Eq. (59) literally integrates the faulty measurement.
    integrated = measured if own.literal else feedback
    interval = (now - loop.stamps[own.previous]) / NANOSECONDS
    track(loop.law, reference, feedback, rate, integrated, interval)
    own.stop, own.previous, own.reason, own.phase = False, k, _NONE, _ACT


@njit
def _act(loop: _Loop, k: int) -> None:
    """Log the sample with its command, and let the one that has arrived act over the sample."""
    own, plant, signals, now = loop.own[0], loop.plant, loop.signals, loop.stamps[k]
    state, n, push = plant.state, len(loop.position), loop.chances.push
    if own.stop and own.started and not own.ran:
        own.offset += 1  # the clock of the path stands still
    place = min(max(k - own.offset, 0), len(loop.references) - 1)
    signals.safe_stop[k], signals.answered[k] = own.stop, own.answered
    signals.place[k], signals.stop_reason[k] = place, own.reason
    for i in range(n):
        signals.command[k, i] = loop.law.torque[i]
        signals.position[k, i], signals.velocity[k, i] = state.position[i], state.velocity[i]
        signals.measured[k, i], signals.fault[k, i] = state.measured_position[i], state.fault[i]
        signals.measured_velocity[k, i] = state.measured_velocity[i]
        signals.reference[k, i] = loop.references[place, 0, i]
    if k >= own.delay and loop.blocked[k] & NO_COMMAND == 0:
        own.acting = k - own.delay
    acting = max(own.acting, 0)
    age = now - loop.stamps[signals.answered[acting]]
    braking = own.acting == NEVER or signals.safe_stop[acting]
    reason = check_drive(loop.drives, now, age, braking, state.velocity)
    signals.brake_reason[k], own.phase = reason, _SENSE
    if reason != 0:
        brake(plant)
    elif own.external:
        set_torque(plant, signals.command[acting], push)
        own.phase = _ADVANCE
    else:
        drive(plant, signals.command[acting], push)
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
    steps = scenario.duration / arm.sample_time
    if not 0.0 < steps < MOST_SAMPLES:
        limit = MOST_SAMPLES * arm.sample_time
        reason = f'must be above 0 and below {limit:g} s, which memory holds'
        raise ConfigError('duration', f'{reason}, got {scenario.duration:g}')
    if compensation not in COMPENSATION:
        reason = f'must be one of {", ".join(COMPENSATION)}, got {compensation!r}'
        raise ConfigError('compensation', reason)
    count = round(steps) + 1
    simulator = ArmSimulator(arm, scenario, substeps)
    monitor = SerialSensorMonitor('loop', arm, parameters, gains, observer)
    controller = TrackingController(arm, gains, bandwidth)
    speeds, scales = approach_speeds(arm, TrackerLimits.speed), arm.scales()
    path = scenario.path(arm)
    follower, start = PathFollower(path, speeds, scales), path.sample(0.0)
    references, tip = np.empty((count, 3, len(arm.joints))), np.empty((count, len(start.tip)))
    start.write(references, tip)
    records = np.zeros(count, answer_type(len(arm.joints)))
    answers = answer_rows(records)
    fed_back = (answers.measured, answers.compensated, answers.position)
    feedback = fed_back[COMPENSATION.index(compensation)]
    latency = latency_limits(controller.tolerated_latency)
    now = new_record(
        _LOOP,
        previous=NEVER,
        usable=NEVER,
        stop=True,
        acting=NEVER,
        delay=transport.delay,
        loss=transport.loss,
        external=simulator.engine is not None,
        literal=controller.integrates_measurement,
    )
    stepped, answering = monitor.parts
    stamps = np.rint(arm.sample_time * NANOSECONDS * np.arange(count)).astype(np.int64)
    times, samples = stamps / NANOSECONDS, np.empty((count, 3, len(arm.joints)))
    answering = answering._replace(progress=memory(new_record(PROGRESS, next_report=_NO_REPORT)))
    given, series = (stepped.parts, answering, answers), (stamps, times, samples)
    loop = _Loop(
        memory(now),
        simulator.parts,
        simulator.chances,
        np.random.default_rng([scenario.seed, 2]),  # losses must not change noise and faults
        transport.blocked(count, arm.sample_time),
        pointer(advance, *given, 0, *series),
        *given,
        *series,
        feedback,
        controller.parts,
        references,
        CorrectionLimit(arm, compensation != 'off').parts,
        TrackerWatchdog(arm, TrackerLimits(latency.single, latency)).parts,
        DriveWatchdog(arm, latency).parts,
        _new_signals(count, len(arm.joints)),
        *np.zeros((2, len(arm.joints))),
    )
    alarms: list[Alarm] = []
    run = entry(_run, loop, 0)
    k, own = 0, plain(now)
    while k < count:
        k = run(loop, k)
        refuse_failure(simulator.state)
        phase = own['phase']
        if phase == _MONITOR:
            alarms += _hand_over(monitor, loop, records, now, k)
            times[:] = (stamps - stepped.stamp_of(0.0)) / NANOSECONDS
        elif phase == _DECIDE:
            taken = (one[k : k + 1] for one in (stamps, times, samples))
            alarms += monitor.go_on(answering, answers, k, *taken)
            loop = loop._replace(parts=stepped.parts)
            own['phase'] = _ESTIMATE
        elif phase == _START:
            first = k - int(now.offset)  # row of the references: samples in which the path ran
            if follower.running:
                follower.stop(int(stamps[first - 1]))
            follower.reference(int(stamps[first]), loop.position.copy())
            follower.ahead(stamps[first:]).write(references[first:], tip[first:])
            now.previous, now.started, now.phase = k, True, _COMMAND
        elif phase == _ADVANCE:
            simulator.advance()
            own['phase'] = _SENSE
    signals = loop.signals
    # Where a measurement was lost, the answer before stands.
    last = np.maximum.accumulate(np.where(signals.lost, 0, np.arange(count)))
    records[signals.lost] = records[last[signals.lost]]
    written = signals._asdict()
    del written['answered']
    return Run(
        **written,
        time=arm.sample_time * np.arange(float(count)),
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
    monitor: SerialSensorMonitor, loop: _Loop, records: np.ndarray, own: np.record, k: int
) -> list[Alarm]:
    """Let the monitor itself take a sample, as the node does; returns alarm events."""
    before, stamps, state = int(own.usable), loop.stamps, loop.plant.state
    if before != NEVER:
        last = records[before : before + 1]
        monitor.went_on(int(stamps[before]), loop.samples[before, 0], last)
    measured = state.measured_position, state.measured_velocity, state.effort
    answers = monitor.take_many(stamps[k : k + 1], *(np.array([one]) for one in measured))
    records[k] = answers.plain[0]
    if monitor.last_used == stamps[k]:
        own.usable = k
    own.phase = _ESTIMATE
    return [event for _, event in answers.events]
