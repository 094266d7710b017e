"""Messages that a node refuses: wrong sizes, values that are not finite, a second sender's."""

import math
import time
from collections import Counter
from collections.abc import Iterable, Sequence, Sized
from itertools import chain

from rclpy.node import Node

from lpv.core.control.estimate_check import REST_SHARE
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.limits import MAX_GAP, PATIENCE, QUIET
from lpv.core.support.timestamps import NANOSECONDS


def all_finite(*fields: Iterable[float]) -> bool:
    """Whether all elements of some number fields are finite."""
    return all(map(math.isfinite, chain.from_iterable(fields)))


def all_sized(count: int, *fields: Sized) -> bool:
    """Whether some fields have one element for each of the arm's joints."""
    return {*map(len, fields)} == {count}


_NEAR = 0.02
"""Change of a reading that is no jump, beside that of its rate [rad]."""
_WAIT = 0.3
"""Silence after which another sender is believed, twice what a loaded machine holds one up [s]."""


class OneSender:
    """Keeps the measurements of two senders on one topic apart.

    Publishers of other joints alone, a gripper's, are none of these: each is told by its joints.
    """

    # One that repeats, goes back in time, or is further from the one before than the arm can have
    # moved is another sender's.  It is believed after none that continues the first one's has come
    # for a while: then a sensor has failed, or the first sender has ended.

    def __init__(self, arm: SerialArm) -> None:
        self._names, self._limit = arm.joint_names, arm.velocity_limit
        self._stamp: int | None = None  # of the last one that was believed [ns]
        self._heard = 0.0  # when it came [s]
        self._position = self._rate = [0.0] * len(self._names)
        self._others: dict[frozenset[str], float] = {}  # joints, when they were heard last [s]

    def others(self, now: float | None = None) -> int:
        """Number of publishers of other joints that were heard in the last seconds."""
        now = time.monotonic() if now is None else now
        self._others = {one: at for one, at in self._others.items() if now - at < PATIENCE}
        return len(self._others)

    @property
    def is_heard(self) -> bool:
        """Whether a measurement of the arm was believed in the last second."""
        return time.monotonic() - self._heard < QUIET

    def accept(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        publishers: int,
        now: float | None = None,
    ) -> bool:
        """Whether to use a measurement of a stamp [ns]; of one sender all are.

        ``publishers`` is their number on the topic.
        """
        now = time.monotonic() if now is None else now
        if names and {*self._names}.isdisjoint(names):
            self._others[frozenset(names)] = now
        readings = dict(zip(names, position))
        if len(names) != len(position) or not all(name in readings for name in self._names):
            return True  # of other joints, or not a measurement at all: the monitor says so
        found = [readings[name] for name in self._names]
        step = math.inf if self._stamp is None else (stamp - self._stamp) / NANOSECONDS
        several = publishers > 1 and publishers - self.others(now) > 1
        if several and self._stamp is not None and now - self._heard < _WAIT:
            way = min(step, MAX_GAP)
            jumps = any(  # NaN, a dropout, does not
                abs(new - last) > _NEAR + (abs(rate) + REST_SHARE * limit) * way
                for new, last, rate, limit in zip(found, self._position, self._rate, self._limit)
            )
            if jumps or not 0.0 < step <= MAX_GAP:
                return False
        self._stamp, self._heard = stamp, now
        found = [new if math.isfinite(new) else last for new, last in zip(found, self._position)]
        if 0.0 < step <= MAX_GAP:
            self._rate = [  # over a tiny step it may be no number
                max(-limit, min(limit, (new - last) / step))
                for new, last, limit in zip(found, self._position, self._limit)
            ]
        self._position = found
        return True


class Refusals:
    """Counts refused messages by their reason, and logs each reason at most every `PATIENCE`."""

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._logged: dict[str, float] = {}
        self._last = -math.inf
        self.counts = Counter[str]()
        self.last = ''  # the newest reason

    def add(self, reason: str) -> None:
        self._last = now = time.monotonic()
        self.last = reason
        self.counts[reason] += 1
        if now - self._logged.get(reason, -math.inf) > PATIENCE:
            self._logged[reason] = now
            self._logger.warning(f'refused: {reason} ({self.counts[reason]} so far)')

    @property
    def is_recent(self) -> bool:
        """Whether a message was refused in the last seconds."""
        return time.monotonic() - self._last < PATIENCE
