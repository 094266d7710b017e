"""The whole loop of a serial arm in one process: simulator, diagnosis, tracker.

What happens every sample is compiled; the diagnosis decides in Python, after a jump of a reading
and every 50 ms.
"""

from dataclasses import dataclass
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
    note_stop,
    tracker_watchdog,
)
from lpv_core.observer.sampled_observer import Mode
from lpv_core.serial_arm.chain import Chain, FloatArray, workspace
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.balance import Balance
from lpv_core.serial_arm.diagnosis.monitor import (
    MonitorSettings,
    SensorState,
    SerialAlarm,
    SerialMonitor,
)
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

_OFF, _ALWAYS = COMPENSATION.index('off'), COMPENSATION.index('always')
_SENSE, _DECIDE, _START, _COMMAND, _ACT, _ADVANCE = range(6)
"""Phases of a sample; the diagnosis decides, a path starts, and MuJoCo integrates the plant outside
of compiled code."""
_OBSERVING = int(Mode.OBSERVING)
_NONE = int(StopReason.NONE)
_TOO_FAST = 2.0
"""Measured rates above so many times the joint's limit are not fed back [1]."""


def _loop_type(joints: int) -> np.dtype:
    return record_type(
        ('phase', 'i8'),
        ('external', '?'),  # whether the plant is integrated outside
        ('period', 'f8'),  # sample time [s]
        ('compensation', 'i8'),  # index in COMPENSATION
        ('previous', 'i8'),  # sample of the last command, or NEVER
        ('started', '?'),  # whether a command was ever given
        ('offset', 'i8'),  # samples by which the path is late
        ('stop', '?'),  # whether the last command is a safe stop
        ('reason', 'i8'),  # `StopReason` of the tracker
        ('complete', '?'),  # whether a momentum balance is complete
        ('reading', 'f8', (joints,)),  # as measured, missing ones bridged [rad]
        ('rate', 'f8', (joints,)),  # rates to feed back [rad/s]
        ('fault', 'f8', (joints,)),  # estimated [rad]
        ('confirmed', 'u1', (joints,)),  # 1: the fault is confirmed
        ('removed', 'f8', (joints,)),  # by the sampler when the fault was estimated [rad]
        ('feedback', 'f8', (joints,)),  # position that the loop is closed on [rad]
        ('velocity_limit', 'f8', (joints,)),  # [rad/s]
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
    """Arguments of `take_samples`; all samples of the run, filled as they come."""

    sampler: Sampler
    balance: Balance
    times: FloatArray
    samples: FloatArray
    gains: FloatArray
    plan: tuple[int, int]


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
    """Go on from a sample until something is needed from outside: see the phases."""
    for k in range(first, len(rows)):
        if loop.phase == _SENSE:
            _sense(loop, plant, observer, k)
            if loop.phase == _DECIDE:
                return k
        elif loop.phase == _DECIDE:
            loop.phase = _COMMAND
        if loop.phase == _COMMAND:
            _estimate(loop, observer, tracker, k)
            if loop.phase == _START:
                return k
        elif loop.phase == _START:
            loop.previous, loop.started, loop.phase = k, True, _COMMAND
        if loop.phase == _COMMAND:
            _command(loop, tracker, k)
        _act(loop, plant, tracker, rows[k], k)
        if loop.phase == _ADVANCE:
            return k + 1
    return len(rows)


@njit
def _sense(loop: np.record, plant: _Plant, observer: _Observer, k: int) -> None:
    """Read the sensors, bridge what is missing, and hand the sample to the diagnosis."""
    state, row = plant.state, observer.samples[k]
    read_sensors(plant.constants, state, plant.faults, plant.noise, plant.chance)
    for i in range(row.shape[1]):
        reading, rate = state.measured_position[i], state.measured_velocity[i]
        if not abs(rate) <= _TOO_FAST * loop.velocity_limit[i]:
            rate = loop.rate[i]
        if not abs(reading) < np.inf:
            reading = loop.reading[i] + loop.period * rate
        loop.reading[i], loop.rate[i] = reading, rate
        row[0, i], row[1, i] = reading, state.measured_velocity[i]
        if not abs(row[1, i]) < np.inf:
            row[1, i] = rate
        row[2, i] = state.torque[i] / plant.constants.effort_gain[i] * observer.gains[i]
    sampler = observer.sampler
    _, loop.complete = take_samples(
        sampler, observer.balance, observer.times[: k + 1], observer.samples[: k + 1], k,
        observer.plan,
    )  # fmt: skip
    loop.phase = _COMMAND
    for i in range(row.shape[1]):
        if sampler.found[i] != 0 or loop.complete:
            loop.phase = _DECIDE


@njit
def _estimate(loop: np.record, observer: _Observer, tracker: _Tracker, k: int) -> None:
    """Remove faults from the readings, and judge whether the arm may be driven."""
    removed = observer.sampler.correction
    for i in range(len(loop.reading)):
        fault = loop.fault[i] + removed[i] - loop.removed[i]
        remove = loop.compensation == _ALWAYS or (
            loop.compensation != _OFF and loop.confirmed[i] != 0
        )
        loop.feedback[i] = loop.reading[i] - (fault if remove else 0.0)
    now = round(k * loop.period * 1e9)
    reason = check_estimate(tracker.watchdog, now, 0, _OBSERVING, True, loop.rate)
    if reason != _NONE:
        _stop(loop, tracker, reason)
    elif loop.previous == NEVER:
        loop.phase = _START


@njit
def _stop(loop: np.record, tracker: _Tracker, reason: int) -> None:
    loop.stop, loop.previous, loop.reason, loop.phase = True, NEVER, reason, _ACT
    tracker.state.integral[:] = 0.0
    tracker.state.torque[:] = 0.0
    note_stop(tracker.watchdog)


@njit
def _command(loop: np.record, tracker: _Tracker, k: int) -> None:
    """Answer an estimate as the tracker node does."""
    now = round(k * loop.period * 1e9)
    reference = tracker.references[k - loop.offset]
    reason = check_motion(tracker.watchdog, now, reference[0], loop.feedback)
    if reason != _NONE:
        _stop(loop, tracker, reason)
        return
    interval = (now - round(loop.previous * loop.period * 1e9)) / NANOSECONDS
    computed_torque(
        tracker.chain, tracker.state, reference, loop.feedback, loop.rate, loop.feedback,
        interval, tracker.work,
    )  # fmt: skip
    loop.stop, loop.previous, loop.reason = False, k, _NONE


@njit
def _act(loop: np.record, plant: _Plant, tracker: _Tracker, row: np.record, k: int) -> None:
    """Let the command act over one sample, and log the sample."""
    state, n = plant.state, len(loop.reading)
    if loop.stop and loop.started:
        loop.offset += 1  # the clock of the path stands still
    place = min(max(k - loop.offset, 0), len(tracker.references) - 1)
    row.place = place
    row.time, row.stop_reason = k * loop.period, loop.reason
    now = round(k * loop.period * 1e9)
    row.brake_reason = check_drive(tracker.drives, now, 0, loop.stop, state.velocity)
    for i in range(n):
        row.position[i], row.measured[i] = state.position[i], state.measured_position[i]
        row.measured_velocity[i], row.compensated[i] = state.measured_velocity[i], loop.feedback[i]
        row.reference[i] = tracker.references[place, 0, i]
        row.fault[i], row.fault_estimate[i] = state.fault[i], loop.fault[i]
        row.alarm[i] = loop.confirmed[i]
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
    n, count = len(arm.joints), round(scenario.duration / arm.sample_time) + 1
    simulator, monitor = SerialArmSimulator(arm, scenario, substeps), SerialMonitor(arm, settings)
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
    observer = _Observer(
        monitor.sampler,
        monitor.estimator.balance,
        arm.sample_time * np.arange(float(count)),
        np.empty((count, 3, n)),
        np.array([joint.torque_gain for joint in arm.joints]),
        (monitor.plan.per_block, monitor.plan.blocks),
    )
    tracker = _Tracker(
        controller.chain,
        controller.state,
        workspace(controller.chain),
        references.motion,
        tracker_watchdog(arm, TrackerLimits()),
        drive_watchdog(arm, DriveLimits()),
    )
    loop = new_record(
        _loop_type(n),
        period=arm.sample_time,
        compensation=COMPENSATION.index(compensation),
        previous=NEVER,
        stop=True,
        external=simulator.engine is not None,
        velocity_limit=arm.velocity_limit,
    )
    rows, k = np.zeros(count, _row_type(n)).view(np.recarray), 0
    while k < count:
        k = _run(loop, plant, observer, tracker, rows, k)
        if simulator.state.failed:
            raise ConfigError('plant', 'has a mass matrix that is not positive definite')
        if loop.phase == _ADVANCE:
            simulator.advance()
            loop.phase = _SENSE
        elif k < count and loop.phase == _DECIDE:
            _decide(loop, monitor, float(observer.times[k]))
        elif k < count:
            references.restart(k - int(loop.offset), loop.feedback.copy())
    return SerialLoopRun(**{name: rows[name] for name in rows.dtype.names}, alarms=monitor.alarms)


def _decide(loop: np.record, monitor: SerialMonitor, now: float) -> None:
    """Let the diagnosis decide, and take over which faults are confirmed."""
    monitor.decide(now, bool(loop.complete))
    estimate = monitor.estimate(round(now * NANOSECONDS))
    loop.fault, loop.removed = estimate.fault, monitor.sampler.correction
    loop.confirmed = [state is SensorState.ERROR for state in estimate.state]
