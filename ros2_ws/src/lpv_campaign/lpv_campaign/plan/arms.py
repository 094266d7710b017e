"""What differs between simulated arms, in one place: random paths, the loop, its angles."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpv_core.control.path import CartesianPath
from lpv_core.control.serial_path import SerialPath
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.model.kinematics import forward
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation import scenario, serial_scenario
from lpv_core.simulation.closed_loop import Transport, run_closed_loop
from lpv_core.simulation.serial_closed_loop import run_serial_loop
from lpv_core.support.errors import ConfigError, LpvError

_TRIES = 1000
_MARGIN = 1.5
"""Least abs(cos) of a path of two links, over that of the certified region."""
_LEFT, _RIGHT, _LEAST, _MOST = 0.725, 0.453, 0.25, 0.8
"""Link 1 takes angles from -_LEFT to _RIGHT times the largest one; link 2 is that of link 1 plus
_LEAST to _MOST [rad]: neither stretched nor folded."""
_SEGMENT = (1.5, 3.0)
"""Time between waypoints of a serial arm [s]."""
_POSITION_SHARE, _RATE_SHARE, _TORQUE_SHARE = 0.7, 0.6, 0.7
"""Shares of a serial arm's limits that random paths use: the rest is for payload and feedback."""


@dataclass(frozen=True)
class ArmKind:
    """How arms of one kind are simulated."""

    designed: bool  # whether it needs designed gains
    plants: tuple[str, ...]  # models that can be simulated
    factors: tuple[str, ...]  # factors of a campaign that only arms of this kind have
    # arm, generator, duration [s] -> ``path`` of a scenario file
    random_path: Callable[[Any, np.random.Generator, float], dict[str, Any]]
    # plan of a run, scenario -> signals of the run
    simulate: Callable[[Any, Any], Any]
    # arm, joint positions -> angles in which errors count
    angles: Callable[[Any, np.ndarray], np.ndarray]


def kind_of(arm: Arm) -> ArmKind:
    """Kind of an arm."""
    return SERIAL if isinstance(arm, SerialArm) else TWO_LINKS


def random_path(
    arm: ArmParameters, rng: np.random.Generator, duration: float, fastest: float = 2.0
) -> tuple[Any, ...]:
    """Times [s] and points (x, y) [m] of a random path of a two-link arm that is certified.

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

    Raises
    ------
    ConfigError
        If the region leaves no room for a path.
    """
    _check_duration(duration)
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


def random_joint_path(
    arm: SerialArm, rng: np.random.Generator, duration: float
) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...]]:
    """Times [s] and joint positions [rad] of a random motion within a serial arm's limits.

    Raises
    ------
    ConfigError
        If the limits leave no room for a path.
    """
    _check_duration(duration)
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
        return tuple(times.tolist()), tuple(tuple(point.tolist()) for point in points)
    raise ConfigError('path', f'no random path of {duration:g} s found for {arm.name}')


def _check_duration(duration: float) -> None:
    if duration <= 1.0:
        raise ConfigError('duration', f'a random path needs more than 1 s, got {duration:g}')


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


def _path_of_two_links(
    arm: ArmParameters, rng: np.random.Generator, duration: float
) -> dict[str, Any]:
    times, points = random_path(arm, rng, duration)
    return {'waypoints': [{'t': t, 'x': x, 'y': y} for t, (x, y) in zip(times, points)]}


def _path_of_joints(arm: SerialArm, rng: np.random.Generator, duration: float) -> dict[str, Any]:
    times, points = random_joint_path(arm, rng, duration)
    return {'waypoints': [{'t': t, 'joints': list(row)} for t, row in zip(times, points)]}


TWO_LINKS = ArmKind(
    True,
    scenario.PLANTS,
    (
        *('design', 'disturbance', 'mass_1', 'mass_2', 'inertia_1', 'inertia_2'),
        *('command_delay', 'sample_loss'),
    ),
    _path_of_two_links,
    lambda plan, what: run_closed_loop(
        *(plan.arm, plan.gains, what, plan.compensation, plan.parameters, plan.substeps),
        Transport(plan.delay, plan.loss),
    ),
    lambda arm, position: JointMap(arm).absolute_position(position),
)
SERIAL = ArmKind(
    False,
    serial_scenario.PLANTS,
    ('parameter_error',),
    _path_of_joints,
    lambda plan, what: run_serial_loop(
        plan.arm, what, plan.compensation, parameters=plan.parameters, substeps=plan.substeps
    ),
    lambda arm, position: position,
)
