"""Watchdogs of the tracking loop: when the tracker must stop the arm, and when its drives must.

The tracker judges estimates and its own tracking error; the drives judge the commands and the speed
of their joints.  Each ends in a safe stop, brakes engaged, within the time that its limit states.
The nodes and the closed-loop simulation run the same functions.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from lpv.core.control.estimate_check import REST_SHARE, position_noise
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.records import memory, new_record, record_type
from lpv.core.support.timestamps import NANOSECONDS, NEVER

_STALE, _NO_ESTIMATE = int(Mode.STALE), int(Mode.NO_ESTIMATE)


class _Reason(IntEnum):
    """Reasons with their texts."""

    text: str

    def __new__(cls, number: int, text: str) -> '_Reason':
        reason = int.__new__(cls, number)
        reason._value_, reason.text = number, text
        return reason


class StopReason(_Reason):
    """Why the tracker stops the arm."""

    NONE = 0, ''
    SILENCE = 1, 'no estimates'
    LATENCY = 2, 'estimates come too late'
    NOT_TRUSTWORTHY = 3, 'the estimate is not trustworthy'
    UNUSABLE = 4, 'measurements cannot be used'
    NOT_FOLLOWING = 5, 'the arm does not follow: commands do not reach it, or it is braked'
    # Latched until reset, as the next and the last.
    OVERSPEED = 6, 'overspeed: a joint is faster than max_speed allows'
    TRACKING_ERROR = (7, 'deviation: a joint is further from its reference than max_tracking_error')
    MOVING = 8, 'the arm is still moving: it starts from rest'
    CORRECTION_LOST = 9, 'a confirmed fault was forgotten while no estimates came'


_NONE, _SILENCE, _LATENCY, _NOT_TRUSTWORTHY, _UNUSABLE, _NOT_FOLLOWING, _OVERSPEED, _ERROR = (
    int(reason) for reason in tuple(StopReason)[:8]
)
_MOVING = int(StopReason.MOVING)


class BrakeReason(_Reason):
    """Why the drives brake."""

    NONE = 0, ''
    NO_COMMAND = 1, 'no command'
    SAFE_STOP = 2, 'safe stop'
    LATE = 3, 'commands stay away'
    LATENCY = 4, 'commands are late on average'
    # Latched until the brakes are released by an operator.
    OVERSPEED = 5, 'a joint is faster than its velocity limit'


_BRAKE_SAFE_STOP, _BRAKE_LATE, _BRAKE_LATENCY, _BRAKE_OVERSPEED = (
    int(reason) for reason in tuple(BrakeReason)[2:]
)


_MEAN_SHARE = 0.9
"""Largest mean latency over the constant latency with which the loop is stable: what is slower than
the sampling is seen by the mean only after it has happened."""
_SINGLE_SHARE = 4.0
"""Largest single latency over the same.  It lasts once: where it repeats, the mean grows."""


@dataclass(frozen=True)
class LatencyLimits:
    """What tracker and drives tolerate from a measurement to the command that answers it."""

    single: float  # once [s]
    mean: float  # on average over `MAX_GAP` [s]


def latency_limits(tolerated: float) -> LatencyLimits:
    """Limits for a loop that is stable with constant latencies up to ``tolerated`` [s].

    See `lpv.core.control.tracking.loop_latency`.
    """
    single = min(_SINGLE_SHARE * tolerated, MAX_GAP)
    return LatencyLimits(single, min(_MEAN_SHARE * tolerated, single))


def mean_limit(single: float) -> float:
    """Limit of the mean that belongs to a limit of single latencies [s]."""
    return single * _MEAN_SHARE / _SINGLE_SHARE


UNKNOWN_LOOP = latency_limits(0.013)
"""Of drives that know no gains: below what the loops of all shipped gains tolerate."""


@dataclass(frozen=True)
class TrackerLimits:
    """What the tracker tolerates."""

    silence: float = UNKNOWN_LOOP.single  # between estimates [s]
    latency: LatencyLimits = UNKNOWN_LOOP
    unusable: float = 0.05  # without a usable measurement [s]
    overspeed: float = 0.02  # above the allowed speed [s]
    speed: float = 0.7  # allowed share of the velocity limit
    tracking_error: float = 0.5  # of a joint [rad]
    error_time: float = unusable  # with a larger one [s]


_SHORTEST_STOP = round(2.0 * MAX_GAP * NANOSECONDS)
"""How long latencies must be in time before tracker and drives go on by themselves, two time
constants of the mean [ns]."""
_ARM_MOVED = 0.003, 0.01
"""Motion of an arm that follows [rad]: above the noise of its readings, at least and at most."""
_REFERENCE_MOVED = 2.0, 3.0
"""Motion of the reference with the arm at rest from which the arm is not following, over the above:
before its first motion after a start, and later, when friction and faults may hold it back.  An arm
that is released from brakes leaps by as much, and the more the further its reference went."""


def tracker_watchdog_type(joints: int) -> np.dtype:
    """Record type of the tracker's watchdog."""
    return record_type(
        ('silence', 'i8'),  # limits, see `TrackerLimits` [ns]
        ('latency', 'i8'),
        ('unusable', 'i8'),
        ('overspeed', 'i8'),
        ('error_time', 'i8'),
        ('mean_latency', 'f8'),  # [ns]
        ('tracking_error', 'f8'),  # [rad]
        ('speed_limit', 'f8', (joints,)),  # share of the arm file's velocity limit [rad/s]
        ('rest', 'f8', (joints,)),  # rate below which a joint rests [rad/s]
        ('scale', 'f8', (joints,)),  # what counts as 1 rad, see `SerialJoint.scale` [rad], [m]
        ('share', 'f8'),  # of the newest latency in the mean
        ('mean_age', 'f8'),  # [ns]
        ('late', 'i8'),  # stamp of the last estimate that was late on average, or NEVER
        ('usable', 'i8'),  # stamp of the last usable measurement, or NEVER
        # stamp at which each joint was last not too fast, backwards and forwards, or NEVER
        ('in_speed', 'i8', (2, joints)),
        ('in_reach', 'i8'),  # stamp of the last tracking error within its limit, or NEVER
        ('latched', 'i8'),  # reason that lasts until reset
        ('started', '?'),  # whether there was a reference since the last stop
        ('moved', '?'),  # whether the arm has moved since the last stop
        ('is_read', '?'),  # whether the last estimate is of a usable measurement
        ('step', 'f8', (joints,)),  # smallest motion that is one [rad], [m]
        ('arm', 'f8', (joints,)),  # what the arm's sensors read when it last moved [rad]
        ('fed_back', 'f8', (joints,)),  # position that was fed back then [rad]
        ('travel', 'f8', (joints,)),  # since then, by the rates that are fed back [rad]
        ('reference', 'f8', (joints,)),  # where its reference was then [rad]
    )


