"""The observer as nodes and replay use it: joint-space samples in, estimates out.

All bad input ends here, in a stated degraded mode: see :func:`observe`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.model.dynamics import acceleration
from lpv_core.model.joints import joint_angle, row_dot
from lpv_core.observer.observer_step import (
    RECURSION_CONSTANTS,
    RECURSION_STATE,
    advance,
    recursion,
    set_state,
)
from lpv_core.support.errors import SampleError
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_LARGEST_ANGLE = 1e4
"""A position sensor that reads more [rad] is taken as missing; floats lose microradians there."""
_AT_REST = 5.0
"""Rates below so many standard deviations of their noise are those of an arm at rest."""
_SUPPORTED = 0.02
"""At rest, torques below that part of what gravity needs are not those that hold the arm."""
_NEARLY_VERTICAL = 0.05
"""A link within this angle of the vertical needs no torque [rad]."""
_REST = 0.02
"""An arm is held by something that is not measured if it seems so for this long [s]."""
_STILL = 4.0 * math.sqrt(2.0)
"""Readings that differ by less, in standard deviations of their noise, have not moved."""
_EFFORT_MARGIN = 10.0
"""A torque so many times above the arm's limit is no torque of this arm."""


class Mode(IntEnum):
    """What the last estimate rests on; values as in lpv_msgs/StateEstimate."""

    OBSERVING = 0
    HOLDING = 1
    INITIALISING = 2
    STALE = 3
    NO_ESTIMATE = 4


_OBSERVING, _HOLDING, _INITIALISING = (int(m) for m in Mode if m <= Mode.INITIALISING)


@dataclass
class Counters:
    """How many samples were not usable as they came."""

    duplicates: int = 0  # samples with the stamp of the one before
    out_of_order: int = 0  # samples with an older stamp
    restarts: int = 0  # the clock was set back
    not_finite: int = 0  # NaN or infinite values
    implausible: int = 0  # values that no arm of this kind can have
    gaps: int = 0  # intervals longer than the limit
    late_steps: int = 0  # intervals of several sample times (lost samples) that were bridged


COUNTERS = record_type(*((name, 'i8') for name in Counters.__dataclass_fields__))


class Stop(IntEnum):
    """What is known of an arm that came to rest faster than measured torques explain.

    It was braked, or its rate sensors read nothing while it moves on: its position sensors tell
    which, once an arm that moves on would have moved by twice their noise.
    """

    NONE = 0
    RESTING = 1
    SUDDEN = 2  # not known yet
    BRAKED = 3  # found at this sample


_NONE, _RESTING, _SUDDEN, _BRAKED = (int(s) for s in Stop)

STOP_STATE = record_type(
    ('stop', 'u1'),  # of `Stop`
    ('lasted', 'f8'),  # since the arm came to rest [s]
    ('rate', 'f8'),  # by which the estimate was faster then [rad/s]
    ('angle', 'f8', (2,)),  # theta^ then [rad]
    ('reading', 'f8', (2,)),  # of the position sensors then [rad]
)

OBSERVER_CONSTANTS = record_type(
    ('recursion', RECURSION_CONSTANTS),
    ('sample_time', 'f8'),  # [s]
    ('max_gap', 'f8'),  # longest interval that is integrated [s]
    ('initial_samples', 'i8'),  # samples that the start value is averaged over
    ('velocity_limit', 'f8', (2,)),  # of the joints [rad/s]
    ('effort_limit', 'f8', (2,)),  # of the joints [N m]
    ('rest_rate', 'f8'),  # rates of an arm at rest stay below [rad/s]
    ('rest_samples', 'i8'),  # at rest without torque, after which it is held by something else
    ('torque_tolerance', 'f8', (2,)),  # generalised torques at rest that the model may miss [N m]
    ('still', 'f8'),  # largest change of a reading at rest [rad]
)
OBSERVER_STATE = record_type(
    ('recursion', RECURSION_STATE),
    ('stamp', 'i8'),  # of the last sample [ns]
    ('started', 'i8'),  # samples since the start
    ('unsupported', 'i8'),  # samples at rest without the torque that gravity needs
    ('stopping', STOP_STATE),
    ('counters', COUNTERS),
    # Outputs in sensor coordinates, positions [rad] and rates [rad/s]:
    ('y', 'f8', (4,)),  # of the last sample
    ('y_new', 'f8', (4,)),  # of this sample
    ('before', 'f8', (4,)),  # at the start of a part of the interval
    ('after', 'f8', (4,)),  # and at its end
    ('torque', 'f8', (2,)),  # generalised torques Q over the interval [N m]
)

