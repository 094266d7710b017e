"""The whole loop in one process, in the order in which the lockstep graph runs it.

Simulator, monitor and controller are the very functions that the nodes call.
"""

from dataclasses import dataclass

import numpy as np

from lpv_core.control.path_follower import PathGuide
from lpv_core.control.tracking import (
    COMPENSATION,
    TRACKING_STATE,
    feedback_position,
    track,
    tracking_constants,
)
from lpv_core.decision.diagnosis import ALARM_EVENT
from lpv_core.decision.sensor_decision import NOTHING
from lpv_core.monitoring.monitor import SensorMonitor, copy_event, monitor_step
from lpv_core.simulation.arm_simulator import (
    ArmSimulator,
    brake,
    integrate,
    read_sensors,
    take_torque,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_OFF, _CONFIRMED, _ALWAYS = range(len(COMPENSATION))
_SENSE, _COMMAND, _ADVANCE = range(3)
_MOST_DELAY = 64
"""Commands that can be on their way."""
_EVENTS = 64

_LOOP = record_type(
    ('phase', 'i8'),
    ('external', '?'),
    ('compensation', 'i8'),
    ('literal', '?'),
    ('delay', 'i8'),
    ('loss', 'f8'),
    ('started', '?'),
    ('previous', 'i8'),
    ('offset', 'i8'),
    ('found', 'i8'),
    ('queue', 'f8', (_MOST_DELAY, 2)),
    ('stops', 'u1', (_MOST_DELAY,)),
    ('stop', '?'),
)
"""Where to go on; whether the plant is advanced from outside; compensation; whether eq. (59)
integrates the measurement; samples between a command and its effect; probability that a measurement
is lost; whether a command was given, and the stamp of the last one; samples by which the path is
late; alarm events found; commands on their way: torques [N m], and whether they are safe stops;
whether the last command is one."""

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
)


@njit
def _run(
    loop,
    c_plant,
    plant,
    faults,
    noise,
    push,
    chance,
    losses,
    c_monitor,
    monitor,
    buffers,
    answer,
    c_track,
    controller,
    positions,
    velocities,
    accelerations,
    rows,
    events,
    first,
):
    """Go on from sample ``first``; returns the sample at which something is needed from outside.

    That is room for alarm events, references for a path that starts or goes on (phase _COMMAND), or
    the advance of an external plant (phase _ADVANCE).
    """
    period = c_plant.sample_time
    # Arrays of their own: the monitor is then compiled for one kind of arrays only.
    position, velocity, effort = np.empty(2), np.empty(2), np.empty(2)
    for k in range(first, len(rows)):
        row, answering = rows[k], loop.phase == _COMMAND
        if loop.phase == _SENSE:
            if loop.found + 2 > len(events):
                return k
            read_sensors(c_plant, plant, faults, noise, chance)
            _record_truth(plant, row, k * period)
            row.lost = loop.loss > 0.0 and losses.random() < loop.loss
            if not row.lost:
                position[:] = plant.measured_position
                velocity[:] = plant.measured_velocity
                effort[:] = plant.torque
                monitor_step(
                    c_monitor,
                    monitor,
                    buffers,
                    answer,
                    round(k * period * 1e9),
                    position,
                    velocity,
                    effort,
                )
                _keep_events(loop, monitor, answer, events)
                if not answer.state.trustworthy:
                    # No start value yet, or a fault that cannot be compensated: brake.
                    _stop(loop, controller)
                elif loop.previous == NEVER:
                    loop.phase = _COMMAND
                    return k
                else:
                    answering = True
        elif answering:
            loop.previous, loop.started = k, True
        if answering:
            _command(
                loop,
                answer,
                c_track,
                controller,
                positions[k - loop.offset],
                velocities[k - loop.offset],
                accelerations[k - loop.offset],
                k,
                period,
            )
        if loop.phase != _ADVANCE:
            if loop.stop and loop.started:
                loop.offset += 1  # the clock of the path stands still
            place = min(max(k - loop.offset, 0), len(positions) - 1)
            _record_answer(answer, monitor.diagnosis.decision, row, positions[place])
            row.place, row.safe_stop = place, loop.stop
            row.command[0], row.command[1] = controller.torque[0], controller.torque[1]
            slot = k % _MOST_DELAY
            loop.queue[slot, 0], loop.queue[slot, 1] = controller.torque[0], controller.torque[1]
            loop.stops[slot] = loop.stop
            acting = (k - loop.delay) % _MOST_DELAY
            row.braked = k < loop.delay or loop.stops[acting] != 0
            if row.braked:
                brake(c_plant, plant)
            else:
                take_torque(c_plant, plant, loop.queue[acting, 0], loop.queue[acting, 1], push)
                if loop.external:
                    loop.phase = _ADVANCE
                    return k
                integrate(c_plant, plant)
        loop.phase = _SENSE
        row.torque[0], row.torque[1] = plant.torque[0], plant.torque[1]
    return len(rows)


