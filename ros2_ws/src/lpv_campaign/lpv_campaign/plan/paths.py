"""Random paths inside the certified region of an arm."""

from typing import Any

import numpy as np

from lpv_core.control.path import CartesianPath
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.model.kinematics import forward
from lpv_core.support.errors import ConfigError, LpvError

_TRIES = 1000
_MARGIN = 1.5
"""Least abs(cos) of a path, over that of the region."""
_LEFT, _RIGHT, _LEAST, _MOST = 0.725, 0.453, 0.25, 0.8
"""Link 1 takes angles from -_LEFT to _RIGHT times the largest one; link 2 is that of link 1 plus
_LEAST to _MOST [rad]: neither stretched nor folded."""


def random_path(
    arm: ArmParameters, rng: np.random.Generator, duration: float, fastest: float = 2.0
) -> tuple[Any, ...]:
    """Timed points of a random path on which gains are certified.

    Parameters
    ----------
    arm : ArmParameters
        The arm; its ``cos_min`` and ``orientation`` give the region.
    rng : numpy.random.Generator
        Source of randomness.
    duration : float
        Length of the run, more than 1 s [s]; the path leaves half a second at either end.
    fastest : float, optional
        Largest joint rate [rad/s].

    Returns
    -------
    tuple
        Times [s] and points (x, y) [m], both tuples, as a scenario has them.

    Raises
    ------
    ConfigError
        If the region leaves no room for a path.
    """
    if duration <= 1.0:
        raise ConfigError('duration', f'a random path needs more than 1 s, got {duration:g}')
    joints, least = JointMap(arm), _MARGIN * max(arm.cos_min)
    largest, turn = np.arccos(min(least, 1.0)), 0.0 if arm.sign > 0.0 else np.pi
    for _ in range(_TRIES):
        count = int(rng.integers(3, 7))
        times = np.linspace(0.5, duration - 0.5, count)
        one = rng.uniform(-_LEFT * largest, _RIGHT * largest, count)
        bend = rng.uniform(_LEAST, _MOST, count)
        # Kinematics counts q1 from the x-axis, angles of the links count from the upper vertical.
        points = forward(np.column_stack([turn + one + np.pi / 2.0, bend]), arm.lengths)
        try:
            path = CartesianPath(arm, times.tolist(), points).sample(
                np.linspace(0.0, duration, 400)
            )
        except LpvError:
            continue
        cosines = arm.sign * np.cos(joints.absolute_position(path.position))
        if cosines.min() > least and np.abs(path.velocity).max() < fastest:
            return tuple(times.tolist()), tuple(map(tuple, points.tolist()))
    raise ConfigError(
        'path',
        f'no random path of {duration:g} s below {fastest:g} rad/s found in '
        f'the region of arm {arm.name!r}',
    )