ESTIMATE = record_type(
    ('stamp', 'i8'),  # time of the measurement [ns]
    ('interval', 'f8'),  # since the previous estimate [s]
    ('mode', 'u1'),  # of `Mode`
    # ROS joint coordinates:
    ('position', 'f8', (2,)),  # estimated [rad]
    ('velocity', 'f8', (2,)),  # estimated [rad/s]
    ('measured_position', 'f8', (2,)),  # [rad]
    ('measured_velocity', 'f8', (2,)),  # [rad/s]
    # Physical position sensors:
    ('fault', 'f8', (2,)),  # f^ [rad]
    ('sensor_position', 'f8', (2,)),  # readings [rad]
    ('missing', 'u1', (2,)),  # no finite value: the reading is carried on by its rate
    # Absolute coordinates, by link:
    ('absolute_position', 'f8', (2,)),  # theta^ [rad]
    ('absolute_velocity', 'f8', (2,)),  # measured theta' [rad/s]
    ('absolute_acceleration', 'f8', (2,)),  # theta'' of the model at the estimate [rad/s2]
    ('innovation', 'f8', (2,)),  # estimated minus measured theta' [rad/s]
    ('held', 'u1', (2,)),  # the configuration carries no gravity information: dead reckoning
    ('unsupported', '?'),  # at rest, and not held by the measured torques: brakes, for example
    ('stop', 'u1'),  # of `Stop`
    ('bridged', '?'),  # the interval was too long: angles went on by the encoders' increments
)
"""One estimate."""


def observer_constants(
    arm: ArmParameters, gains: Gains, initial_samples: int = 1, max_gap: float = 0.1
) -> np.record:
    """Constants of `observe`, of type `OBSERVER_CONSTANTS`.

    Parameters
    ----------
    arm : ArmParameters
        The arm; its hash must match the gains.
    gains : Gains
        Designed gains.
    initial_samples : int, optional
        Samples over which the start value is averaged.  The observer takes their mean for free of
        faults: a constant bias at the start is only found at the certified decay rate.
    max_gap : float, optional
        Longest interval that is integrated [s]; longer ones re-anchor the estimate on the
        encoder's increment and hold the fault estimate.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """
    gains.check_arm(arm)
    return new_record(
        OBSERVER_CONSTANTS,
        recursion=recursion(arm, gains.observer),
        sample_time=arm.sample_time,
        max_gap=max_gap,
        initial_samples=max(1, int(initial_samples)),
        velocity_limit=arm.velocity_limit,
        effort_limit=_EFFORT_MARGIN * np.asarray(arm.torque_limit),
        rest_rate=_AT_REST * arm.velocity_noise,
        rest_samples=max(5, math.ceil(_REST / arm.sample_time)),
        torque_tolerance=np.asarray(arm.torque_tolerance) + sum(arm.coulomb),
        still=_STILL * arm.position_noise,
    )


@njit
def reset_observer(state: np.record) -> None:
    """Forget everything but the counters; the observer restarts with the next sample."""
    state.stamp, state.started, state.unsupported = NEVER, 0, 0
    state.stopping.stop = _NONE
    state.recursion.held[:] = False
    state.y[:] = 0.0