def _stamps(first, end, period):
    return np.rint(np.arange(first, end) * period * NANOSECONDS).astype(np.int64)


def _guide_on(guide, first, period, position, reference) -> None:
    """Lay references from row ``first`` on for a loop that starts, or goes on after a stop.

    Rows count the samples in which the clock of the path runs.
    """
    stamps = _stamps(first, len(reference.position), period)
    if guide.running:
        guide.stop(round((first - 1) * period * NANOSECONDS))
    guide.reference(int(stamps[0]), np.array(position))
    if first == 0 and guide.is_on_path:
        return  # they are there
    ahead = guide.ahead(stamps)
    for name in ('position', 'velocity', 'acceleration', 'tip'):
        getattr(reference, name)[first:] = getattr(ahead, name)


@njit
def _stop(loop, controller) -> None:
    loop.stop, loop.previous = True, NEVER
    controller.integral[:] = 0.0
    controller.torque[:] = 0.0


@njit
def _command(loop, answer, params, controller, position, velocity, acceleration, k, period) -> None:
    """Answer an estimate as the tracker node does."""
    state = answer.state
    if loop.compensation == _ALWAYS:
        feedback = state.position
    elif loop.compensation == _CONFIRMED:
        feedback = state.compensated_position
    else:
        feedback = state.measured_position
    # Eq. (59) literally integrates the faulty measurement; the exact loop does not.
    integrated = state.measured_position if loop.literal else feedback
    interval = (round(k * period * 1e9) - round(loop.previous * period * 1e9)) / NANOSECONDS
    track(
        params,
        controller,
        position,
        velocity,
        acceleration,
        feedback,
        state.velocity,
        integrated,
        interval,
    )
    loop.stop, loop.previous = False, k


@njit
def _keep_events(loop, monitor, answer, events) -> None:
    if not answer.has_events:
        return
    for i in range(2):
        event = monitor.diagnosis.decision.events[i]
        if event.happened != NOTHING:
            copy_event(event, events[loop.found])
            loop.found += 1


@njit
def _record_truth(plant, row, time) -> None:
    row.time, row.disturbance = time, plant.disturbance
    for i in range(2):
        row.position[i], row.velocity[i] = plant.position[i], plant.velocity[i]
        row.measured[i], row.fault[i] = plant.measured_position[i], plant.fault[i]
        row.measured_velocity[i] = plant.measured_velocity[i]


