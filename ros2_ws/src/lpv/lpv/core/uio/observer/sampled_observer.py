"""The sampled unknown-input observer: joint-space samples in, estimates out.

Samples are in order and finite; the monitor sees to that (`lpv.core.monitoring.serial_monitor`).
"""

import math

import numpy as np

from lpv.core.serial_arm.description import SIGMAS
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.serial_arm.two_links import ARM_CONSTANTS, ArmParameters
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.limits import MAX_GAP, SMALL
from lpv.core.support.records import new_record, record_type
from lpv.core.support.timestamps import NANOSECONDS, NEVER
from lpv.core.uio.model.dynamics import Pair, acceleration, set_pose
from lpv.core.uio.model.joints import JOINT_MAP, JointMap, copy_vector, row_dot
from lpv.core.uio.observer.exact_observer import ExactObserverGains, exact_rate
from lpv.core.uio.observer.paper_observer import PaperObserverGains, observer_matrices, paper_rate

ObserverGains = ExactObserverGains | PaperObserverGains
"""Of either method."""
_AT_REST = 5.0
"""Rates below so many standard deviations of their noise are those of an arm at rest: one in two
million is larger."""
_SUPPORTED = 0.02
"""At rest, torques below that part of what gravity needs are not those that hold the arm."""
_REST = 0.02
"""An arm is held by something that is not measured if it seems so for this long [s]."""
_STILL = SIGMAS * math.sqrt(2.0)
"""Readings that differ by less, in standard deviations of their noise, have not moved."""
_OBSERVING, _HOLDING, _INITIALISING = (int(m) for m in Mode if m <= Mode.INITIALISING)


# What is known of an arm that came to rest faster than measured torques explain.  It was braked, or
# its rate sensors read nothing while it moves on: its position sensors tell which, once an arm that
# moves on would have moved by twice their noise.
_MOVING, _RESTING, _SUDDEN, _BRAKED = range(4)

STOP_STATE = record_type(
    ('kind', 'u1'),  # moving, at rest, at rest too suddenly, or found braked at this sample
    ('lasted', 'f8'),  # since the arm came to rest [s]
    ('rate', 'f8'),  # by which the estimate was faster then [rad/s]
    ('angle', 'f8', (2,)),  # theta^ then [rad]
    ('reading', 'f8', (2,)),  # of the position sensors then [rad]
)
OBSERVER_CONSTANTS = record_type(
    ('is_exact', '?'),  # the method
    ('joints', JOINT_MAP),
    ('arm', ARM_CONSTANTS),
    # Of method exact:
    ('sign', 'f8'),  # s: +1 upright, -1 hanging
    ('kappa', 'f8', (2,)),  # s kappa_i [1/(kg m2)]
    ('mu', 'f8', (2,)),  # [1/s]
    ('cos_min', 'f8', (2,)),  # smallest s cos(theta_i) of the certified region
    # Of method paper:
    ('t2', 'f8', (6, 4)),  # T2
    ('box', 'f8', (3, 2)),  # ranges of phi1, phi2, phi3
    ('matrices', 'f8', (8, 6, 12)),  # of `observer_matrices`
    ('sample_time', 'f8'),  # [s]
    ('max_gap', 'f8'),  # longest interval that is integrated [s]
    ('initial_samples', 'i8'),  # samples that the start value is averaged over
    ('rest_rate', 'f8'),  # rates of an arm at rest stay below [rad/s]
    ('rest_samples', 'i8'),  # at rest without torque, after which it is held by something else
    ('torque_tolerance', 'f8', (2,)),  # generalised torques at rest that the model may miss [N m]
    ('still', 'f8'),  # largest change of a reading at rest [rad]
)
OBSERVER_STATE = record_type(
    ('x', 'f8', (6,)),  # x^ = (theta^, theta^', f^): absolute angles, physical sensors [rad]
    ('pose', 'f8', (3, 3)),  # of theta^, as of `set_pose`
    ('held', 'u1', (2,)),  # links without gravity information: dead reckoning
    # largest change of theta'' within a step of the interval, of method exact [rad/s2]
    ('bend', 'f8', (2,)),
    ('v_new', 'f8', (2,)),  # measured theta' at the end of the interval [rad/s]
    # Of a step, with its rates at both ends:
    ('start', 'f8', (6,)),  # x^ at its start, with the outputs of its end
    ('rate', 'f8', (2, 6)),  # z' of eq. (38)
    ('model', 'f8', (2, 2)),  # theta'' of the model, of method exact [rad/s2]
    ('rho', 'f8', (8,)),  # weights of the vertices, of method paper
    ('matrix', 'f8', (6, 12)),  # of the weights, as `matrices`
    ('stamp', 'i8'),  # of the last sample [ns]
    ('started', 'i8'),  # samples since the start
    ('unsupported', 'i8'),  # samples at rest without the torque that gravity needs
    ('stopping', STOP_STATE),
    # Outputs in sensor coordinates, positions [rad] and rates [rad/s]:
    ('y', 'f8', (4,)),  # of the last sample
    ('y_new', 'f8', (4,)),  # of this sample
    ('after', 'f8', (4,)),  # at the end of a part of the interval
    ('torque', 'f8', (2,)),  # generalised torques Q over the interval [N m]
    ('slope', 'f8', (2,)),  # how these changed since the sample before [N m/s]
    # largest change of them within the interval, as it shows and as it went on before [N m]
    ('change', 'f8', (2,)),
    # What is said of this sample, beside x, pose, v_new, held and bend:
    ('interval', 'f8'),  # since the previous estimate [s]
    ('mode', 'u1'),  # of `Mode`
    ('position', 'f8', (2,)),  # estimated, ROS joint coordinates [rad]
    ('velocity', 'f8', (2,)),  # the same [rad/s]
    ('acceleration', 'f8', (2,)),  # theta'' of the model at the estimate [rad/s2]
    ('innovation', 'f8', (2,)),  # estimated minus measured theta' [rad/s]
    ('bridged', '?'),  # the interval was too long: angles went on by the encoders' increments
)