@njit
def observe(
    params: np.record,
    state: np.record,
    estimate: np.record,
    stamp: int,
    position: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
) -> bool:
    """Sampled unknown-input observer, eqs. (38)-(53): one measurement into ``estimate``.

    Degraded modes: a duplicate or older stamp is dropped and counted; a stamp more than 1 s back
    means that the clock was set back: the observer restarts; a position that is not finite, or
    absurd, is carried on by the rates of that sensor (the state estimate does not need it); a
    velocity or effort that is not finite, or beyond what the arm can do, drops the sample; an
    interval above ``max_gap`` re-anchors the estimate; an arm at rest whose measured torques do not
    hold it against gravity is held by something else: nothing is learnt from them; an arm that was
    stopped by a torque that is not measured (brakes) goes on from the angles it had then.

    Parameters
    ----------
    params, state, estimate : numpy.record
        `observer_constants`, state (`OBSERVER_STATE`) and estimate (`ESTIMATE`).
    stamp : int
        Time of measurement [ns].
    position, velocity : ndarray, shape (2,)
        Joint positions [rad] and rates [rad/s] as in ``sensor_msgs/JointState``, in the order of
        the arm file.
    effort : ndarray, shape (2,)
        Joint torques that acted over the interval that ends at ``stamp`` [N m].

    Returns
    -------
    bool
        False if the sample was dropped; ``estimate`` then stays as it was.
    """
    r = state.recursion
    if not _usable(params, state, velocity, effort):
        return False
    interval = _interval(state, stamp)
    if interval < 0.0:
        return False
    missing_1, missing_2 = _outputs(params, state, position, velocity, interval)
    missing = missing_1 or missing_2
    state.torque[0], state.torque[1] = effort[0] - effort[1], effort[1]  # Q = J^T tau
    if state.stamp == NEVER:
        if missing:
            return False  # a start value needs both sensors
        _start(params, state)
    elif interval > params.max_gap:
        state.stopping.stop = _NONE
        _bridge(params, state)
    elif _is_unsupported(params, state, missing):
        state.stopping.stop = _RESTING
        _hold(params, state, interval)
    else:
        _note_stop(params, state, interval, missing)
        _advance(params, state, interval)
        if state.stopping.stop == _BRAKED:
            _take_stop(params, state)
    if state.started < params.initial_samples:
        _average_start(params, state)
    for i in range(6):
        if not math.isfinite(r.x[i]):
            # Can only follow from absurd input (1e300 rad/s); never let it out.
            state.counters.not_finite += 1
            reset_observer(state)
            return False
    state.stamp = stamp
    state.y[:] = state.y_new
    state.started += 1
    estimate.stamp, estimate.interval, estimate.bridged = stamp, interval, interval > params.max_gap
    estimate.missing[0], estimate.missing[1] = missing_1, missing_2
    estimate.unsupported = state.unsupported >= params.rest_samples
    estimate.stop = state.stopping.stop
    _fill(params, state, estimate)
    return True


@njit
def _interval(state: np.record, stamp: int) -> float:
    """Time since the last sample [s]; negative if this one is to be dropped."""
    if state.stamp == NEVER:
        return 0.0
    delta = stamp - state.stamp
    if delta > 0:
        return delta / NANOSECONDS
    if delta < -NANOSECONDS:
        state.counters.restarts += 1
        reset_observer(state)
        return 0.0
    if delta == 0:
        state.counters.duplicates += 1
    else:
        state.counters.out_of_order += 1
    return -1.0


@njit
def _usable(params: np.record, state: np.record, velocity: np.ndarray, effort: np.ndarray) -> bool:
    for i in range(2):
        if not (math.isfinite(velocity[i]) and math.isfinite(effort[i])):
            state.counters.not_finite += 1
            return False
    for i in range(2):
        if abs(velocity[i]) > params.velocity_limit[i] or abs(effort[i]) > params.effort_limit[i]:
            state.counters.implausible += 1
            return False
    return True


@njit
def _outputs(
    params: np.record, state: np.record, position: np.ndarray, velocity: np.ndarray, interval: float
) -> tuple[bool, bool]:
    """Readings of the sensors into ``y_new``; whether the first and the second one are missing.

    A missing sensor is carried on by its rates: as if its fault stayed what it was.
    """
    y, joints = state.y_new, params.recursion.joints
    for i in range(2):
        y[i] = row_dot(joints.from_joint, i, position[0] + joints.zero, position[1])
        y[2 + i] = row_dot(joints.from_joint, i, velocity[0], velocity[1])
    missing_1, missing_2 = not abs(y[0]) <= _LARGEST_ANGLE, not abs(y[1]) <= _LARGEST_ANGLE
    if missing_1 or missing_2:
        if math.isfinite(y[0]) and math.isfinite(y[1]):
            state.counters.implausible += 1
        else:
            state.counters.not_finite += 1
        half = 0.5 * interval if interval <= params.max_gap else 0.0
        for i in range(2):
            if missing_1 if i == 0 else missing_2:
                y[i] = state.y[i] + half * (state.y[2 + i] + y[2 + i])
    return missing_1, missing_2


