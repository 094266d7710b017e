"""Watchdogs of the tracking loop: when the tracker must stop the arm, and when its drives must.

The tracker judges estimates and its own tracking error; the drives judge the commands and the speed
of their joints.  Each ends in a safe stop, brakes engaged, within the time that its limit states.
The nodes and the closed-loop simulation run the same functions.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from lpv.core.control.estimate_check import REST_SHARE, position_noise
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.support.jit import Entries
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
    speed: float = 0.7  # allowed share of the velocity limit
    tracking_error: float = 0.5  # of a joint [rad]


LONGEST_UNUSABLE, LONGEST_OVERSPEED = round(0.05 * NANOSECONDS), round(0.02 * NANOSECONDS)
"""Time without a usable measurement, after which the last estimate is not trustworthy, or with a
larger tracking error, that the tracker tolerates; time with a joint that is too fast [ns]."""


_SHORTEST_STOP = round(2.0 * MAX_GAP * NANOSECONDS)
"""How long latencies must be in time before tracker and drives go on by themselves, two time
constants of the mean [ns]."""
_ARM_MOVED = 0.003, 0.01
"""Motion of an arm that follows [rad]: above the noise of its readings, at least and at most."""
_REFERENCE_MOVED = 2.0, 3.0
"""Motion of the reference with the arm at rest from which the arm is not following, over the above:
before its first motion after a start, and later, when friction and faults may hold it back.  An arm
that is released from brakes leaps by as much, and the more the further its reference went."""


TRACKER_WATCHDOG = record_type(
    ('silence', 'i8'),  # limits, see `TrackerLimits` [ns]
    ('latency', 'i8'),
    ('mean_latency', 'f8'),  # [ns]
    ('tracking_error', 'f8'),  # [rad]
    ('share', 'f8'),  # of the newest latency in the mean
    ('mean_age', 'f8'),  # [ns]
    ('late', 'i8'),  # stamp of the last estimate that was late on average, or NEVER
    ('usable', 'i8'),  # stamp of the last usable measurement, or NEVER
    ('in_reach', 'i8'),  # stamp of the last tracking error within its limit, or NEVER
    ('latched', 'i8'),  # reason that lasts until reset
    ('started', '?'),  # whether there was a reference since the last stop
    ('moved', '?'),  # whether the arm has moved since the last stop
    ('is_read', '?'),  # whether the last estimate is of a usable measurement
)


class TrackerWatchdogParts(NamedTuple):
    """What the tracker's watchdog works on."""

    own: np.ndarray  # memory of a record of `TRACKER_WATCHDOG`
    # (2, n) stamp at which each joint was last not too fast, backwards and forwards, or NEVER
    in_speed: IntArray
    speed_limit: FloatArray  # (n,) share of the arm file's velocity limit [rad/s]
    rest: FloatArray  # (n,) rate below which a joint rests [rad/s]
    scale: FloatArray  # (n,) what counts as 1 rad, see `SerialJoint.scale` [rad], [m]
    step: FloatArray  # (n,) smallest motion that is one [rad], [m]
    arm: FloatArray  # (n,) what the arm's sensors read when it last moved [rad]
    fed_back: FloatArray  # (n,) position that was fed back then [rad]
    travel: FloatArray  # (n,) since then, by the rates that are fed back [rad]
    reference: FloatArray  # (n,) where its reference was then [rad]


DRIVE_WATCHDOG = record_type(
    ('command_age', 'i8'),  # limits, see `DriveWatchdog` [ns]
    ('mean_latency', 'f8'),  # [ns]
    ('share', 'f8'),  # of the newest age in the mean
    ('mean_age', 'f8'),  # [ns]
    ('braked', 'i8'),  # time of the last command that was too late, or NEVER
    ('in_speed', 'i8'),  # time at which the joints were last within the speed limits, or NEVER
    ('latched', 'i8'),  # reason that lasts until reset
)


class DriveWatchdogParts(NamedTuple):
    """What the drives' watchdog works on."""

    own: np.ndarray  # memory of a record of `DRIVE_WATCHDOG`
    velocity_limit: FloatArray  # (n,) of the arm file [rad/s]


def _share(arm: SerialArm) -> float:
    return min(1.0, arm.sample_time / MAX_GAP)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