def observer_constants(
    arm: ArmParameters, gains: ObserverGains, initial_samples: int = 1, max_gap: float = MAX_GAP
) -> np.record:
    """Constants of `observe`, of type `OBSERVER_CONSTANTS`.

    The mean of ``initial_samples`` is taken for free of faults: a constant bias at the start is
    only found at the certified decay rate.  Intervals longer than ``max_gap`` [s] re-anchor the
    estimate on the encoder's increment and hold the fault estimate.
    """
    params = new_record(
        OBSERVER_CONSTANTS,
        joints=JointMap(arm).record(),
        arm=arm.constants(),
        sample_time=arm.sample_time,
        max_gap=max_gap,
        initial_samples=max(1, int(initial_samples)),
        rest_rate=_AT_REST * arm.velocity_noise,
        rest_samples=max(5, math.ceil(_REST / arm.sample_time)),
        torque_tolerance=np.asarray(arm.torque_tolerance) + sum(arm.coulomb),
        still=_STILL * arm.position_noise,
    )
    if isinstance(gains, ExactObserverGains):
        params.is_exact, params.sign, params.cos_min = True, arm.sign, arm.cos_min
        params.kappa, params.mu = arm.sign * gains.kappa, gains.mu
    else:
        params.t2, params.box = gains.t2, gains.box
        params.matrices = observer_matrices(arm, gains)
    return params


@njit
def reset_observer(state: np.record) -> None:
    """Forget everything; the observer restarts with the next sample."""
    state.stamp, state.started, state.unsupported = NEVER, 0, 0
    state.stopping.kind = _MOVING
    state.held[:] = False
    state.y[:] = 0.0