@njit
def _average_start(params: np.record, state: np.record) -> None:
    """Move the start value to the mean of the samples so far; their mean fault is zero."""
    r = state.recursion
    share_1, share_2 = r.x[4] / (state.started + 1), r.x[5] / (state.started + 1)
    for i in range(2):
        r.x[i] += row_dot(params.recursion.joints.angle, i, share_1, share_2)
    r.x[4] -= share_1
    r.x[5] -= share_2
    set_state(params.recursion, r, state.y_new)


@njit
def _anchor(params: np.record, state: np.record) -> None:
    """Angles from the readings without their fault estimates, rates as measured."""
    r, y, angle = state.recursion, state.y_new, params.recursion.joints.angle
    for i in range(2):
        r.x[i] = row_dot(angle, i, y[0] - r.x[4], y[1] - r.x[5])
        r.x[2 + i] = row_dot(angle, i, y[2], y[3])
    set_state(params.recursion, r, y)


@njit
def _start(params: np.record, state: np.record) -> None:
    state.recursion.x[4:] = 0.0
    _anchor(params, state)
    state.y[:] = state.y_new
    state.started = 0


@njit
def _bridge(params: np.record, state: np.record) -> None:
    """Re-anchor after a gap: the encoder's increment is all that is known of it."""
    state.counters.gaps += 1
    _anchor(params, state)


@njit
def _is_unsupported(params: np.record, state: np.record, missing: bool) -> bool:
    """Whether the arm rests although the measured torques do not hold it.

    The torque of brakes is often not measured.  Taken for what acts on the arm, zero torque at rest
    would mean that both links are vertical.  Where a reading is missing, gravity alone says where
    the arm is.
    """
    x, y, arm = state.recursion.x, state.y_new, params.recursion.arm
    needed = beyond = measured = 0.0
    for i in range(2):
        gravity = abs(arm.gravity[i] * math.sin(x[i]))
        needed = max(needed, gravity)
        tolerated = params.torque_tolerance[i] + _NEARLY_VERTICAL * arm.gravity[i]
        beyond = max(beyond, gravity - tolerated)
        measured = max(measured, abs(state.torque[i]))
    if not missing and _is_at_rest(params, y) and beyond > 0.0 and measured <= _SUPPORTED * needed:
        state.unsupported += 1
    else:
        state.unsupported = 0
    return state.unsupported >= params.rest_samples


@njit
def _is_at_rest(params: np.record, y: np.ndarray) -> bool:
    return abs(y[2]) <= params.rest_rate and abs(y[3]) <= params.rest_rate


@njit
def _note_stop(params: np.record, state: np.record, interval: float, missing: bool) -> None:
    """Whether the arm was braked, see `Stop`; method ``exact`` only.

    Brakes take the momentum away with a torque that nobody measures.  The observer would explain
    what is missing by gravity, and so by a wrong angle.
    """
    stopping, x, y = state.stopping, state.recursion.x, state.y_new
    if missing or not params.recursion.is_exact:
        stopping.stop = _NONE
    elif not _is_at_rest(params, y):
        # It starts from rest: rate sensors that had read nothing for a moment would jump back.
        starts = max(abs(y[2]), abs(y[3])) < 0.5 * stopping.rate
        stopping.stop = _BRAKED if stopping.stop == _SUDDEN and starts else _NONE
    elif stopping.stop == _NONE:
        stopping.rate = stopping.lasted = 0.0
        for i in range(2):
            rate = row_dot(params.recursion.joints.angle, i, y[2], y[3])
            stopping.rate = max(stopping.rate, abs(x[2 + i] - rate))
            stopping.angle[i], stopping.reading[i] = x[i], y[i]
        stopping.stop = _SUDDEN if stopping.rate > params.rest_rate else _RESTING
    elif stopping.stop == _SUDDEN:
        stopping.lasted += interval
        moved = max(abs(y[0] - stopping.reading[0]), abs(y[1] - stopping.reading[1]))
        if moved > params.still:
            stopping.stop = _RESTING
        elif stopping.rate * stopping.lasted > 2.0 * params.still:
            stopping.stop = _BRAKED
    else:
        stopping.stop = _RESTING


