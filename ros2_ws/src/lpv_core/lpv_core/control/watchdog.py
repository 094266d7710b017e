"""Watchdogs of the tracking loop: when the tracker must stop the arm, and when its drives must.

The tracker judges estimates and its own tracking error; the drives judge the commands and the speed
of their joints.  Each ends in a safe stop, brakes engaged, within the time that its limit states.
The nodes and the closed-loop simulation run the same functions.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.observer.sampled_observer import Mode
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_STALE, _NO_ESTIMATE = int(Mode.STALE), int(Mode.NO_ESTIMATE)


class StopReason(IntEnum):
    """Why the tracker stops the arm; see `STOP_TEXT`."""

    NONE = 0
    SILENCE = 1
    LATENCY = 2
    NOT_TRUSTWORTHY = 3
    UNUSABLE = 4
    NOT_FOLLOWING = 5
    OVERSPEED = 6  # from here on: latched until reset
    TRACKING_ERROR = 7


STOP_TEXT = {
    StopReason.NONE: '',
    StopReason.SILENCE: 'no estimates',
    StopReason.LATENCY: 'estimates come too late',
    StopReason.NOT_TRUSTWORTHY: 'the estimate is not trustworthy',
    StopReason.UNUSABLE: 'measurements cannot be used',
    StopReason.NOT_FOLLOWING: 'the arm does not follow: commands do not reach it, or it is braked',
    StopReason.OVERSPEED: 'a joint is faster than its velocity limit',
    StopReason.TRACKING_ERROR: 'the arm is further from its reference than the model explains',
}
_NONE, _SILENCE, _LATENCY, _NOT_TRUSTWORTHY, _UNUSABLE, _NOT_FOLLOWING, _OVERSPEED, _ERROR = (
    int(reason) for reason in StopReason
)


class BrakeReason(IntEnum):
    """Why the drives brake; see `BRAKE_TEXT`."""

    NONE = 0
    NO_COMMAND = 1
    SAFE_STOP = 2
    LATE = 3
    LATENCY = 4
    OVERSPEED = 5  # latched until the brakes are released by an operator


BRAKE_TEXT = {
    BrakeReason.NONE: '',
    BrakeReason.NO_COMMAND: 'no command',
    BrakeReason.SAFE_STOP: 'safe stop',
    BrakeReason.LATE: 'commands stay away',
    BrakeReason.LATENCY: 'commands are late on average',
    BrakeReason.OVERSPEED: 'a joint is faster than its velocity limit',
}
_BRAKE_SAFE_STOP, _BRAKE_LATE, _BRAKE_LATENCY, _BRAKE_OVERSPEED = (
    int(BrakeReason.SAFE_STOP),
    int(BrakeReason.LATE),
    int(BrakeReason.LATENCY),
    int(BrakeReason.OVERSPEED),
)


@dataclass(frozen=True)
class TrackerLimits:
    """What the tracker tolerates."""

    silence: float = 0.06  # between estimates [s]
    latency: float = 0.06  # from a measurement to its command [s]
    unusable: float = 0.05  # without a usable measurement [s]
    overspeed: float = 0.02  # above the velocity limit [s]
    tracking_error: float = 0.5  # of a joint [rad]
    error_time: float = 0.05  # with a larger one [s]


@dataclass(frozen=True)
class DriveLimits:
    """What the drives tolerate."""

    command_age: float = 0.06  # from a measurement to the end of its command's effect [s]
    mean_latency: float = 0.012  # mean age of commands when they act, over `_MEAN_TIME` [s]
    overspeed: float = 0.02  # above the velocity limit [s]


_MEAN_TIME = 0.1
"""Time constant of the mean age of commands [s]."""
_SHORTEST_BRAKE = 200_000_000
"""How long commands must be in time before the drives go on by themselves [ns]."""
_ARM_MOVED = 0.01
"""Motion of an arm that follows: above the noise of estimates [rad]."""
_REFERENCE_MOVED = 0.02, 0.03
"""Motion of the reference with the arm at rest from which the arm is not following [rad]: before
its first motion after a start, and later, when friction and faults may hold it back."""


def tracker_watchdog_type(joints: int) -> np.dtype:
    """Record type of the tracker's watchdog."""
    return record_type(
        ('silence', 'i8'),  # limits, see `TrackerLimits` [ns]
        ('latency', 'i8'),
        ('unusable', 'i8'),
        ('overspeed', 'i8'),
        ('error_time', 'i8'),
        ('tracking_error', 'f8'),  # [rad]
        ('velocity_limit', 'f8', (joints,)),  # of the arm file [rad/s]
        ('usable', 'i8'),  # stamp of the last usable measurement, or NEVER
        ('in_speed', 'i8'),  # stamp of the last estimate within the speed limits, or NEVER
        ('in_reach', 'i8'),  # stamp of the last tracking error within its limit, or NEVER
        ('latched', 'i8'),  # reason that lasts until reset
        ('started', '?'),  # whether there was a reference since the last stop
        ('moved', '?'),  # whether the arm has moved since the last stop
        ('arm', 'f8', (joints,)),  # where the arm was when it last moved [rad]
        ('reference', 'f8', (joints,)),  # where its reference was then [rad]
    )


def drive_watchdog_type(joints: int) -> np.dtype:
    """Record type of the drives' watchdog."""
    return record_type(
        ('command_age', 'i8'),  # limits, see `DriveLimits` [ns]
        ('overspeed', 'i8'),
        ('mean_latency', 'f8'),  # [ns]
        ('velocity_limit', 'f8', (joints,)),  # of the arm file [rad/s]
        ('share', 'f8'),  # of the newest age in the mean
        ('mean_age', 'f8'),  # [ns]
        ('braked', 'i8'),  # time of the last command that was too late, or NEVER
        ('in_speed', 'i8'),  # time at which the joints were last within the speed limits, or NEVER
        ('latched', 'i8'),  # reason that lasts until reset
    )


