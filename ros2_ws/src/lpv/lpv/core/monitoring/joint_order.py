"""From sensor_msgs/JointState, with joints in any order, to the arm's joints."""

import math
import reprlib
from collections.abc import Sequence
from typing import Any

from lpv.core.support.errors import SampleError


class JointOrder:
    """Picks the arm's joints out of JointState messages.

    ``needs_rates`` refuses messages without rates.
    """

    def __init__(self, joint_names: Sequence[str], needs_rates: bool = False) -> None:
        self._wanted, self._needs_rates = tuple(joint_names), needs_rates
        self._names: tuple[str, ...] | None = None  # before any; a message may name none
        self._index: tuple[int, ...] = ()

    def indices(self, names: Sequence[str]) -> tuple[int, ...]:
        """Positions of the arm's joints among ``names``; remembered while names stay the same."""
        names = tuple(names)
        if names != self._names:
            there = f'{reprlib.repr(list(names))}; the arm file has {list(self._wanted)}'
            if {*self._wanted}.isdisjoint(names):
                raise SampleError(f'the message is of other joints: {there}')
            for joint in self._wanted:
                if names.count(joint) != 1:
                    raise SampleError(
                        f'joint {joint!r} occurs {names.count(joint)} times in the message, which '
                        f'names {there}; each must be once in every message'
                    )
            self._index = tuple(names.index(joint) for joint in self._wanted)
            self._names = names
        return self._index

    def pick(self, message: Any, torque: Sequence[float] | None = None) -> tuple[list[Any], ...]:
        """Positions, rates and efforts of the arm's joints; NaN where the message carries none.

        ``torque``, of the arm's joints, takes the place of the message's effort.  SampleError if
        joints are unknown or an array has the wrong size.
        """
        index, count = self.indices(message.name), len(message.name)
        picked: list[list[Any]] = []
        for field, needed in (
            ('position', True),
            ('velocity', self._needs_rates),
            ('effort', False),
        ):
            values = getattr(message, field)
            if len(values) != count and (needed or len(values)):
                raise SampleError(f'{field} has {len(values)} values for {count} joints')
            picked.append([values[i] for i in index] if len(values) else [math.nan] * len(index))
        if torque is not None:
            if len(torque) != len(index):
                raise SampleError(f'torque has {len(torque)} values for {len(index)} joints')
            picked[2] = list(torque)
        return tuple(picked)
