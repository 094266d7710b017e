"""The whole loop of a serial arm in one process: simulator, diagnosis, tracker.

What happens every sample is compiled; the diagnosis decides in Python, after a jump of a reading
and every 50 ms.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from lpv_core.control.computed_torque import BANDWIDTH, ComputedTorqueController, computed_torque
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
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.monitoring.compensation import Compensation, compensate, new_compensation
from lpv_core.monitoring.stepped_monitor import Snapshot, SteppedMonitor
from lpv_core.observer.sampled_observer import Mode
from lpv_core.serial_arm.chain import Chain, FloatArray, IntArray, workspace
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.balance import Balance
from lpv_core.serial_arm.diagnosis.monitor import LONGEST_STEP, MonitorSettings, SerialAlarm
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
_OFF, _ALWAYS = COMPENSATION.index('off'), COMPENSATION.index('always')
_OBSERVING, _STALE = int(Mode.OBSERVING), int(Mode.STALE)
_NONE = int(StopReason.NONE)
_LONGEST_STALE = 50_000_000
"""As of the monitor of the node [ns]."""


def _loop_type(joints: int) -> np.dtype:
    return record_type(
        ('phase', 'i8'),  # of `Phase`
        ('external', '?'),  # whether the plant is integrated outside
        ('period', 'f8'),  # sample time [s]
        ('compensation', 'i8'),  # index in COMPENSATION
        ('previous', 'i8'),  # sample of the last command, or NEVER
        ('started', '?'),  # whether a command was ever given
        ('offset', 'i8'),  # samples by which the path is late
        ('stop', '?'),  # whether the last command is a safe stop
        ('reason', 'i8'),  # `StopReason` of the tracker
        ('usable', 'i8'),  # the last usable sample, or NEVER
        ('complete', '?'),  # whether a momentum balance is complete
        ('trustworthy', '?'),  # whether what is removed is known well enough
        ('feedback', 'f8', (joints,)),  # position that the loop is closed on [rad]
        ('rate', 'f8', (joints,)),  # rates that the loop is closed on [rad/s]
    )


def _known_type(joints: int) -> np.dtype:
    """What the diagnosis knows since its last decision, see `Snapshot`."""
    return record_type(
        ('stamp', 'i8'),  # of the decision [ns]
        ('fault', 'f8', (joints,)),  # estimated [rad]
        ('confirmed', 'f8', (joints,)),  # its part that is confirmed [rad]
        ('is_error', 'u1', (joints,)),
        ('rate', 'f8', (joints,)),  # at which faults go on [rad/s]
        ('drift', 'f8', (joints,)),  # error of derived rates [rad/s]
        ('jump_limit', 'f8', (joints,)),  # [rad]
        ('tuning', 'f8', (2,)),  # of `compensate`
    )


def _row_type(joints: int) -> np.dtype:
    return record_type(
        ('time', 'f8'),
        ('position', 'f8', (joints,)),
        ('measured', 'f8', (joints,)),
        ('measured_velocity', 'f8', (joints,)),
        ('compensated', 'f8', (joints,)),
        ('reference', 'f8', (joints,)),
        ('fault', 'f8', (joints,)),
        ('fault_estimate', 'f8', (joints,)),
        ('alarm', 'u1', (joints,)),
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
    faults: np.recarray
    noise: np.random.Generator
    chance: np.random.Generator
    scratch: FloatArray
    matrix: FloatArray


class _Observer(NamedTuple):
    """Arguments of `take_samples` and `compensate`; samples of the whole run, filled as they come.

    Of the work space of `compensate`, ``now`` has shape (1,), ``confirmed`` (1, n), ``result``
    (1, 3, n).
    """

    sampler: Sampler
    balance: Balance
    plan: tuple[int, int]
    stamps: IntArray
    times: FloatArray
    samples: FloatArray
    compensation: Compensation
    known: np.record
    independent: np.ndarray
    gains: FloatArray
    confirmed: FloatArray
    result: FloatArray


class _Tracker(NamedTuple):
    """Arguments of `computed_torque`; references of all samples; both watchdogs."""

    chain: Chain
    state: np.record
    work: FloatArray
    references: FloatArray
    watchdog: np.record
    drives: np.record


@njit
def _run(
    loop: np.record,
    plant: _Plant,
    observer: _Observer,
    tracker: _Tracker,
    rows: np.recarray,
    first: int,
) -> int:
    """Go on from a sample until something is needed from outside, see `Phase`."""
    for k in range(first, len(rows)):
        if loop.phase == _SENSE:
            _sense(loop, plant, observer, k)
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
def _sense(loop: np.record, plant: _Plant, observer: _Observer, k: int) -> None:
    """Read the sensors; a sample with values that are missing is not used."""
    state, row = plant.state, observer.samples[k]
    read_sensors(plant.constants, state, plant.faults, plant.noise, plant.chance)
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
    now, known, mode, trustworthy = observer.stamps[k], observer.known, _STALE, False
    if loop.usable == k:
        mode, trustworthy = _OBSERVING, loop.trustworthy
        elapsed = (now - known.stamp) / NANOSECONDS
        for i in range(len(loop.feedback)):
            confirmed = known.confirmed[i] + elapsed * known.rate[i]
            observer.confirmed[0, i] = confirmed if known.is_error[i] != 0 else 0.0
        compensate(
            observer.compensation,
            observer.stamps[k : k + 1],
            observer.samples[k : k + 1, :2],
            observer.confirmed,
            known.drift,
            known.jump_limit,
            (known.tuning[0], known.tuning[1]),
            observer.result,
        )
        for i in range(len(loop.feedback)):
            position = observer.result[0, 0, i]
            if loop.compensation == _OFF:
                position = observer.samples[k, 0, i]
            elif loop.compensation == _ALWAYS:
                position += observer.result[0, 2, i] - known.fault[i] - elapsed * known.rate[i]
            loop.feedback[i], loop.rate[i] = position, observer.result[0, 1, i]
    elif loop.usable != NEVER and now - observer.stamps[loop.usable] <= _LONGEST_STALE:
        trustworthy = loop.trustworthy
    reason = check_estimate(tracker.watchdog, now, 0, mode, trustworthy, loop.rate)
    if reason != _NONE:
        _stop(loop, tracker, reason)
    else:
        loop.phase = _START if loop.previous == NEVER else _COMMAND


@njit
def _stop(loop: np.record, tracker: _Tracker, reason: int) -> None:
    loop.stop, loop.previous, loop.reason, loop.phase = True, NEVER, reason, _ACT
    tracker.state.integral[:] = 0.0
    tracker.state.torque[:] = 0.0
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
    interval = (now - observer.stamps[loop.previous]) / NANOSECONDS
    computed_torque(
        tracker.chain, tracker.state, reference, loop.feedback, loop.rate, loop.feedback,
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
    known, elapsed = observer.known, (now - observer.known.stamp) / NANOSECONDS
    row.brake_reason = check_drive(tracker.drives, now, 0, loop.stop, state.velocity)
    for i in range(n):
        row.position[i], row.measured[i] = state.position[i], state.measured_position[i]
        row.measured_velocity[i], row.compensated[i] = state.measured_velocity[i], loop.feedback[i]
        row.reference[i] = tracker.references[place, 0, i]
        row.fault[i], row.fault_estimate[i] = state.fault[i], known.fault[i]
        row.fault_estimate[i] += elapsed * known.rate[i]
        row.alarm[i] = known.is_error[i]
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
    measured: FloatArray  # (m, n) [rad]
    measured_velocity: FloatArray  # (m, n) [rad/s]
    compensated: FloatArray  # (m, n) what the loop is closed on [rad]
    reference: FloatArray  # (m, n) [rad]
    fault: FloatArray  # (m, n) of the sensors, NaN in a dropout [rad]
    fault_estimate: FloatArray  # (m, n) [rad]
    alarm: np.ndarray  # (m, n) 1 where the fault is confirmed
    torque: FloatArray  # (m, n) over the step after the sample [N m]
    place: np.ndarray  # (m,) row of the path's references that is the sample's
    stop_reason: np.ndarray  # (m,) `StopReason` of the tracker
    brake_reason: np.ndarray  # (m,) `BrakeReason` of the drives
    alarms: list[SerialAlarm]


def run_serial_loop(
    arm: SerialArm,
    scenario: SerialScenario,
    compensation: str = 'confirmed',
    bandwidth: float = BANDWIDTH,
    settings: MonitorSettings | None = None,
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
    settings : MonitorSettings, optional
        Thresholds of the diagnosis.
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
    simulator, monitor = SerialArmSimulator(arm, scenario, substeps), SteppedMonitor(arm)
    if settings is not None:
        monitor.settings = settings
    controller = ComputedTorqueController(arm, bandwidth)
    references = PathReferences(scenario.path(arm), arm.sample_time, count)
    plant = _Plant(
        simulator.chain,
        simulator.constants,
        simulator.state,
        simulator.injector.records,
        simulator.noise,
        simulator.injector.generator,
        simulator.scratch,
        simulator.matrix,
    )
    observer = _new_observer(arm, monitor, count)
    latency = latency_limits(controller.tolerated_latency)
    tracker = _Tracker(
        controller.chain,
        controller.state,
        workspace(controller.chain),
        references.motion,
        tracker_watchdog(arm, TrackerLimits(latency.single, latency)),
        drive_watchdog(arm, DriveLimits(latency)),
    )
    loop = new_record(
        _loop_type(len(arm.joints)),
        period=arm.sample_time,
        compensation=COMPENSATION.index(compensation),
        previous=NEVER,
        usable=NEVER,
        stop=True,
        external=simulator.engine is not None,
    )
    _note(loop, observer, monitor.snapshot(), 0)
    rows = np.zeros(count, _row_type(len(arm.joints))).view(np.recarray)
    alarms: list[SerialAlarm] = []
    k = 0
    while k < count:
        k = _run(loop, plant, observer, tracker, rows, k)
        if simulator.state.failed:
            raise ConfigError('plant', 'has a mass matrix that is not positive definite')
        if loop.phase == _GAP:
            monitor.begin_again()
            loop.phase = _TAKE
        elif loop.phase == _DECIDE:
            monitor.decide(float(observer.times[k]), bool(loop.complete))
            known = monitor.snapshot()
            alarms += known.alarms
            _note(loop, observer, known, int(observer.stamps[k]))
            loop.phase = _ESTIMATE
        elif loop.phase == _START:
            references.restart(k - int(loop.offset), loop.feedback.copy())
            loop.previous, loop.started, loop.phase = k, True, _COMMAND
        elif loop.phase == _ADVANCE:
            simulator.advance()
            loop.phase = _SENSE
    return SerialLoopRun(**{name: rows[name] for name in rows.dtype.names}, alarms=alarms)


def _new_observer(arm: SerialArm, monitor: SteppedMonitor, count: int) -> _Observer:
    n = len(arm.joints)
    stamps = np.rint(arm.sample_time * NANOSECONDS * np.arange(count)).astype(np.int64)
    return _Observer(
        monitor.sampler,
        monitor.estimator.balance,
        (monitor.plan.per_block, monitor.plan.blocks),
        stamps,
        stamps / NANOSECONDS,
        np.empty((count, 3, n)),
        new_compensation(n),
        new_record(
            _known_type(n), tuning=(DiagnosisParameters().compensation_rate, arm.sample_time)
        ),
        np.array([joint.sensors.rates == 'independent' for joint in arm.joints]),
        np.array([joint.torque_gain for joint in arm.joints]),
        np.empty((1, n)),
        np.empty((1, 3, n)),
    )


def _note(loop: np.record, observer: _Observer, new: Snapshot, stamp: int) -> None:
    """Take over what the diagnosis knows, as `SerialSensorMonitor` does."""
    known, limits = observer.known, DiagnosisParameters()
    observer.compensation.applied[:] += new.jump
    known.stamp, known.fault, known.rate = stamp, new.fault, new.rate
    known.is_error, known.jump_limit = new.is_error, new.jump_limit
    known.confirmed = np.where(new.is_level, new.fault, new.removed)
    known.drift = np.where(new.is_error & ~observer.independent, new.rate, 0.0)
    sigma = np.where(new.is_level, new.sigma, new.removed_sigma)
    loop.trustworthy = not (new.is_error & (limits.sigmas * sigma > limits.safe_stop_bound)).any()