@njit
def observe(
    params: np.record,
    state: np.record,
    stamp: int,
    position: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
) -> bool:
    """Sampled unknown-input observer, eqs. (38)-(53): the estimate at one measurement.

    An interval above ``max_gap`` re-anchors the estimate; an arm at rest whose measured torques do
    not hold it against gravity is held by something else: nothing is learnt from them; an arm that
    was stopped by a torque that is not measured (brakes) goes on from the angles it had then.

    ``params`` are `observer_constants`, ``state`` of type `OBSERVER_STATE` has the estimate.
    ``position`` and ``velocity``, shape (2,), are those of the joints as in
    ``sensor_msgs/JointState``, in the order of the arm file [rad], [rad/s], ``stamp`` is their time
    [ns]; ``effort``, shape (2,), are joint torques over the interval that ends then [N m].

    False if there is no finite estimate; the observer then restarts.
    """
    interval = 0.0 if state.stamp == NEVER else (stamp - state.stamp) / NANOSECONDS
    y, joints = state.y_new, params.joints
    for i in range(2):
        y[i] = row_dot(joints.from_joint, i, position[0] + joints.zero, position[1])
        y[2 + i] = row_dot(joints.from_joint, i, velocity[0], velocity[1])
    for i in range(2):
        state.v_new[i] = row_dot(joints.angle, i, y[2], y[3])
    _note_torque(state, interval, (effort[0] - effort[1], effort[1]))  # Q = J^T tau
    state.bend[:] = 0.0
    if state.stamp == NEVER:
        state.x[4:] = 0.0
    elif interval > params.max_gap:
        state.stopping.kind = _MOVING
        _anchor(params, state)
    elif _is_unsupported(params, state):
        state.stopping.kind = _RESTING
        _hold(params, state, interval)
    else:
        if params.is_exact:
            _note_stop(params, state, interval)
        _advance(params, state, interval)
        if state.stopping.kind == _BRAKED:  # what was learnt from the missing momentum is undone
            for i in range(2):
                state.x[i], state.x[2 + i] = state.stopping.angle[i], state.v_new[i]
            _see_faults(params, state, state.y_new)
    if state.started < params.initial_samples:  # faults of the samples so far are zero on average
        for i in range(2):
            state.x[4 + i] *= state.started / (state.started + 1)
        _anchor(params, state)
    for i in range(6):
        if not math.isfinite(state.x[i]):
            # Can only follow from absurd input (1e300 rad/s); never let it out.
            reset_observer(state)
            return False
    state.stamp = stamp
    copy_vector(state.y_new, state.y)
    state.started += 1
    state.interval, state.bridged = interval, interval > params.max_gap
    _fill(params, state)
    return True


@njit
def _note_torque(state: np.record, interval: float, torque: Pair) -> None:
    for i in range(2):
        change = torque[i] - state.torque[i] if interval > 0.0 else 0.0
        state.change[i] = max(abs(change), interval * abs(state.slope[i]))
        state.slope[i] = change / interval if interval > 0.0 else 0.0
        state.torque[i] = torque[i]


@njit
def _anchor(params: np.record, state: np.record) -> None:
    """Angles from the readings without their fault estimates, rates as measured."""
    x, y, angle = state.x, state.y_new, params.joints.angle
    for i in range(2):
        x[i] = row_dot(angle, i, y[0] - x[4], y[1] - x[5])
        x[2 + i] = state.v_new[i]


@njit
def _see_faults(params: np.record, state: np.record, y: np.ndarray) -> None:
    """f^ = y_p - S theta^."""
    for i in range(2):
        state.x[4 + i] = y[i] - row_dot(params.joints.sensor, i, state.x[0], state.x[1])


@njit
def _is_unsupported(params: np.record, state: np.record) -> bool:
    """Whether the arm rests although the measured torques do not hold it."""
    # The torque of brakes is often not measured: zero at rest would mean that links are vertical.
    x, y, arm = state.x, state.y_new, params.arm
    if not _is_at_rest(params, y):
        state.unsupported = 0
        return False
    needed = beyond = measured = 0.0
    for i in range(2):
        gravity = abs(arm.gravity[i] * math.sin(x[i]))
        needed = max(needed, gravity)
        tolerated = params.torque_tolerance[i] + SMALL * arm.gravity[i]
        beyond = max(beyond, gravity - tolerated)
        measured = max(measured, abs(state.torque[i]))
    if beyond > 0.0 and measured <= _SUPPORTED * needed:
        state.unsupported += 1
    else:
        state.unsupported = 0
    return state.unsupported >= params.rest_samples


@njit
def _is_at_rest(params: np.record, y: np.ndarray) -> bool:
    return abs(y[2]) <= params.rest_rate and abs(y[3]) <= params.rest_rate


