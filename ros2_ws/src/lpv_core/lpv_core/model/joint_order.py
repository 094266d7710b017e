"""From sensor_msgs/JointState, with joints in any order, to the arm's joints."""

import math
import reprlib
from collections.abc import Sequence
from typing import Any

from lpv_core.support.errors import SampleError


class JointOrder:
    """Picks the arm's joints out of JointState messages.

    Parameters
    ----------
    joint_names : sequence of str
        Joints of the arm file.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._wanted = tuple(joint_names)
        self._names: tuple[str, ...] = ()
        self._index: tuple[int, ...] = ()

    def indices(self, names: Sequence[str]) -> tuple[int, ...]:
        """Positions of the arm's joints among ``names``; remembered while names stay the same."""
        names = tuple(names)
        if names != self._names:
            for joint in self._wanted:
                if names.count(joint) != 1:
                    raise SampleError(
                        f'joint {joint!r} occurs {names.count(joint)} times in the message, which '
                        f'names {reprlib.repr(list(names))}; the arm file has {list(self._wanted)}'
                    )
            self._index = tuple(names.index(joint) for joint in self._wanted)
            self._names = names
        return self._index

    def pick(self, message: Any) -> tuple[list[Any], ...]:
        """Positions, rates and efforts of the arm's joints.

        Parameters
        ----------
        message : sensor_msgs.msg.JointState
            The measurement.

        Returns
        -------
        tuple of list
            position, velocity, effort; effort is NaN where the message carries none.

        Raises
        ------
        SampleError
            If joints are unknown or an array has the wrong size.
        """
        index = self.indices(message.name)
        count = len(message.name)
        for field in ('position', 'velocity'):
            if len(getattr(message, field)) != count:
                raise SampleError(
                    f'{field} has {len(getattr(message, field))} values for {count} joints'
                )
        if len(message.effort) not in (0, count):
            raise SampleError(f'effort has {len(message.effort)} values for {count} joints')
        effort = (
            [message.effort[i] for i in index] if len(message.effort) else [math.nan] * len(index)
        )
        return ([message.position[i] for i in index], [message.velocity[i] for i in index], effort)