def drive_watchdog_type(joints: int) -> np.dtype:
    """Record type of the drives' watchdog."""
    return record_type(
        ('command_age', 'i8'),  # limits, see `DriveWatchdog` [ns]
        ('overspeed', 'i8'),
        ('mean_latency', 'f8'),  # [ns]
        ('velocity_limit', 'f8', (joints,)),  # of the arm file [rad/s]
        ('share', 'f8'),  # of the newest age in the mean
        ('mean_age', 'f8'),  # [ns]
        ('braked', 'i8'),  # time of the last command that was too late, or NEVER
        ('in_speed', 'i8'),  # time at which the joints were last within the speed limits, or NEVER
        ('latched', 'i8'),  # reason that lasts until reset
    )


def _share(arm: SerialArm) -> float:
    return min(1.0, arm.sample_time / MAX_GAP)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


@njit
def check_estimate(
    shared: np.ndarray,
    stamp: int,
    latency: int,
    mode: int,
    trustworthy: bool,
    velocity: np.ndarray,
    measured_velocity: np.ndarray,
) -> int:
    """Judge an estimate before it is answered; returns a `StopReason`.

    ``shared`` is the memory of a `TrackerWatchdog`; ``latency`` is the time from the measurement
    until now, 0 where it is not known [ns].  ``mode`` and what follows are fields of
    lpv_msgs/StateEstimate.
    """
    dog = shared[0]
    dog.is_read = mode != _STALE and mode != _NO_ESTIMATE
    if dog.is_read:
        if dog.usable != NEVER:
            for i in range(velocity.shape[0]):
                dog.travel[i] += velocity[i] * (stamp - dog.usable) / NANOSECONDS
        dog.usable = stamp
        _check_speed(dog, stamp, velocity, measured_velocity)
    if dog.latched != _NONE:
        return dog.latched
    if not trustworthy:
        return _NOT_TRUSTWORTHY
    if dog.usable == NEVER or stamp - dog.usable > dog.unusable:
        return _UNUSABLE
    if _is_late(dog, stamp, latency):
        return _LATENCY
    for i in range(velocity.shape[0]):
        if not (dog.started or abs(measured_velocity[i]) <= dog.rest[i]):
            return _MOVING
    return _NONE


