"""Random motions of an arm within its limits, or within the region of its gains."""

from dataclasses import replace
from typing import Any

import numpy as np

from lpv.core.control.path import CartesianPath, PlanarWaypoints, SerialPath
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.kinematics import forward
from lpv.core.uio.planar import planar_model

_TRIES = 1000
"""Draws after which an arm has no path: wrong once in 150 times if one of 200 draws is a path."""
_MARGIN = 1.5
"""Least abs(cos) of a path of two links, over that of the certified region."""
_LEFT, _RIGHT, _LEAST, _MOST = 0.725, 0.453, 0.25, 0.8
"""Angles of link 1, over the largest one; bend of link 2 [rad]: neither stretched nor folded."""
_FASTEST = 2.0
"""Largest joint rate of a path of two links [rad/s]."""
_SEGMENT = (1.5, 3.0)
"""Time between waypoints of an arm [s]."""
_POSITION_SHARE, _RATE_SHARE, _TORQUE_SHARE = 0.7, 0.6, 0.7
"""Shares of an arm's limits that random paths use: the rest is for payload and feedback."""


def random_path(arm: SerialArm, rng: np.random.Generator, duration: float) -> dict[str, Any]:
    """``path`` of a scenario: a random motion, in the region if any; ConfigError without."""
    if duration <= 1.0:
        raise ConfigError('duration', f'a random path needs more than 1 s, got {duration:g}')
    find = _find_in_region if arm.lpv is not None else _find_within_limits
    return {'waypoints': find(arm, rng, duration)}


def _find_in_region(arm: SerialArm, rng: np.random.Generator, duration: float) -> list[Any]:
    """Waypoints of the tip of a path in an arm's region."""
    planar = planar_model(arm)
    joints, least = JointMap(planar), _MARGIN * max(planar.cos_min)
    largest, turn = np.arccos(min(least, 1.0)), 0.0 if planar.sign > 0.0 else np.pi
    for _ in range(_TRIES):
        count = int(rng.integers(3, 7))
        times = np.linspace(0.5, duration - 0.5, count)
        one = rng.uniform(-_LEFT * largest, _RIGHT * largest, count)
        bend = rng.uniform(_LEAST, _MOST, count)
        # Kinematics counts q1 from the x-axis, angles of the links count from the upper vertical.
        points = forward(np.column_stack([turn + one + np.pi / 2.0, bend]), planar.lengths)
        try:
            waypoints = PlanarWaypoints(tuple(map(tuple, points.tolist())))
            planned = CartesianPath(arm, times.tolist(), waypoints)
            path = planned.sample(np.linspace(0.0, duration, 400))
        except LpvError:
            continue
        cosines = planar.sign * np.cos(joints.absolute_position(path.position))
        if cosines.min() > least and np.abs(path.velocity).max() < _FASTEST:
            pairs = zip(times.tolist(), points.tolist())
            return [{'t': time, 'x': x, 'y': y} for time, (x, y) in pairs]
    what = f'no random path of {duration:g} s below {_FASTEST:g} rad/s'
    raise ConfigError('path', f'{what} found in the region of arm {arm.name!r}')


def _find_within_limits(arm: SerialArm, rng: np.random.Generator, duration: float) -> list[Any]:
    """Waypoints of the joints of a path within an arm's limits."""
    careful, low, high = _with_margins(arm)
    steps = max(1, round((duration - 1.0) / float(rng.uniform(*_SEGMENT))))
    times = np.linspace(0.5, duration - 0.5, steps + 1)
    way = 0.5 * np.array(careful.velocity_limit) * (times[1] - times[0])
    for attempt in range(_TRIES):
        # Smaller steps where limits are met, which are those of rate or torque.
        reach = way * 0.95**attempt
        points = [rng.uniform(low, high)]
        for _ in range(steps):
            near = np.maximum(low, points[-1] - reach), np.minimum(high, points[-1] + reach)
            points.append(rng.uniform(*near))
        try:
            SerialPath(careful, times.tolist(), points)
        except LpvError:
            continue
        return [{'t': t, 'joints': row.tolist()} for t, row in zip(times.tolist(), points)]
    raise ConfigError('path', f'no random path of {duration:g} s found for {arm.name}')


def _with_margins(arm: SerialArm) -> tuple[SerialArm, np.ndarray, np.ndarray]:
    """The arm with shares of its limits of rate and torque; range of the joint positions."""
    joints = []
    for joint in arm.joints:
        rate, torque = _RATE_SHARE * joint.limits.velocity, _TORQUE_SHARE * joint.limits.torque
        limits = replace(joint.limits, velocity=rate, torque=torque)
        joints.append(replace(joint, limits=limits))
    low, high = np.array([joint.range for joint in arm.joints]).T
    rim = 0.5 * (1.0 - _POSITION_SHARE) * (high - low)
    return replace(arm, joints=tuple(joints)), low + rim, high - rim
