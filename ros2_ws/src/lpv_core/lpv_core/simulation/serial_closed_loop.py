"""The whole loop of a serial arm in one process: simulator, diagnosis, tracker.

What happens every sample is compiled; the diagnosis decides in Python, after a jump of a reading
and every 50 ms.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from lpv_core.control.computed_torque import BANDWIDTH, ComputedTorqueController, computed_torque
from lpv_core.control.estimate_check import limit_correction, new_correction
from lpv_core.control.path_references import PathReferences
from lpv_core.control.tracking import COMPENSATION
from lpv_core.control.watchdog import (
    DriveLimits,
    StopReason,
    TrackerLimits,
    check_drive,
    check_estimate,
    check_motion,
    drive_watchdog,
    latency_limits,
    note_stop,
    tracker_watchdog,
)
from lpv_core.decision.diagnosis import Alarm, DiagnosisParameters
from lpv_core.monitoring.answers import LONGEST_STALE, answer_type
from lpv_core.monitoring.compensation import (
    AnswerRows,
    Compensation,
    Flags,
    Known,
    answer_rows,
    fill_answers,
    repeat_answer,
)
from lpv_core.monitoring.serial_monitor import MonitorParts, SerialSensorMonitor
from lpv_core.serial_arm.chain import Chain, FloatArray, IntArray, workspace
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.balance import Balance
from lpv_core.serial_arm.diagnosis.monitor import LONGEST_STEP
from lpv_core.serial_arm.diagnosis.sampling import Sampler, take_samples
from lpv_core.simulation.serial_scenario import SerialScenario
from lpv_core.simulation.serial_simulator import (
    SerialArmSimulator,
    brake,
    integrate,
    read_sensors,
    set_torque,
)
from lpv_core.support.errors import ConfigError
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER


class Phase(IntEnum):
    """Where in a sample the loop goes on."""

    SENSE = 0
    GAP = 1  # the diagnosis begins new balances, outside
    TAKE = 2
    DECIDE = 3  # the diagnosis decides, outside
    ESTIMATE = 4
    START = 5  # a path that starts or goes on needs its references from outside
    COMMAND = 6
    ACT = 7
    ADVANCE = 8  # the plant is integrated outside


_SENSE, _GAP, _TAKE, _DECIDE, _ESTIMATE, _START, _COMMAND, _ACT, _ADVANCE = (int(p) for p in Phase)
_NONE = int(StopReason.NONE)


def _loop_type(joints: int) -> np.dtype:
    return record_type(
        ('phase', 'i8'),  # of `Phase`
        ('external', '?'),  # whether the plant is integrated outside
        ('period', 'f8'),  # sample time [s]
        ('previous', 'i8'),  # sample of the last command, or NEVER
        ('started', '?'),  # whether a command was ever given
        ('offset', 'i8'),  # samples by which the path is late
        ('stop', '?'),  # whether the last command is a safe stop
        ('reason', 'i8'),  # `StopReason` of the tracker
        ('usable', 'i8'),  # the last usable sample, or NEVER
        ('complete', '?'),  # whether a momentum balance is complete
        ('feedback', 'f8', (joints,)),  # position that the loop is closed on [rad]
        ('rate', 'f8', (joints,)),  # rates that the loop is closed on [rad/s]
    )


def _row_type(joints: int) -> np.dtype:
    return record_type(
        ('time', 'f8'),
        ('position', 'f8', (joints,)),
        ('velocity', 'f8', (joints,)),
        ('measured', 'f8', (joints,)),
        ('measured_velocity', 'f8', (joints,)),
        ('reference', 'f8', (joints,)),
        ('fault', 'f8', (joints,)),
        ('torque', 'f8', (joints,)),
        ('place', 'i8'),
        ('stop_reason', 'u1'),
        ('brake_reason', 'u1'),
    )


class _Plant(NamedTuple):
    """Arguments of the functions of `lpv_core.simulation.serial_simulator`."""

    chain: Chain
    constants: np.record
    state: np.record
    faults: np.ndarray
    scratch: FloatArray
    matrix: FloatArray


class _Streams(NamedTuple):
    """Generators, apart from records: see `lpv_core.simulation.closed_loop`."""

    noise: np.random.Generator
    chance: np.random.Generator


class _Observer(NamedTuple):
    """Arguments of `take_samples` and `fill_answers`, for all samples of the run."""

    sampler: Sampler
    balance: Balance
    plan: tuple[int, int]
    stamps: IntArray
    times: FloatArray
    samples: FloatArray
    compensation: Compensation
    known: Known
    flags: Flags
    answers: AnswerRows
    feedback: FloatArray  # those positions of the answers that the loop is closed on
    gains: FloatArray


class _Tracker(NamedTuple):
    """Arguments of `computed_torque`; references of all samples; both watchdogs."""

    chain: Chain
    state: np.record
    work: FloatArray
    references: FloatArray
    correction: np.record  # of `limit_correction`
    watchdog: np.record
    drives: np.record


@njit
def _run(
    loop: np.record,
    plant: _Plant,
    streams: _Streams,
    observer: _Observer,
    tracker: _Tracker,
    rows: np.recarray,
    first: int,
) -> int:
    """Go on from a sample until something is needed from outside, see `Phase`."""
    for k in range(first, len(rows)):
        if loop.phase == _SENSE:
            _sense(loop, plant, streams, observer, k)
        if loop.phase == _GAP:
            return k
        if loop.phase == _TAKE:
            _take(loop, observer, k)
        if loop.phase == _DECIDE:
            return k
        if loop.phase == _ESTIMATE:
            _estimate(loop, observer, tracker, k)
        if loop.phase == _START:
            return k
        if loop.phase == _COMMAND:
            _command(loop, observer, tracker, k)
        _act(loop, plant, observer, tracker, rows[k], k)
        if loop.phase == _ADVANCE:
            return k + 1
    return len(rows)


@njit
def _sense(loop: np.record, plant: _Plant, streams: _Streams, observer: _Observer, k: int) -> None:
    """Read the sensors; a sample with values that are missing is not used."""
    state, row = plant.state, observer.samples[k]
    read_sensors(plant.constants, state, plant.faults, streams.noise, streams.chance)
    loop.phase = _TAKE
    for i in range(row.shape[1]):
        row[0, i], row[1, i] = state.measured_position[i], state.measured_velocity[i]
        row[2, i] = state.torque[i] / plant.constants.effort_gain[i] * observer.gains[i]
        if not (abs(row[0, i]) < np.inf and abs(row[1, i]) < np.inf):
            loop.phase = _ESTIMATE
    if loop.phase == _ESTIMATE:
        return
    if loop.usable != NEVER and k - loop.usable > LONGEST_STEP:
        loop.phase = _GAP
    loop.usable = k


@njit
def _take(loop: np.record, observer: _Observer, k: int) -> None:
    """Hand the sample to the diagnosis."""
    _, loop.complete = take_samples(
        observer.sampler,
        observer.balance,
        observer.times[: k + 1],
        observer.samples[: k + 1],
        k,
        observer.plan,
    )
    loop.phase = _DECIDE if loop.complete else _ESTIMATE
    for found in observer.sampler.found:
        if found != 0:
            loop.phase = _DECIDE


@njit
def _estimate(loop: np.record, observer: _Observer, tracker: _Tracker, k: int) -> None:
    """What the node answers: readings without confirmed faults; and whether to follow that."""
    now, answers = observer.stamps[k], observer.answers
    if loop.usable == k:
        fill_answers(
            observer.compensation,
            answers,
            (k, k + 1),
            observer.stamps,
            observer.samples,
            observer.known,
            observer.flags,
        )
    else:
        usable = loop.usable
        fresh = usable != NEVER and now - observer.stamps[usable] <= LONGEST_STALE
        repeat_answer(answers, k, usable, fresh)
    for i in range(len(loop.feedback)):
        loop.feedback[i], loop.rate[i] = observer.feedback[k, i], answers.velocity[k, i]
    reason = check_estimate(
        tracker.watchdog,
        now,
        0,
        answers.mode[k],
        answers.trustworthy[k],
        loop.rate,
        answers.measured_velocity[k],
    )
    if reason != _NONE:
        _stop(loop, tracker, reason)
    else:
        loop.phase = _START if loop.previous == NEVER else _COMMAND


@njit
def _stop(loop: np.record, tracker: _Tracker, reason: int) -> None:
    loop.stop, loop.previous, loop.reason, loop.phase = True, NEVER, reason, _ACT
    tracker.state.integral[:] = 0.0
    tracker.state.torque[:] = 0.0
    tracker.correction.stamp = NEVER
    note_stop(tracker.watchdog)


@njit
def _command(loop: np.record, observer: _Observer, tracker: _Tracker, k: int) -> None:
    """Answer an estimate as the tracker node does."""
    now = observer.stamps[k]
    reference = tracker.references[k - loop.offset]
    reason = check_motion(tracker.watchdog, now, reference[0], loop.feedback)
    if reason != _NONE:
        _stop(loop, tracker, reason)
        return
    limit_correction(tracker.correction, now, loop.feedback, loop.rate)
    feedback, rate = tracker.correction.feedback[0], tracker.correction.feedback[1]
    interval = (now - observer.stamps[loop.previous]) / NANOSECONDS
    computed_torque(
        tracker.chain, tracker.state, reference, feedback, rate, feedback,
        interval, tracker.work,
    )  # fmt: skip
    loop.stop, loop.previous, loop.reason, loop.phase = False, k, _NONE, _ACT


@njit
def _act(
    loop: np.record, plant: _Plant, observer: _Observer, tracker: _Tracker, row: np.record, k: int
) -> None:
    """Let the command act over one sample, and log the sample."""
    state, n, now = plant.state, len(loop.feedback), observer.stamps[k]
    if loop.stop and loop.started:
        loop.offset += 1  # the clock of the path stands still
    place = min(max(k - loop.offset, 0), len(tracker.references) - 1)
    row.place = place
    row.time, row.stop_reason = k * loop.period, loop.reason
    row.brake_reason = check_drive(tracker.drives, now, 0, loop.stop, state.velocity)
    for i in range(n):
        row.position[i], row.velocity[i] = state.position[i], state.velocity[i]
        row.measured[i], row.fault[i] = state.measured_position[i], state.fault[i]
        row.measured_velocity[i] = state.measured_velocity[i]
        row.reference[i] = tracker.references[place, 0, i]
    if row.brake_reason != 0:
        brake(plant.chain, state, plant.scratch[:n])
    else:
        set_torque(plant.constants, state, tracker.state.torque)
        if not loop.external:
            integrate(plant.chain, plant.constants, state, plant.scratch, plant.matrix)
    loop.phase = _ADVANCE if loop.external and row.brake_reason == 0 else _SENSE
    for i in range(n):
        row.torque[i] = state.torque[i]


@dataclass
class SerialLoopRun:
    """Signals of one run of m samples, one row per sample."""

    time: FloatArray  # (m,) [s]
    position: FloatArray  # (m, n) true [rad]
    velocity: FloatArray  # (m, n) true [rad/s]
    measured: FloatArray  # (m, n) NaN in a dropout [rad]
    measured_velocity: FloatArray  # (m, n) [rad/s]
    compensated: FloatArray  # (m, n) measured less confirmed faults [rad]
    estimate: FloatArray  # (m, n) measured less estimated faults [rad]
    reference: FloatArray  # (m, n) [rad]
    fault: FloatArray  # (m, n) of the sensors, NaN in a dropout [rad]
    fault_estimate: FloatArray  # (m, n) [rad]
    threshold: FloatArray  # (m, n) beyond which an offset is a fault [rad]
    alarm: np.ndarray  # (m, n) 1 where the fault is confirmed
    inconsistent: np.ndarray  # (m,) whether readings, torques and model contradict each other
    torque: FloatArray  # (m, n) over the step after the sample [N m]
    place: np.ndarray  # (m,) row of the path's references that is the sample's
    stop_reason: np.ndarray  # (m,) `StopReason` of the tracker
    brake_reason: np.ndarray  # (m,) `BrakeReason` of the drives
    alarms: list[Alarm]  # events

    @property
    def braked(self) -> np.ndarray:
        """Whether the brakes held the arm over the step after each sample, shape (m,)."""
        return self.brake_reason != 0


def run_serial_loop(
    arm: SerialArm,
    scenario: SerialScenario,
    compensation: str = 'confirmed',
    bandwidth: float = BANDWIDTH,
    parameters: DiagnosisParameters | None = None,
    substeps: int = 2,
) -> SerialLoopRun:
    """Simulate a scenario with diagnosis and tracking.

    Parameters
    ----------
    arm : SerialArm
        Nominal arm.
    scenario : SerialScenario
        Path, plant, noise and faults.
    compensation : {'off', 'confirmed', 'always'}, optional
        Which position the loop closes on.
    bandwidth : float, optional
        Of the tracker [rad/s].
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    substeps : int, optional
        Least number of plant steps per sample.

    Returns
    -------
    SerialLoopRun
        All signals.

    Raises
    ------
    ConfigError
        If arm, path, plant or faults are not possible together.
    """
    count = round(scenario.duration / arm.sample_time) + 1
    simulator = SerialArmSimulator(arm, scenario, substeps)
    monitor = SerialSensorMonitor('loop', arm, parameters)
    controller = ComputedTorqueController(arm, bandwidth)
    references = PathReferences(scenario.path(arm), arm.sample_time, count)
    plant = _Plant(
        simulator.chain,
        simulator.constants,
        simulator.state,
        simulator.injector.records,
        simulator.scratch,
        simulator.matrix,
    )
    streams = _Streams(simulator.noise, simulator.injector.generator)
    answers = answer_rows(np.zeros(count, answer_type(len(arm.joints))))
    fed_back = (answers.measured, answers.compensated, answers.position)
    feedback = fed_back[COMPENSATION.index(compensation)]
    stepped, observer = monitor.parts.monitor, _new_observer(arm, monitor.parts, answers, feedback)
    latency = latency_limits(controller.tolerated_latency)
    tracker = _Tracker(
        controller.chain,
        controller.state,
        workspace(controller.chain),
        references.motion,
        new_correction(arm, compensation != 'off'),
        tracker_watchdog(arm, TrackerLimits(latency.single, latency)),
        drive_watchdog(arm, DriveLimits(latency)),
    )
    loop = new_record(
        _loop_type(len(arm.joints)),
        period=arm.sample_time,
        previous=NEVER,
        usable=NEVER,
        stop=True,
        external=simulator.engine is not None,
    )
    rows = np.zeros(count, _row_type(len(arm.joints))).view(np.recarray)
    alarms: list[Alarm] = []
    k = 0
    while k < count:
        k = _run(loop, plant, streams, observer, tracker, rows, k)
        if simulator.state.failed:
            raise ConfigError('plant', 'has a mass matrix that is not positive definite')
        if loop.phase == _GAP:
            stepped.begin_again()
            loop.phase = _TAKE
        elif loop.phase == _DECIDE:
            stepped.decide(float(observer.times[k]), bool(loop.complete))
            alarms += monitor.note(stepped.snapshot(), int(observer.stamps[k]))
            observer = observer._replace(known=monitor.parts.known, flags=monitor.parts.flags)
            loop.phase = _ESTIMATE
        elif loop.phase == _START:
            references.restart(k - int(loop.offset), loop.feedback.copy())
            loop.previous, loop.started, loop.phase = k, True, _COMMAND
        elif loop.phase == _ADVANCE:
            simulator.advance()
            loop.phase = _SENSE
    return SerialLoopRun(
        **{name: rows[name] for name in rows.dtype.names},
        compensated=answers.compensated,
        estimate=answers.position,
        fault_estimate=answers.estimate,
        threshold=answers.threshold,
        alarm=answers.alarm,
        inconsistent=answers.inconsistent,
        alarms=alarms,
    )


def _new_observer(
    arm: SerialArm, parts: MonitorParts, answers: AnswerRows, feedback: FloatArray
) -> _Observer:
    count, n = feedback.shape
    stamps = np.rint(arm.sample_time * NANOSECONDS * np.arange(count)).astype(np.int64)
    return _Observer(
        parts.monitor.sampler,
        parts.monitor.estimator.balance,
        (parts.monitor.plan.per_block, parts.monitor.plan.blocks),
        stamps,
        stamps / NANOSECONDS,
        np.empty((count, 3, n)),
        parts.compensation,
        parts.known,
        parts.flags,
        answers,
        feedback,
        np.array([joint.torque_gain for joint in arm.joints]),
    )