@njit
def _record_answer(answer, decision, row, reference) -> None:
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
    """Signals of one run, one row a sample.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s].
    position, velocity : ndarray, shape (n, 2)
        True joint positions and rates.
    measured, estimate, estimated_velocity, reference : ndarray, shape (n, 2)
        Joint positions as measured and estimated, estimated rates, references.
    measured_velocity, compensated : ndarray, shape (n, 2)
        Measured joint rates; measured joint positions without the confirmed faults.
    lost : ndarray of bool, shape (n,)
        Samples whose measurement never reached the observer.
    fault, fault_estimate, threshold : ndarray, shape (n, 2)
        Of the physical sensors [rad].
    torque : ndarray, shape (n, 2)
        Joint torques over the step after the sample [N m].
    alarm : ndarray, shape (n, 2)
        Confirmed faults.
    inconsistent, trustworthy : ndarray of bool, shape (n,)
        As in `lpv_core.decision.diagnosis.DECISION`.
    braked : ndarray of bool, shape (n,)
        Whether the brakes held the arm over the step after the sample.
    command : ndarray, shape (n, 2)
        Joint torques that the tracker asked for last [N m].
    safe_stop : ndarray of bool, shape (n,)
        Whether it asked for a safe stop instead, or has not begun.
    disturbance : ndarray, shape (n,)
        d over the step before the sample.
    place : ndarray of int, shape (n,)
        Row of ``path`` that is the sample's reference: the path's clock stands still in a stop.
    path : ndarray, shape (4, n, 2)
        Positions, rates, accelerations [rad], [rad/s], [rad/s2] and tip [m] of references.
    alarms : list of Alarm
        Events.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    measured: np.ndarray
    measured_velocity: np.ndarray
    lost: np.ndarray
    compensated: np.ndarray
    estimate: np.ndarray
    estimated_velocity: np.ndarray
    reference: np.ndarray
    fault: np.ndarray
    fault_estimate: np.ndarray
    threshold: np.ndarray
    torque: np.ndarray
    alarm: np.ndarray
    inconsistent: np.ndarray
    trustworthy: np.ndarray
    braked: np.ndarray
    command: np.ndarray
    safe_stop: np.ndarray
    disturbance: np.ndarray
    place: np.ndarray
    path: np.ndarray
    alarms: list


def run_closed_loop(
    arm,
    gains,
    scenario,
    compensation: str = 'confirmed',
    parameters=None,
    substeps: int = 2,
    delay: int = 0,
    loss: float = 0.0,
) -> Run:
    """Simulate a scenario with observer, diagnosis and tracking.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    gains : Gains
        Its gains.
    scenario : Scenario
        What happens.
    compensation : {'off', 'confirmed', 'always'}, optional
        What the loop closes on.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.
    substeps : int, optional
        Plant steps per sample.
    delay : int, optional
        Samples from a measurement to the effect of the command that answers it, at most 63.
    loss : float, optional
        Probability that a measurement is lost; the last command then goes on.

    Returns
    -------
    Run
        All signals.
    """
    if not 0 <= delay < _MOST_DELAY:
        raise ValueError(f'delay must be 0 to {_MOST_DELAY - 1} samples, got {delay}')
    plant = ArmSimulator(arm, scenario, substeps)
    monitor = SensorMonitor('loop', arm, gains, parameters)
    rows = np.zeros(round(scenario.duration / arm.sample_time) + 1, _ROW).view(np.recarray)
    path = scenario.path(arm)
    guide = PathGuide(arm, path)
    # Times as the graph has them, in whole nanoseconds: products k*Ts are some last bits off.
    reference = path.sample(_stamps(0, len(rows), arm.sample_time) / NANOSECONDS)
    loop = new_record(
        _LOOP,
        compensation=COMPENSATION.index(compensation),
        delay=delay,
        loss=loss,
        literal=gains.controller.method == 'paper',
        previous=NEVER,
        stop=True,
        external=plant.engine is not None,
    )
    # A stream of its own: losses must not change noise and disturbance.
    losses = np.random.default_rng([scenario.seed, 1])
    controller, c_track = new_record(TRACKING_STATE), tracking_constants(arm, gains)
    events = np.zeros(_EVENTS, ALARM_EVENT).view(np.recarray)
    alarms, k = [], 0
    while k < len(rows):
        k = _run(
            loop,
            plant.constants,
            plant.state,
            plant.injector.records,
            plant.noise,
            plant.push,
            plant.injector.generator,
            losses,
            *monitor.parts,
            c_track,
            controller,
            reference.position,
            reference.velocity,
            reference.acceleration,
            rows,
            events,
            k,
        )
        alarms += monitor.alarms(events[: loop.found])
        loop.found = 0
        if loop.phase == _ADVANCE:
            plant.advance()
        elif loop.phase == _COMMAND and k < len(rows):
            state = monitor.parts[1]
            feedback = feedback_position(
                compensation, state.estimate, state.diagnosis.decision.confirmed_fault, plant.joints
            )
            _guide_on(guide, k - int(loop.offset), arm.sample_time, feedback, reference)
    return Run(
        **{name: rows[name] for name in rows.dtype.names},
        alarms=alarms,
        path=np.stack(
            [reference.position, reference.velocity, reference.acceleration, reference.tip]
        ),
    )