@njit
def _check_speed(
    dog: np.record, stamp: int, velocity: np.ndarray, measured_velocity: np.ndarray
) -> None:
    """Latch overspeed of a joint, estimated or measured, that lasts in one direction.

    The noise of rates that are derived from a faulty encoder changes its sign all the time.
    """
    for i in range(velocity.shape[0]):
        limit, since = dog.speed_limit[i], dog.in_speed
        # So that NaN is too fast.
        if velocity[i] <= limit and measured_velocity[i] <= limit:
            since[1, i] = stamp
        if velocity[i] >= -limit and measured_velocity[i] >= -limit:
            since[0, i] = stamp
        oldest = min(since[0, i], since[1, i])
        if oldest == NEVER or stamp - oldest > dog.overspeed:
            dog.latched = _OVERSPEED


@njit
def _is_late(dog: np.record, stamp: int, latency: int) -> bool:
    """Whether this latency is too long, or the mean is or was shortly before."""
    # As for the drives: an outage ends with the first estimate that is in time.
    # A clock that is ahead makes latencies negative; none may hide later ones.
    dog.mean_age += dog.share * (min(max(latency, 0), dog.latency) - dog.mean_age)
    if dog.mean_age > dog.mean_latency:
        dog.late = stamp
    if dog.late != NEVER and stamp - dog.late < _SHORTEST_STOP:
        return True
    dog.late = NEVER
    return latency > dog.latency


@njit
def check_motion(
    shared: np.ndarray,
    stamp: int,
    reference: np.ndarray,
    position: np.ndarray,
    measured: np.ndarray,
) -> int:
    """Judge the tracking error before a command is given; returns a `StopReason`.

    ``position`` is fed back, ``measured`` what sensors read [rad]: the end of a correction moves
    the one, and no arm.  A joint whose frozen reading is corrected moves by position and rate that
    are fed back; of an arm that is not read nothing is known.
    """
    dog, error, moved, led = shared[0], 0.0, 0.0, 0.0
    if not dog.started:
        dog.started, dog.moved, dog.in_reach = True, False, stamp
        _set_place(dog, reference, position, measured)
    for i in range(position.shape[0]):
        error = max(error, abs(reference[i] - position[i]) / dog.scale[i])
        corrected = min(abs(position[i] - dog.fed_back[i]), abs(dog.travel[i]))
        way = max(abs(measured[i] - dog.arm[i]), corrected)
        moved = max(moved, way / dog.step[i])
        led = max(led, abs(reference[i] - dog.reference[i]) / dog.step[i])
    if error <= dog.tracking_error:
        dog.in_reach = stamp
    elif stamp - dog.in_reach > dog.error_time:
        dog.latched = _ERROR
        return _ERROR
    if moved > 1.0:
        dog.moved = True
        _set_place(dog, reference, position, measured)
    elif dog.is_read and led > _REFERENCE_MOVED[1 if dog.moved else 0]:
        return _NOT_FOLLOWING
    return _NONE


@njit
def _set_place(
    dog: np.record, reference: np.ndarray, position: np.ndarray, measured: np.ndarray
) -> None:
    for i in range(measured.shape[0]):
        dog.arm[i], dog.reference[i] = measured[i], reference[i]
        dog.fed_back[i], dog.travel[i] = position[i], 0.0


