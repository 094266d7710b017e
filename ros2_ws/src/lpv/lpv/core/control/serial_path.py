"""Smooth paths of serial arms, through joint positions or through poses of the tip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.control.path import Reference, TimedPath, checked_times, rest_to_rest
from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.kinematics import inverse_kinematics, joint_frames
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.support.jit import njit

SMALLEST_MANIPULABILITY = 0.02
"""Smallest singular value of the tip's Jacobian along a Cartesian path: below, the arm is near a
singularity, where the reduced speed of ISO 10218, 0.25 m/s, needs rates of 12 rad/s [m/rad]."""
_SPACING = 0.04
"""Time between the poses of a Cartesian path that inverse kinematics solves [s]."""
_MOST_POSES = 2001
"""Poses that inverse kinematics solves at most; limits are checked at so many points."""


@dataclass(frozen=True)
class PoseWaypoints:
    """Poses of the tip that a path goes through."""

    positions: tuple[tuple[float, ...], ...]  # x, y, z in the base frame [m]
    start: tuple[float, ...]  # joint positions near the first pose: they choose the posture [rad]
    orientations: tuple[tuple[float, ...], ...] = ()  # roll, pitch, yaw [rad]; none: any


class SerialPath(TimedPath):
    """Quintic spline of the joint positions, at rest at both ends.

    ``positions``, shape (m, n) [rad], are those at ``times`` [s], which increase; before the first
    and after the last the arm rests.  ConfigError if times do not increase, a number of joints is
    wrong, or a limit of a joint (position, rate, or torque according to the model) is exceeded
    anywhere on the path.
    """

    def __init__(self, arm: SerialArm, times: Sequence[float], positions: ArrayLike) -> None:
        super().__init__(arm, times, positions, len(arm.joints), 'joint positions')
        self._check_limits(arm, np.linspace(self.start, self.end, _MOST_POSES))

    @classmethod
    def through_poses(
        cls, arm: SerialArm, times: Sequence[float], waypoints: PoseWaypoints
    ) -> 'SerialPath':
        """Path whose tip moves on a quintic spline through positions, at rest at both ends.

        Between orientations the tip turns at rest-to-rest speed about one axis.  A joint spline
        goes through the solutions of the inverse kinematics, one every 40 ms.

        ``waypoints`` has the poses at ``times`` [s], and the posture to begin with.  ConfigError as
        of the constructor; UnreachableError if a part of the path is out of reach, beyond the
        limits of a joint, or near a singularity; its message says when.
        """
        knots = checked_times(times)
        if len(waypoints.positions) != len(knots):
            raise ConfigError('path.waypoints', 'must have a position each')
        if len(waypoints.start) != len(arm.joints):
            raise ConfigError('path.start', f'must have {len(arm.joints)} joint positions')
        count = min(1 + max(8, round((knots[-1] - knots[0]) / _SPACING)), _MOST_POSES)
        grid = np.linspace(knots[0], knots[-1], count)
        return cls(arm, grid.tolist(), _solve_poses(arm, knots, waypoints, grid))

    def sample(self, times: ArrayLike) -> Reference:
        """As of `TimedPath`; the point of the path is where its joints bring the tip."""
        clock = self._clock(times)
        position = self._spline(clock)
        return Reference(position, self._rate(clock), self._bend(clock), self.tip(position))

    def tip(self, position: np.ndarray) -> np.ndarray:
        """As of `TimedPath`."""
        rows = np.ascontiguousarray(position, dtype=float).reshape(-1, position.shape[-1])
        tips = np.empty((len(rows), 3))
        _fill_tips(self._chain, rows, tips)
        return tips.reshape(*position.shape[:-1], 3)


@njit
def _fill_tips(chain: Chain, positions: FloatArray, tips: FloatArray) -> None:
    n = positions.shape[1]
    rotations, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(len(positions)):
        joint_frames(chain, positions[k], rotations, origins)
        tips[k, :] = origins[n]


def _solve_poses(
    arm: SerialArm, knots: FloatArray, waypoints: PoseWaypoints, grid: FloatArray
) -> FloatArray:
    """Joint positions of the poses at the times of a grid, each close to the one before."""
    tips = rest_to_rest(knots, np.array(waypoints.positions))(grid)
    turns = _orientations(knots, waypoints, grid)
    chain, q = compile_chain(arm), np.array(waypoints.start, float)
    limits = (
        np.array([joint.limits.lower for joint in arm.joints]),
        np.array([joint.limits.upper for joint in arm.joints]),
    )
    result = np.empty((len(grid), len(q)))
    for k, time in enumerate(grid):
        q = _solve_pose(chain, (tips[k], None if turns is None else turns[k]), q, limits, time)
        result[k] = q
    return result


def _solve_pose(
    chain: Chain,
    pose: tuple[FloatArray, FloatArray | None],
    near: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    time: float,
) -> FloatArray:
    answer = inverse_kinematics(chain, *pose, near, limits, tolerance=1e-9)
    if not answer.reached:
        at_limit = np.isclose(answer.q, limits[0]) | np.isclose(answer.q, limits[1])
        cause = 'with a joint at its limit' if at_limit.any() else 'out of reach'
        raise UnreachableError(
            f'path: at {time:.2f} s the tip is {cause}: '
            f'{answer.position_error:.3g} m and {answer.orientation_error:.3g} rad are left'
        )
    if answer.manipulability < SMALLEST_MANIPULABILITY:
        raise UnreachableError(
            f'path: at {time:.2f} s the arm is near a singularity (smallest singular value '
            f'{answer.manipulability:.2g} of at least {SMALLEST_MANIPULABILITY:g})'
        )
    return answer.q


def _orientations(
    knots: FloatArray, waypoints: PoseWaypoints, grid: FloatArray
) -> FloatArray | None:
    """Orientations at the times of the grid, shape (len(grid), 3, 3); None where any will do."""
    if not waypoints.orientations:
        return None
    if len(waypoints.orientations) != len(knots):
        raise ConfigError('path.waypoints', 'must have an orientation each, or none at all')
    # Extrinsic xyz: Rz(yaw) Ry(pitch) Rx(roll), as in URDF.
    from scipy.spatial.transform import Rotation, Slerp  # as `rest_to_rest` does

    turns = Slerp(knots, Rotation.from_euler('xyz', np.array(waypoints.orientations)))
    segment = np.clip(np.searchsorted(knots, grid, 'right') - 1, 0, len(knots) - 2)
    length = np.diff(knots)[segment]
    share = (grid - knots[segment]) / length
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return turns(np.clip(knots[segment] + eased * length, knots[0], knots[-1])).as_matrix()