@njit
def check_estimate(
    dog: TrackerWatchdogParts,
    stamp: int,
    latency: int,
    mode: int,
    trustworthy: bool,
    velocity: np.ndarray,
    measured_velocity: np.ndarray,
) -> int:
    """Judge an estimate before it is answered; returns a `StopReason`.

    ``latency`` is the time from the measurement until now, 0 where it is not known [ns].  ``mode``
    and what follows are fields of lpv_msgs/StateEstimate.
    """
    own = dog.own[0]
    own.is_read = mode != _STALE and mode != _NO_ESTIMATE
    if own.is_read:
        if own.usable != NEVER:
            for i in range(velocity.shape[0]):
                dog.travel[i] += velocity[i] * (stamp - own.usable) / NANOSECONDS
        own.usable = stamp
        _check_speed(dog, stamp, velocity, measured_velocity)
    if own.latched != _NONE:
        return own.latched
    if not trustworthy:
        return _NOT_TRUSTWORTHY
    if own.usable == NEVER or stamp - own.usable > LONGEST_UNUSABLE:
        return _UNUSABLE
    if _is_late(own, stamp, latency):
        return _LATENCY
    for i in range(velocity.shape[0]):
        if not (own.started or abs(measured_velocity[i]) <= dog.rest[i]):
            return _MOVING
    return _NONE