@njit
def check_drive(
    shared: np.ndarray, now: int, age: int, safe_stop: bool, velocity: np.ndarray
) -> int:
    """Judge a command before it acts over a sample; returns a `BrakeReason`.

    ``shared`` is the memory of a `DriveWatchdog`; ``age`` is that of the measurement that the
    command answers, 0 in lockstep [ns].  ``safe_stop`` is whether the command asks for the brakes,
    ``velocity`` the joint rates as the motors' own sensors read them [rad/s].
    """
    dog = shared[0]
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
    if dog.braked != NEVER and now - dog.braked < _SHORTEST_STOP:
        return _BRAKE_LATENCY
    dog.braked = NEVER
    return _NONE


@njit
def _is_too_fast(velocity: np.ndarray, limit: np.ndarray) -> bool:
    fast = False
    for i in range(velocity.shape[0]):
        fast = fast or not abs(velocity[i]) <= limit[i]  # so that NaN is too fast
    return fast


class _Watchdog:
    """What both watchdogs have: the memory of a record for compiled functions, what is latched."""

    def __init__(self, record: np.record) -> None:
        self.memory = memory(record)

    @property
    def latched(self) -> int:
        """Reason that lasts until it is set to 0."""
        return int(self.memory['latched'][0])

    @latched.setter
    def latched(self, reason: int) -> None:
        self.memory['latched'] = reason


class TrackerWatchdog(_Watchdog):
    """The tracker's watchdog; ``silence`` is the longest interval between estimates [ns]."""

    def __init__(self, arm: SerialArm, limits: TrackerLimits) -> None:
        record = new_record(
            tracker_watchdog_type(len(arm.joint_names)),
            silence=_nanoseconds(limits.silence),
            latency=_nanoseconds(limits.latency.single),
            mean_latency=_nanoseconds(limits.latency.mean),
            unusable=_nanoseconds(limits.unusable),
            overspeed=_nanoseconds(limits.overspeed),
            error_time=_nanoseconds(limits.error_time),
            tracking_error=limits.tracking_error,
            speed_limit=limits.speed * np.array(arm.velocity_limit),
            rest=REST_SHARE * np.array(arm.velocity_limit),
            scale=arm.scales(),
            step=np.clip(2.0 * position_noise(arm), *np.outer(_ARM_MOVED, arm.scales())),
            is_read=True,
            share=_share(arm),
            late=NEVER,
            usable=NEVER,
            in_speed=NEVER,
            in_reach=NEVER,
        )
        super().__init__(record)
        self.silence = _nanoseconds(limits.silence)

    def check_estimate(self, *estimate: Any) -> StopReason:
        """As the function `check_estimate`."""
        return _STOP_REASONS[check_estimate(self.memory, *estimate)]

    def check_motion(self, *motion: Any) -> StopReason:
        """As the function `check_motion`."""
        return _STOP_REASONS[check_motion(self.memory, *motion)]

    def note_stop(self) -> None:
        """The tracker has stopped the arm: the next reference is a start."""
        self.memory['started'] = False


class DriveWatchdog(_Watchdog):
    """The drives' watchdog, sample by sample.

    ``latency`` is tolerated from a measurement to the end of its command's effect; ``command_age``
    is the greatest age of the measurement that was answered last [ns].
    """

    def __init__(self, arm: SerialArm, latency: LatencyLimits = UNKNOWN_LOOP) -> None:
        record = new_record(
            drive_watchdog_type(len(arm.joint_names)),
            command_age=_nanoseconds(latency.single),
            overspeed=_nanoseconds(TrackerLimits.overspeed),
            mean_latency=_nanoseconds(latency.mean),
            velocity_limit=arm.velocity_limit,
            share=_share(arm),
            in_speed=NEVER,
            braked=NEVER,
        )
        super().__init__(record)
        self.command_age = _nanoseconds(latency.single)

    def check(self, now: int, age: int, safe_stop: bool, velocity: np.ndarray) -> BrakeReason:
        """As the function `check_drive`."""
        return _BRAKE_REASONS[check_drive(self.memory, now, age, safe_stop, velocity)]


_STOP_REASONS, _BRAKE_REASONS = tuple(StopReason), tuple(BrakeReason)
"""By number: quicker than to make them."""