@njit
def _note_stop(params: np.record, state: np.record, interval: float) -> None:
    """Whether the arm was braked, of method ``exact``: missing momentum is no wrong angle."""
    stopping, x, y = state.stopping, state.x, state.y_new
    if not _is_at_rest(params, y):
        # It starts from rest: rate sensors that had read nothing for a moment would jump back.
        starts = max(abs(y[2]), abs(y[3])) < 0.5 * stopping.rate
        stopping.kind = _BRAKED if stopping.kind == _SUDDEN and starts else _MOVING
    elif stopping.kind == _MOVING:
        stopping.rate = stopping.lasted = 0.0
        for i in range(2):
            stopping.rate = max(stopping.rate, abs(x[2 + i] - state.v_new[i]))
            stopping.angle[i], stopping.reading[i] = x[i], y[i]
        stopping.kind = _SUDDEN if stopping.rate > params.rest_rate else _RESTING
    elif stopping.kind == _SUDDEN:
        stopping.lasted += interval
        moved = max(abs(y[0] - stopping.reading[0]), abs(y[1] - stopping.reading[1]))
        if moved > params.still:
            stopping.kind = _RESTING
        elif stopping.rate * stopping.lasted > 2.0 * params.still:
            stopping.kind = _BRAKED
    else:
        stopping.kind = _RESTING


@njit
def _hold(params: np.record, state: np.record, interval: float) -> None:
    """Dead reckoning of both links: angles go on by the measured rates."""
    y = state.y
    for i in range(2):
        before, rate = row_dot(params.joints.angle, i, y[2], y[3]), state.v_new[i]
        state.x[i] += 0.5 * interval * (before + rate)
        state.x[2 + i], state.held[i] = rate, True
    _see_faults(params, state, state.y_new)


@njit
def advance(params: np.record, state: np.record, dt: float) -> None:
    """Advance x^ = z + T2 y of eq. (38) over one step [s] by the Heun rule.

    Outputs go from ``y`` to ``after``; torques are held over the step.  ``bend`` receives at least
    how much theta'' has changed.
    """
    x, start, rate = state.x, state.start, state.rate
    for i in range(6):
        start[i] = x[i]
        for j in range(4):
            start[i] += params.t2[i, j] * (state.after[j] - state.y[j])
    for end in range(2):
        y = state.y if end == 0 else state.after
        if params.is_exact:
            exact_rate(params, state, y, end)
        else:
            paper_rate(params, state, y, end)
        for i in range(6):
            x[i] = start[i] + dt * (rate[0, i] if end == 0 else 0.5 * (rate[0, i] + rate[1, i]))
    if params.is_exact:
        for i in range(2):
            state.bend[i] = max(state.bend[i], abs(state.model[1, i] - state.model[0, i]))
        _see_faults(params, state, state.after)


@njit
def _advance(params: np.record, state: np.record, interval: float) -> None:
    """Advance in steps of a sample time; outputs are interpolated."""
    state.held[:] = False
    steps = max(1, math.ceil(interval / (1.5 * params.sample_time)))
    for left in range(steps, 0, -1):
        for i in range(4):
            share = (state.y_new[i] - state.y[i]) / left
            state.after[i] = state.y_new[i] if left == 1 else state.y[i] + share
        advance(params, state, interval / steps)
        copy_vector(state.after, state.y)


@njit
def _fill(params: np.record, state: np.record) -> None:
    x, joints, rate = state.x, params.joints, state.v_new
    if state.started <= params.initial_samples:
        state.mode = _INITIALISING
    else:
        state.mode = _HOLDING if state.held[0] or state.held[1] else _OBSERVING
    for i in range(2):
        state.position[i] = row_dot(joints.j, i, x[0], x[1])
        state.velocity[i] = row_dot(joints.j, i, x[2], x[3])
        state.innovation[i] = x[2 + i] - rate[i]
    state.position[0] -= joints.zero
    set_pose(state.pose, x)
    acc = acceleration(state.pose, rate, state.torque, params.arm)
    state.acceleration[0], state.acceleration[1] = acc