def tracker_watchdog(arm: Arm, limits: TrackerLimits) -> np.record:
    """Watchdog of the tracker of an arm, see `tracker_watchdog_type`."""
    return new_record(
        tracker_watchdog_type(len(arm.joint_names)),
        silence=_nanoseconds(limits.silence),
        latency=_nanoseconds(limits.latency),
        unusable=_nanoseconds(limits.unusable),
        overspeed=_nanoseconds(limits.overspeed),
        error_time=_nanoseconds(limits.error_time),
        tracking_error=limits.tracking_error,
        velocity_limit=arm.velocity_limit,
        usable=NEVER,
        in_speed=NEVER,
        in_reach=NEVER,
    )


def drive_watchdog(arm: Arm, limits: DriveLimits) -> np.record:
    """Watchdog of the drives of an arm, see `drive_watchdog_type`."""
    return new_record(
        drive_watchdog_type(len(arm.joint_names)),
        command_age=_nanoseconds(limits.command_age),
        overspeed=_nanoseconds(limits.overspeed),
        mean_latency=_nanoseconds(limits.mean_latency),
        velocity_limit=arm.velocity_limit,
        share=min(1.0, arm.sample_time / _MEAN_TIME),
        in_speed=NEVER,
        braked=NEVER,
    )


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


@njit
def check_estimate(
    dog: np.record, stamp: int, latency: int, mode: int, trustworthy: bool, velocity: np.ndarray
) -> int:
    """Judge an estimate before it is answered; returns a `StopReason`.

    Parameters
    ----------
    dog : numpy.record
        Of `tracker_watchdog`.
    stamp, latency : int
        Of the measurement; time from it until now, 0 where it is not known [ns].
    mode, trustworthy, velocity
        Fields of lpv_msgs/StateEstimate.
    """
    if mode != _STALE and mode != _NO_ESTIMATE:
        dog.usable = stamp
        if not _is_too_fast(velocity, dog.velocity_limit):
            dog.in_speed = stamp
        elif dog.in_speed == NEVER or stamp - dog.in_speed > dog.overspeed:
            dog.latched = _OVERSPEED
    if dog.latched != _NONE:
        return dog.latched
    if not trustworthy:
        return _NOT_TRUSTWORTHY
    if dog.usable == NEVER or stamp - dog.usable > dog.unusable:
        return _UNUSABLE
    return _LATENCY if latency > dog.latency else _NONE


@njit
def check_motion(dog: np.record, stamp: int, reference: np.ndarray, position: np.ndarray) -> int:
    """Judge the tracking error [rad] before a command is given; returns a `StopReason`."""
    error = moved = led = 0.0
    if not dog.started:
        dog.started, dog.moved, dog.in_reach = True, False, stamp
        _set_place(dog, reference, position)
    for i in range(position.shape[0]):
        error = max(error, abs(reference[i] - position[i]))
        moved = max(moved, abs(position[i] - dog.arm[i]))
        led = max(led, abs(reference[i] - dog.reference[i]))
    if error <= dog.tracking_error:
        dog.in_reach = stamp
    elif stamp - dog.in_reach > dog.error_time:
        dog.latched = _ERROR
        return _ERROR
    if moved > _ARM_MOVED:
        dog.moved = True
        _set_place(dog, reference, position)
    elif led > _REFERENCE_MOVED[1 if dog.moved else 0]:
        return _NOT_FOLLOWING
    return _NONE


@njit
def _set_place(dog: np.record, reference: np.ndarray, position: np.ndarray) -> None:
    for i in range(position.shape[0]):
        dog.arm[i], dog.reference[i] = position[i], reference[i]


@njit
def note_stop(dog: np.record) -> None:
    """The tracker has stopped the arm: the next reference is a start."""
    dog.started = False


@njit
def check_drive(dog: np.record, now: int, age: int, safe_stop: bool, velocity: np.ndarray) -> int:
    """Judge a command before it acts over a sample; returns a `BrakeReason`.

    Parameters
    ----------
    dog : numpy.record
        Of `drive_watchdog`.
    now, age : int
        Time of the sample; age of the measurement that the command answers, 0 in lockstep [ns].
    safe_stop : bool
        Whether the command asks for the brakes.
    velocity : ndarray, shape (n,)
        Joint rates as the motors' own sensors read them [rad/s].
    """
    # An outage counts as its limit only: it ends with the first fresh command.
    dog.mean_age += dog.share * (min(age, dog.command_age) - dog.mean_age)
    if not _is_too_fast(velocity, dog.velocity_limit):
        dog.in_speed = now
    elif dog.in_speed == NEVER or now - dog.in_speed > dog.overspeed:
        dog.latched = _BRAKE_OVERSPEED
    if dog.latched != _NONE:
        return dog.latched
    if safe_stop:
        dog.braked = NEVER  # the tracker knows, and starts again from where the arm stands
        return _BRAKE_SAFE_STOP
    if age > dog.command_age or dog.mean_age > dog.mean_latency:
        dog.braked = now
        return _BRAKE_LATE if age > dog.command_age else _BRAKE_LATENCY
    if dog.braked != NEVER and now - dog.braked < _SHORTEST_BRAKE:
        return _BRAKE_LATENCY
    dog.braked = NEVER
    return _NONE


@njit
def _is_too_fast(velocity: np.ndarray, limit: np.ndarray) -> bool:
    fast = False
    for i in range(velocity.shape[0]):
        fast = fast or not abs(velocity[i]) <= limit[i]  # so that NaN is too fast
    return fast
