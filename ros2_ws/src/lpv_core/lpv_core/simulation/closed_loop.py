"""The whole loop in one process, in the order in which the lockstep graph runs it.

Simulator, monitor and controller are the very functions that the nodes call.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from lpv_core.certificate.gains import Gains
from lpv_core.control.estimate_check import limit_correction, new_correction
from lpv_core.control.latency import tolerated_latency
from lpv_core.control.path_references import PathReferences
from lpv_core.control.tracking import (
    COMPENSATION,
    TRACKING_STATE,
    feedback_position,
    track,
    tracking_constants,
)
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
from lpv_core.decision.diagnosis import ALARM_EVENT, Alarm, DiagnosisParameters
from lpv_core.decision.sensor_decision import NOTHING
from lpv_core.model.arm import ArmParameters
from lpv_core.monitoring.monitor import SensorMonitor, copy_event, monitor_step
from lpv_core.residual.sample_buffer import SampleBuffer
from lpv_core.simulation.arm_simulator import (
    ArmSimulator,
    brake,
    integrate,
    read_sensors,
    set_torque,
)
from lpv_core.simulation.scenario import Scenario
from lpv_core.simulation.transport import (
    DIRECT,
    MAX_DELAY,
    NO_COMMAND,
    NO_ESTIMATE,
    NO_MEASUREMENT,
    PARTS,
    Stall,
    Transport,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

__all__ = ['PARTS', 'Run', 'Stall', 'Transport', 'run_closed_loop']

_OFF, _CONFIRMED, _ALWAYS = range(len(COMPENSATION))
_NONE, _SILENCE = int(StopReason.NONE), int(StopReason.SILENCE)
_EVENTS = 64


class Phase(IntEnum):
    """Where in a sample the loop goes on."""

    SENSE = 0
    REFERENCE = 1  # a path that starts or goes on needs its references from outside
    COMMAND = 2
    ACT = 3
    ADVANCE = 4  # the plant is integrated outside


_SENSE, _REFERENCE, _COMMAND, _ACT, _ADVANCE = (int(phase) for phase in Phase)

LOOP_STATE = record_type(
    ('phase', 'i8'),  # of `Phase`
    ('external', '?'),  # whether the plant is integrated outside
    ('compensation', 'i8'),  # index in COMPENSATION
    ('literal', '?'),  # whether eq. (59) integrates the measurement
    ('period', 'f8'),  # sample time [s]
    ('delay', 'i8'),  # samples between a command and its effect
    ('loss', 'f8'),  # probability that a measurement is lost
    ('started', '?'),  # whether a command was ever given
    ('previous', 'i8'),  # sample of the last command, or NEVER
    ('answered', 'i8'),  # sample that the last command answers
    ('acting', 'i8'),  # sample that the command answers which acts
    ('offset', 'i8'),  # samples by which the path is late
    ('found', 'i8'),  # alarm events since the caller looked
    ('queue', 'f8', (MAX_DELAY, 2)),  # torques on their way [N m]
    ('stops', 'u1', (MAX_DELAY,)),  # whether the commands on their way are safe stops
    ('stamps', 'i8', (MAX_DELAY,)),  # samples that the commands on their way answer
    ('stop', '?'),  # whether the last command is a safe stop
    ('reason', 'i8'),  # `StopReason` of the tracker
    ('torque', 'f8', (2,)),  # of the command that acts [N m]
    ('braking', '?'),  # whether the command that acts is a safe stop
)

_ROW = record_type(
    ('time', 'f8'),
    ('position', 'f8', (2,)),
    ('velocity', 'f8', (2,)),
    ('measured', 'f8', (2,)),
    ('measured_velocity', 'f8', (2,)),
    ('lost', '?'),
    ('compensated', 'f8', (2,)),
    ('estimate', 'f8', (2,)),
    ('estimated_velocity', 'f8', (2,)),
    ('reference', 'f8', (2,)),
    ('fault', 'f8', (2,)),
    ('fault_estimate', 'f8', (2,)),
    ('threshold', 'f8', (2,)),
    ('torque', 'f8', (2,)),
    ('alarm', 'u1', (2,)),
    ('inconsistent', '?'),
    ('trustworthy', '?'),
    ('braked', '?'),
    ('command', 'f8', (2,)),
    ('safe_stop', '?'),
    ('disturbance', 'f8'),
    ('place', 'i8'),
    ('stop_reason', 'u1'),
    ('brake_reason', 'u1'),
)
"""See `Run`."""


class _Plant(NamedTuple):
    """Arguments of the functions of `lpv_core.simulation.arm_simulator`."""

    constants: np.record
    state: np.record
    faults: np.ndarray


class _Streams(NamedTuple):
    """Generators of a run, apart from records: Numba finds the type of a tuple that holds a
    generator anew at every call, that of a record with fields in milliseconds."""

    noise: np.random.Generator
    push: np.random.Generator
    chance: np.random.Generator
    losses: np.random.Generator


class _Monitor(NamedTuple):
    """Arguments of `monitor_step`; measurement as arrays of one kind only."""

    constants: np.record
    state: np.record
    buffers: SampleBuffer
    answer: np.record
    measurement: np.ndarray


class _Tracker(NamedTuple):
    """Arguments of `track`; references of all samples, shape (n, 3, 2); both watchdogs."""

    constants: np.record
    state: np.record
    references: np.ndarray
    correction: np.record  # of `limit_correction`
    watchdog: np.record
    drives: np.record


class _Log(NamedTuple):
    """What a run leaves, and what is blocked at each sample."""

    rows: np.recarray
    events: np.recarray
    blocked: np.ndarray


@njit
def _run(
    loop: np.record,
    plant: _Plant,
    streams: _Streams,
    monitor: _Monitor,
    tracker: _Tracker,
    log: _Log,
    first: int,
) -> int:
    """Go on from sample ``first``; returns the sample at which something is needed from outside.

    That is room for alarm events (phase SENSE), references for a path that starts or goes on (phase
    REFERENCE), or the integration of an external plant (phase ADVANCE).
    """
    for k in range(first, len(log.rows)):
        row = log.rows[k]
        if loop.phase == _SENSE:
            if loop.found + 2 > len(log.events):
                return k
            _sense(loop, plant, streams, monitor, tracker, log, k)
            if loop.phase == _REFERENCE:
                return k
        elif loop.phase == _REFERENCE:
            loop.previous, loop.started, loop.phase = k, True, _COMMAND
        if loop.phase == _COMMAND:
            _command(loop, monitor.answer.state, tracker, k)
        if loop.phase == _ACT:
            _act(loop, plant, streams.push, monitor, tracker, row, log.blocked[k], k)
            if loop.phase == _ADVANCE:
                return k
        loop.phase = _SENSE
        row.torque[0], row.torque[1] = plant.state.torque[0], plant.state.torque[1]
    return len(log.rows)


@njit
def _sense(
    loop: np.record,
    plant: _Plant,
    streams: _Streams,
    monitor: _Monitor,
    tracker: _Tracker,
    log: _Log,
    k: int,
) -> None:
    """Read the sensors and let the observer answer, unless the measurement is lost."""
    row, state = log.rows[k], plant.state
    read_sensors(plant.constants, state, plant.faults, streams.noise, streams.chance)
    _record_truth(state, row, k * loop.period)
    row.lost = loop.loss > 0.0 and streams.losses.random() < loop.loss
    row.lost = row.lost or log.blocked[k] & NO_MEASUREMENT != 0
    loop.phase = _ACT
    now = round(k * loop.period * 1e9)
    previous = NEVER if loop.previous == NEVER else round(loop.previous * loop.period * 1e9)
    if previous != NEVER and now - previous > tracker.watchdog.silence:
        _stop(loop, tracker, _SILENCE)
    if row.lost:
        return
    measurement, answer = monitor.measurement, monitor.answer
    measurement[0, :] = state.measured_position
    measurement[1, :] = state.measured_velocity
    measurement[2, :] = state.torque
    monitor_step(
        monitor.constants,
        monitor.state,
        monitor.buffers,
        answer,
        now,
        measurement[0],
        measurement[1],
        measurement[2],
    )
    _keep_events(loop, monitor, log.events)
    if log.blocked[k] & NO_ESTIMATE != 0:
        return
    estimate = answer.state
    reason = check_estimate(
        tracker.watchdog,
        now,
        0,
        estimate.mode,
        estimate.trustworthy,
        estimate.velocity,
        estimate.measured_velocity,
    )
    loop.answered = k
    if reason != _NONE:
        _stop(loop, tracker, reason)
    else:
        loop.phase = _REFERENCE if loop.previous == NEVER else _COMMAND


@njit
def _stop(loop: np.record, tracker: _Tracker, reason: int) -> None:
    loop.stop, loop.previous, loop.reason = True, NEVER, reason
    tracker.state.integral[:] = 0.0
    tracker.state.torque[:] = 0.0
    tracker.correction.stamp = NEVER
    note_stop(tracker.watchdog)


@njit
def _command(loop: np.record, estimate: np.record, tracker: _Tracker, k: int) -> None:
    """Answer an estimate as the tracker node does."""
    loop.phase = _ACT
    if loop.compensation == _ALWAYS:
        feedback = estimate.position
    elif loop.compensation == _CONFIRMED:
        feedback = estimate.compensated_position
    else:
        feedback = estimate.measured_position
    now = round(k * loop.period * 1e9)
    reference = tracker.references[k - loop.offset]
    reason = check_motion(tracker.watchdog, now, reference[0], feedback)
    if reason != _NONE:
        _stop(loop, tracker, reason)
        return
    limit_correction(tracker.correction, now, feedback, estimate.velocity)
    position, rate = tracker.correction.feedback[0], tracker.correction.feedback[1]
    # Eq. (59) literally integrates the faulty measurement; the exact loop does not.
    integrated = estimate.measured_position[:] if loop.literal else position
    track(
        tracker.constants,
        tracker.state,
        reference,
        position,
        rate,
        integrated,
        (now - round(loop.previous * loop.period * 1e9)) / NANOSECONDS,
    )
    loop.stop, loop.previous, loop.reason = False, k, _NONE


@njit
def _act(
    loop: np.record,
    plant: _Plant,
    push: np.random.Generator,
    monitor: _Monitor,
    tracker: _Tracker,
    row: np.record,
    blocked: int,
    k: int,
) -> None:
    """Queue the command, and let the one that has arrived act over one sample."""
    if loop.stop and loop.started:
        loop.offset += 1  # the clock of the path stands still
    place = min(max(k - loop.offset, 0), len(tracker.references) - 1)
    _record_answer(
        monitor.answer, monitor.state.diagnosis.decision, row, tracker.references[place, 0]
    )
    torque, slot = tracker.state.torque, k % MAX_DELAY
    row.place, row.safe_stop, row.stop_reason = place, loop.stop, loop.reason
    row.command[0], row.command[1] = torque[0], torque[1]
    loop.queue[slot, 0], loop.queue[slot, 1] = torque[0], torque[1]
    loop.stops[slot], loop.stamps[slot] = loop.stop, loop.answered
    arrived = (k - loop.delay) % MAX_DELAY
    if k >= loop.delay and blocked & NO_COMMAND == 0:
        loop.torque[0], loop.torque[1] = loop.queue[arrived, 0], loop.queue[arrived, 1]
        loop.braking, loop.acting = loop.stops[arrived] != 0, loop.stamps[arrived]
    now = round(k * loop.period * 1e9)
    age = now - round(loop.acting * loop.period * 1e9)
    row.brake_reason = check_drive(tracker.drives, now, age, loop.braking, plant.state.velocity)
    row.braked = row.brake_reason != _NONE
    if row.braked:
        brake(plant.constants, plant.state)
        return
    set_torque(plant.constants, plant.state, loop.torque[0], loop.torque[1], push)
    if loop.external:
        loop.phase = _ADVANCE
    else:
        integrate(plant.constants, plant.state)


@njit
def _keep_events(loop: np.record, monitor: _Monitor, events: np.recarray) -> None:
    if not monitor.answer.has_events:
        return
    for i in range(2):
        event = monitor.state.diagnosis.decision.events[i]
        if event.happened != NOTHING:
            copy_event(event, events[loop.found])
            loop.found += 1


@njit
def _record_truth(state: np.record, row: np.record, time: float) -> None:
    row.time, row.disturbance = time, state.disturbance
    for i in range(2):
        row.position[i], row.velocity[i] = state.position[i], state.velocity[i]
        row.measured[i], row.fault[i] = state.measured_position[i], state.fault[i]
        row.measured_velocity[i] = state.measured_velocity[i]


@njit
def _record_answer(
    answer: np.record, decision: np.record, row: np.record, reference: np.ndarray
) -> None:
    row.inconsistent, row.trustworthy = decision.inconsistent, answer.state.trustworthy
    for i in range(2):
        row.estimate[i] = answer.state.position[i]
        row.estimated_velocity[i] = answer.state.velocity[i]
        row.compensated[i] = answer.state.compensated_position[i]
        row.fault_estimate[i] = answer.fault.estimate[i]
        row.threshold[i] = answer.fault.threshold[i]
        row.alarm[i] = answer.fault.alarm[i]
        row.reference[i] = reference[i]


@dataclass
class Run:
    """Signals of one run, one row per sample."""

    time: np.ndarray  # (n,) [s]
    position: np.ndarray  # (n, 2) true [rad]
    velocity: np.ndarray  # (n, 2) true [rad/s]
    measured: np.ndarray  # (n, 2) [rad]
    measured_velocity: np.ndarray  # (n, 2) [rad/s]
    lost: np.ndarray  # (n,) whether the measurement never reached the observer
    compensated: np.ndarray  # (n, 2) measured less confirmed faults [rad]
    estimate: np.ndarray  # (n, 2) positions as estimated [rad]
    estimated_velocity: np.ndarray  # (n, 2) [rad/s]
    reference: np.ndarray  # (n, 2) [rad]
    fault: np.ndarray  # (n, 2) of the physical sensors [rad]
    fault_estimate: np.ndarray  # (n, 2) [rad]
    threshold: np.ndarray  # (n, 2) [rad]
    torque: np.ndarray  # (n, 2) over the step after the sample [N m]
    alarm: np.ndarray  # (n, 2) confirmed faults
    inconsistent: np.ndarray  # (n,) as in `lpv_core.decision.diagnosis.DECISION`
    trustworthy: np.ndarray  # (n,) likewise
    braked: np.ndarray  # (n,) whether the brakes held the arm over the step after the sample
    command: np.ndarray  # (n, 2) torques that the tracker asked for last [N m]
    safe_stop: np.ndarray  # (n,) whether it asked for a safe stop instead, or has not begun
    disturbance: np.ndarray  # (n,) d over the step before the sample
    # (n,) row of `path` that is the reference: in a stop the path's clock stands still
    place: np.ndarray
    stop_reason: np.ndarray  # (n,) `lpv_core.control.watchdog.StopReason` of the tracker
    brake_reason: np.ndarray  # (n,) `lpv_core.control.watchdog.BrakeReason` of the drives
    # (4, n, 2) references: positions, rates, accelerations [rad], [rad/s], [rad/s2]; tip [m]
    path: np.ndarray
    alarms: list  # events


def run_closed_loop(
    arm: ArmParameters,
    gains: Gains,
    scenario: Scenario,
    compensation: str = 'confirmed',
    parameters: DiagnosisParameters | None = None,
    substeps: int = 2,
    transport: Transport = DIRECT,
) -> Run:
    """Simulate a scenario with observer, diagnosis and tracking.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    gains : Gains
        Its gains.
    scenario : Scenario
        Path, plant, noise, disturbance and faults.
    compensation : {'off', 'confirmed', 'always'}, optional
        Which position the loop closes on.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    substeps : int, optional
        Plant steps per sample.
    transport : Transport, optional
        Delay, losses and stalls; none otherwise.

    Returns
    -------
    Run
        All signals.
    """
    simulator = ArmSimulator(arm, scenario, substeps)
    sensor_monitor = SensorMonitor('loop', arm, gains, parameters)
    loop = new_record(
        LOOP_STATE,
        compensation=COMPENSATION.index(compensation),
        period=arm.sample_time,
        delay=transport.delay,
        loss=transport.loss,
        literal=gains.controller.method == 'paper',
        previous=NEVER,
        stop=True,
        braking=True,
        external=simulator.engine is not None,
    )
    count = round(scenario.duration / arm.sample_time) + 1
    references = PathReferences(scenario.path(arm), arm.sample_time, count)
    plant = _Plant(simulator.constants, simulator.state, simulator.injector.records)
    monitor = _Monitor._make([*sensor_monitor.parts, np.empty((3, 2))])
    latency = latency_limits(tolerated_latency(arm, gains))
    tracker = _Tracker(
        tracking_constants(arm, gains),
        new_record(TRACKING_STATE),
        references.motion,
        new_correction(arm, compensation != 'off'),
        tracker_watchdog(arm, TrackerLimits(latency.single, latency)),
        drive_watchdog(arm, DriveLimits(latency)),
    )
    log = _Log(
        np.zeros(count, _ROW).view(np.recarray),
        np.zeros(_EVENTS, ALARM_EVENT).view(np.recarray),
        transport.blocked(count, arm.sample_time),
    )
    # A stream of its own: losses must not change noise and disturbance.
    losses = np.random.default_rng([scenario.seed, 1])
    streams = _Streams(simulator.noise, simulator.push, simulator.injector.generator, losses)
    alarms: list[Alarm] = []
    k = 0
    while k < count:
        k = _run(loop, plant, streams, monitor, tracker, log, k)
        alarms += sensor_monitor.alarms(log.events[: loop.found])
        loop.found = 0
        if loop.phase == _ADVANCE:
            simulator.advance()
        elif loop.phase == _REFERENCE and k < count:
            feedback = feedback_position(compensation, monitor.answer.state)
            references.restart(k - int(loop.offset), feedback)
    return Run(
        **{name: log.rows[name] for name in _ROW.fields or ()},
        alarms=alarms,
        path=np.stack([*np.moveaxis(references.motion, 1, 0), references.tip]),
    )