@njit
def _take_stop(params: np.record, state: np.record) -> None:
    """The arm is where it was stopped: undo what was learnt from the missing momentum."""
    r, y, joints = state.recursion, state.y_new, params.recursion.joints
    for i in range(2):
        r.x[i] = state.stopping.angle[i]
        r.x[2 + i] = row_dot(joints.angle, i, y[2], y[3])
    for i in range(2):
        r.x[4 + i] = y[i] - row_dot(joints.sensor, i, r.x[0], r.x[1])


@njit
def _hold(params: np.record, state: np.record, interval: float) -> None:
    """Dead reckoning of both links: angles go on by the measured rates."""
    r, joints = state.recursion, params.recursion.joints
    for i in range(2):
        before = row_dot(joints.angle, i, state.y[2], state.y[3])
        rate = row_dot(joints.angle, i, state.y_new[2], state.y_new[3])
        r.x[i] += 0.5 * interval * (before + rate)
        r.x[2 + i], r.held[i] = rate, True
    for i in range(2):
        r.x[4 + i] = state.y_new[i] - row_dot(joints.sensor, i, r.x[0], r.x[1])
    set_state(params.recursion, r, state.y_new)


@njit
def _advance(params: np.record, state: np.record, interval: float) -> None:
    state.recursion.held[:] = False
    steps = max(1, math.ceil(interval / (1.5 * params.sample_time)))
    if steps == 1:
        advance(params.recursion, state.recursion, state.y, state.y_new, state.torque, interval)
        return
    state.counters.late_steps += 1
    state.before[:] = state.y
    for k in range(1, steps + 1):
        for i in range(4):
            share = (state.y_new[i] - state.y[i]) / steps
            state.after[i] = state.y_new[i] if k == steps else state.before[i] + share
        part = interval / steps
        advance(params.recursion, state.recursion, state.before, state.after, state.torque, part)
        state.before[:] = state.after


@njit
def _fill(params: np.record, state: np.record, estimate: np.record) -> None:
    r, y, joints = state.recursion, state.y_new, params.recursion.joints
    if state.started <= params.initial_samples:
        estimate.mode = _INITIALISING
    else:
        estimate.mode = _HOLDING if r.held[0] or r.held[1] else _OBSERVING
    for i in range(2):
        estimate.position[i] = joint_angle(joints, joints.j, i, r.x[0], r.x[1])
        estimate.velocity[i] = row_dot(joints.j, i, r.x[2], r.x[3])
        estimate.measured_position[i] = joint_angle(joints, joints.to_joint, i, y[0], y[1])
        estimate.measured_velocity[i] = row_dot(joints.to_joint, i, y[2], y[3])
        estimate.fault[i], estimate.absolute_position[i] = r.x[4 + i], r.x[i]
        estimate.sensor_position[i], estimate.held[i] = y[i], r.held[i]
        estimate.absolute_velocity[i] = row_dot(joints.angle, i, y[2], y[3])
        estimate.innovation[i] = r.x[2 + i] - estimate.absolute_velocity[i]
    estimate.absolute_acceleration[0], estimate.absolute_acceleration[1] = acceleration(
        r.x[0],
        r.x[1],
        estimate.absolute_velocity[0],
        estimate.absolute_velocity[1],
        state.torque[0],
        state.torque[1],
        params.recursion.arm,
    )


def counters(record: np.record) -> Counters:
    """Plain numbers of a record of type `COUNTERS`."""
    return Counters(*record.tolist())


def pair(values: Sequence[float], name: str) -> np.ndarray:
    """Two numbers as an array; SampleError with the given name if there are not two."""
    array = np.ascontiguousarray(values, dtype=float)
    if array.shape != (2,):
        raise SampleError(f'{name} must have 2 values, one a joint, got shape {array.shape}')
    return array