@njit
def _check_speed(
    dog: TrackerWatchdogParts, stamp: int, velocity: np.ndarray, measured_velocity: np.ndarray
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
        if oldest == NEVER or stamp - oldest > LONGEST_OVERSPEED:
            dog.own[0].latched = _OVERSPEED


@njit
def _is_late(own: np.record, stamp: int, latency: int) -> bool:
    """Whether this latency is too long, or the mean is or was shortly before."""
    # As for the drives: an outage ends with the first estimate that is in time.
    # A clock that is ahead makes latencies negative; none may hide later ones.
    own.mean_age += own.share * (min(max(latency, 0), own.latency) - own.mean_age)
    if own.mean_age > own.mean_latency:
        own.late = stamp
    if own.late != NEVER and stamp - own.late < _SHORTEST_STOP:
        return True
    own.late = NEVER
    return latency > own.latency


@njit
def check_motion(
    dog: TrackerWatchdogParts,
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
    own, error, moved, led = dog.own[0], 0.0, 0.0, 0.0
    if not own.started:
        own.started, own.moved, own.in_reach = True, False, stamp
        _set_place(dog, reference, position, measured)
    for i in range(position.shape[0]):
        error = max(error, abs(reference[i] - position[i]) / dog.scale[i])
        corrected = min(abs(position[i] - dog.fed_back[i]), abs(dog.travel[i]))
        way = max(abs(measured[i] - dog.arm[i]), corrected)
        moved = max(moved, way / dog.step[i])
        ahead = reference[i] - dog.reference[i]
        # An arm that a correction has put before its reference waits until that is there.
        if ahead * (reference[i] - position[i]) > 0.0:
            led = max(led, abs(ahead) / dog.step[i])
    if error <= own.tracking_error:
        own.in_reach = stamp
    elif stamp - own.in_reach > LONGEST_UNUSABLE:
        own.latched = _ERROR
        return _ERROR
    if moved > 1.0:
        own.moved = True
        _set_place(dog, reference, position, measured)
    elif own.is_read and led > _REFERENCE_MOVED[1 if own.moved else 0]:
        return _NOT_FOLLOWING
    return _NONE


@njit
def _set_place(
    dog: TrackerWatchdogParts, reference: np.ndarray, position: np.ndarray, measured: np.ndarray
) -> None:
    for i in range(measured.shape[0]):
        dog.arm[i], dog.reference[i] = measured[i], reference[i]
        dog.fed_back[i], dog.travel[i] = position[i], 0.0


@njit
def check_drive(
    dog: DriveWatchdogParts, now: int, age: int, safe_stop: bool, velocity: np.ndarray
) -> int:
    """Judge a command before it acts over a sample; returns a `BrakeReason`.

    ``age`` is that of the measurement that the command answers, 0 in lockstep [ns].  ``safe_stop``
    is whether the command asks for the brakes, ``velocity`` the joint rates as the motors' own
    sensors read them [rad/s].
    """
    own = dog.own[0]
    # An outage counts as its limit only: it ends with the first fresh command.
    own.mean_age += own.share * (min(age, own.command_age) - own.mean_age)
    if not _is_too_fast(velocity, dog.velocity_limit):
        own.in_speed = now
    elif own.in_speed == NEVER or now - own.in_speed > LONGEST_OVERSPEED:
        own.latched = _BRAKE_OVERSPEED
    if own.latched != _NONE:
        return own.latched
    if safe_stop:
        own.braked = NEVER  # the tracker knows, and starts again from where the arm stands
        return _BRAKE_SAFE_STOP
    if age > own.command_age or own.mean_age > own.mean_latency:
        own.braked = now
        return _BRAKE_LATE if age > own.command_age else _BRAKE_LATENCY
    if own.braked != NEVER and now - own.braked < _SHORTEST_STOP:
        return _BRAKE_LATENCY
    own.braked = NEVER
    return _NONE


@njit
def _is_too_fast(velocity: np.ndarray, limit: np.ndarray) -> bool:
    fast = False
    for i in range(velocity.shape[0]):
        fast = fast or not abs(velocity[i]) <= limit[i]  # so that NaN is too fast
    return fast


class _Watchdog:
    """What both watchdogs have: a record for compiled functions, with what is latched."""

    def __init__(self, parts: Any) -> None:
        self.parts, self._call = parts, Entries()

    @property
    def latched(self) -> int:
        """Reason that lasts until it is set to 0."""
        return int(self.parts.own['latched'][0])

    @latched.setter
    def latched(self, reason: int) -> None:
        self.parts.own['latched'] = reason


class TrackerWatchdog(_Watchdog):
    """The tracker's watchdog; ``silence`` is the longest interval between estimates [ns]."""

    parts: TrackerWatchdogParts

    def __init__(self, arm: SerialArm, limits: TrackerLimits) -> None:
        own = new_record(
            TRACKER_WATCHDOG,
            silence=_nanoseconds(limits.silence),
            latency=_nanoseconds(limits.latency.single),
            mean_latency=_nanoseconds(limits.latency.mean),
            tracking_error=limits.tracking_error,
            is_read=True,
            share=_share(arm),
            late=NEVER,
            usable=NEVER,
            in_reach=NEVER,
        )
        limit, scale = np.array(arm.velocity_limit, float), arm.scales()
        parts = TrackerWatchdogParts(
            memory(own),
            np.full((2, len(limit)), NEVER),
            limits.speed * limit,
            REST_SHARE * limit,
            scale,
            np.clip(2.0 * position_noise(arm), *np.outer(_ARM_MOVED, scale)),
            *np.zeros((4, len(limit))),
        )
        super().__init__(parts)
        self.silence = _nanoseconds(limits.silence)

    def check_estimate(self, *estimate: Any) -> StopReason:
        """As the function `check_estimate`."""
        return _STOP_REASONS[self._call(check_estimate, self.parts, *estimate)]

    def check_motion(self, *motion: Any) -> StopReason:
        """As the function `check_motion`."""
        return _STOP_REASONS[self._call(check_motion, self.parts, *motion)]

    def note_stop(self) -> None:
        """The tracker has stopped the arm: the next reference is a start."""
        self.parts.own['started'] = False


class DriveWatchdog(_Watchdog):
    """The drives' watchdog, sample by sample.

    ``latency`` is tolerated from a measurement to the end of its command's effect; ``command_age``
    is the greatest age of the measurement that was answered last [ns].
    """

    parts: DriveWatchdogParts

    def __init__(self, arm: SerialArm, latency: LatencyLimits = UNKNOWN_LOOP) -> None:
        own = new_record(
            DRIVE_WATCHDOG,
            command_age=_nanoseconds(latency.single),
            mean_latency=_nanoseconds(latency.mean),
            share=_share(arm),
            in_speed=NEVER,
            braked=NEVER,
        )
        parts = DriveWatchdogParts(memory(own), np.array(arm.velocity_limit, float))
        super().__init__(parts)
        self.command_age = _nanoseconds(latency.single)

    def check(self, now: int, age: int, safe_stop: bool, velocity: np.ndarray) -> BrakeReason:
        """As the function `check_drive`."""
        found = self._call(check_drive, self.parts, now, age, safe_stop, velocity)
        return _BRAKE_REASONS[found]


_STOP_REASONS, _BRAKE_REASONS = tuple(StopReason), tuple(BrakeReason)
"""By number: quicker than to make them."""
