"""Paths from rest to rest: splines of joint positions, through waypoints of joints or the tip."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.kinematics import inverse_kinematics, joint_frames
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.support.entries import entry, part, positive
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.support.jit import njit
from lpv.core.support.limits import FAR, MOST_ENTRIES
from lpv.core.uio.model.kinematics import ELBOWS, forward, inverse, refuse_singular
from lpv.core.uio.planar import planar_links, plane_of

SMALLEST_MANIPULABILITY = 0.02
"""Smallest singular value of the tip's Jacobian along a path of poses: below, the arm is near a
singularity, where the reduced speed of ISO 10218, 0.25 m/s, needs rates of 12 rad/s [m/rad]."""
_SPACING = 0.04
"""Time between the poses that inverse kinematics solves [s]."""
_MOST_POSES, _BETWEEN = 2001, 8
"""Poses that inverse kinematics solves at most; limits are checked at so many points.  Both are
more where that leaves less than so many from one waypoint to the next."""
_POINTS, _LEAST_POINTS = 100, 500
"""Points in the plane that are solved between two waypoints, and of a path at least: between them
positions of shipped paths err by 1e-12 rad, accelerations by 1e-8 rad/s2, and rounding by less."""


@dataclass(frozen=True)
class Reference:
    """Reference of the tracking loop at one or more times."""

    position: np.ndarray  # of the joints, ROS joint coordinates, shape (..., n) [rad]
    velocity: np.ndarray  # the same, shape (..., n) [rad/s]
    acceleration: np.ndarray  # the same, shape (..., n) [rad/s2]
    tip: np.ndarray  # the point of the path: x, y, z in the base frame [m]

    def write(self, motion: np.ndarray, tip: np.ndarray) -> None:
        """Write position, velocity and acceleration into (m, 3, n), the point into (m, 2 or 3)."""
        motion[:, 0], motion[:, 1], motion[:, 2] = self.position, self.velocity, self.acceleration
        tip[:] = self.tip


@dataclass(frozen=True)
class Obstacle:
    """A round obstacle in the plane of the arm."""

    center: tuple[float, float] = entry('vector', 2, low=-FAR, high=FAR)  # x, y [m]
    radius: float = positive(FAR)  # [m]


@dataclass(frozen=True)
class PlanarWaypoints:
    """Points in the vertical plane of a planar arm that its tip goes through."""

    points: tuple[tuple[float, float], ...]  # x forward, y up, from joint 1 [m]
    # branch of the inverse kinematics
    elbow: str = entry('text', default='positive', choices=tuple(ELBOWS))
    # for pictures, and for the check that the path keeps clear of it
    obstacle: Obstacle | None = part(Obstacle, default=None)


@dataclass(frozen=True)
class PoseWaypoints:
    """Poses of the tip that a path goes through."""

    positions: tuple[tuple[float, ...], ...]  # x, y, z in the base frame [m]
    start: tuple[float, ...]  # joint positions near the first pose: they choose the posture [rad]
    orientations: tuple[tuple[float, ...], ...] = ()  # roll, pitch, yaw [rad]; none: any


def _checked(
    times: Sequence[float], points: ArrayLike, size: int, what: str
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and points, shape (m, size); ConfigError if times do not increase, there are fewer
    than two points, or these are of another size, or not finite."""
    knots, values = np.asarray(times, float), np.asarray(points, float)
    if len(knots) < 2:
        raise ConfigError('path.waypoints', 'must be two or more')
    if not (np.isfinite(knots).all() and np.all(np.diff(knots) > 0)):
        raise ConfigError('path.waypoints', 'times must increase')
    if values.shape != (len(knots), size):
        raise ConfigError('path.waypoints', f'must give {size} {what} each')
    if not np.isfinite(values).all():
        raise ConfigError('path.waypoints', 'must be finite')
    return knots, values


def _between(knots: FloatArray, count: int) -> FloatArray:
    """So many times from each to the next, and the last one."""
    return np.append(np.linspace(knots[:-1], knots[1:], count, endpoint=False).T, knots[-1])


def _rest_to_rest(knots: FloatArray, points: FloatArray) -> Any:
    """Spline through points, shape (m, n), at times, shape (m,) [s].

    Rates and accelerations vanish at both ends; the jerk is continuous inside.
    """
    # Here: it loads for 0.2 s, and not every program that reads a scenario follows its path.
    from scipy.interpolate import make_interp_spline

    still = np.zeros(points.shape[1])
    rest = [(1, still), (2, still)]
    return make_interp_spline(knots, points, k=5, bc_type=(rest, rest))


class SerialPath:
    """Quintic spline of the joint positions, at rest at both ends, and before and after.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    times : sequence of float
        Strictly increasing [s].
    positions : array_like, shape (m, n)
        Of the joints at these times [rad].

    Attributes
    ----------
    start, end : float
        Of the motion [s].
    obstacle : Obstacle or None
        In the plane of a planar arm.

    Raises
    ------
    ConfigError
        If times do not increase, a number of joints is wrong, or a limit of a joint (position,
        rate, or torque according to the model) is exceeded anywhere on the path.
    """

    obstacle: Obstacle | None = None

    def __init__(self, arm: SerialArm, times: Sequence[float], positions: ArrayLike) -> None:
        knots, values = _checked(times, positions, len(arm.joints), 'joint positions')
        self._chain = compile_chain(arm)
        self.start, self.end = float(knots[0]), float(knots[-1])
        self._spline = _rest_to_rest(knots, values)
        self._rate, self._bend = self._spline.derivative(1), self._spline.derivative(2)
        checked = max(_MOST_POSES, _BETWEEN * min(len(knots), MOST_ENTRIES))
        self._check_limits(arm, _between(knots, -(-checked // len(knots))))

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
        knots, points = _checked(times, waypoints.positions, 3, 'coordinates x, y and z')
        if len(waypoints.start) != len(arm.joints):
            raise ConfigError('path.start', f'must have {len(arm.joints)} joint positions')
        most = max(_MOST_POSES, 1 + _BETWEEN * (len(knots) - 1))
        count = min(1 + max(_BETWEEN, round((knots[-1] - knots[0]) / _SPACING)), most)
        grid = np.linspace(knots[0], knots[-1], count)
        tips, turns = _rest_to_rest(knots, points)(grid), _orientations(knots, waypoints, grid)
        limits = np.array([(joint.limits.lower, joint.limits.upper) for joint in arm.joints]).T
        chain, q, solved = compile_chain(arm), np.array(waypoints.start, float), []
        for k, time in enumerate(grid):
            pose = tips[k], None if turns is None else turns[k]
            q = _solve_pose(chain, pose, q, (limits[0], limits[1]), time)
            solved.append(q)
        return cls(arm, grid.tolist(), solved)

    def _check_limits(self, arm: SerialArm, times: FloatArray) -> None:
        """ConfigError if a limit of a joint is exceeded at one of some times."""
        motion = self.sample(times)
        rows = motion.position, motion.velocity, motion.acceleration
        rate, torque = np.abs(motion.velocity), np.abs(SerialModel(self._chain).torque(*rows))
        for i, joint in enumerate(arm.joints):
            limits, (unit, torque_unit) = joint.limits, joint.units
            low, high = motion.position[:, i].min(), motion.position[:, i].max()
            if low < limits.lower or high > limits.upper:
                reason = f'takes {joint.name} to {low:.3g} .. {high:.3g} {unit}'
                raise _beyond(reason, f'{limits.lower:g} .. {limits.upper:g}')
            if rate[:, i].max() > limits.velocity:
                reason = f'needs {rate[:, i].max():.3g} {unit}/s of {joint.name}'
                raise _beyond(reason, f'{limits.velocity:g}')
            if torque[:, i].max() > limits.torque:
                reason = f'needs {torque[:, i].max():.3g} {torque_unit} of {joint.name}'
                raise _beyond(reason, f'{limits.torque:g}')

    def sample(self, times: ArrayLike) -> Reference:
        """References at times on the path's clock, an array of shape (...) [s]."""
        clock = np.clip(np.asarray(times, float), self.start, self.end)
        if np.isnan(clock).any():
            raise UnreachableError('the path is nowhere at a time that is no number')
        position = self._spline(clock)
        tip = self._point(clock, position)
        return Reference(position, self._rate(clock), self._bend(clock), tip)

    def _point(self, clock: FloatArray, position: FloatArray) -> FloatArray:
        """Point of the path at times within it, where these are the joint positions."""
        return self.tip(position)

    def tip(self, position: np.ndarray) -> np.ndarray:
        """Where joint positions, shape (..., n) [rad], bring the tip, shape (..., 3) [m]."""
        rows = np.ascontiguousarray(position, dtype=float).reshape(-1, position.shape[-1])
        tips = np.empty((len(rows), 3))
        _fill_tips(self._chain, rows, tips)
        return tips.reshape(*position.shape[:-1], 3)

    def in_base(self, point: np.ndarray) -> np.ndarray:
        """Points in the plane of a planar arm, shape (..., 2), in the base frame, shape (..., 3)
        [m]; of paths without a plane points of the base frame, as they are."""
        return point


class CartesianPath(SerialPath):
    """Path whose tip follows a quintic spline through timed points in the plane, at rest at both
    ends; joints go through the solutions of the inverse kinematics.

    Parameters
    ----------
    arm : SerialArm
        A planar arm of two links.
    times : sequence of float
        Strictly increasing [s]; before the first and after the last the tip rests.
    waypoints : PlanarWaypoints
        Points at these times.

    Raises
    ------
    ConfigError
        As of `SerialPath`, and if the tip hits the obstacle.
    UnreachableError
        If any part of the path is out of reach or singular.
    """

    def __init__(self, arm: SerialArm, times: Sequence[float], waypoints: PlanarWaypoints) -> None:
        knots, points = _checked(times, waypoints.points, 2, 'coordinates x and y')
        if waypoints.elbow not in ELBOWS:
            raise ConfigError('path.elbow', f'must be one of {", ".join(ELBOWS)}')
        self._arm, self.obstacle = planar_links(arm), waypoints.obstacle
        self._origin, self._plane = plane_of(arm)
        # q1 of eqs. (32)-(34) counts from the x-axis, which is -pi/2 from the upper vertical.
        self._offset = np.array([-np.pi / 2 - self._arm.zero_angle, 0.0])
        self._line = _rest_to_rest(knots, points)
        count = max(_POINTS, -(-_LEAST_POINTS // (len(knots) - 1)))
        grid = _between(knots, count)
        tip = self._line(grid)
        q = inverse(tip, self._arm.lengths, waypoints.elbow) + self._offset
        refuse_singular(q)
        self._check_clearance(tip)
        q[0, 0] = (q[0, 0] + np.pi) % (2.0 * np.pi) - np.pi
        q[:, 0] = np.unwrap(q[:, 0])  # atan2 jumps on the negative x-axis
        # Where limits leave another turn, as 0 to 2 pi do, it is that.
        middle = np.array([0.5 * (j.limits.lower + j.limits.upper) for j in arm.joints])
        turns = np.round((middle - q[0]) / (2.0 * np.pi))
        q += 2.0 * np.pi * np.where(np.isfinite(turns), turns, 0.0)
        super().__init__(arm, grid.tolist(), q)

    def _check_clearance(self, tip: FloatArray) -> None:
        if self.obstacle is not None:
            distance = np.hypot(*(tip - np.asarray(self.obstacle.center)).T)
            if distance.min() < self.obstacle.radius:
                raise ConfigError(
                    'path', f'the tip hits the obstacle ({distance.min():.3f} m from its centre)'
                )

    def _point(self, clock: FloatArray, position: FloatArray) -> FloatArray:
        """That of the tip's own spline."""
        return self.in_base(self._line(clock))

    def tip(self, position: np.ndarray) -> np.ndarray:
        """As of `SerialPath`."""
        return self.in_base(forward(position - self._offset, self._arm.lengths))

    def in_base(self, point: np.ndarray) -> np.ndarray:
        """As of `SerialPath`."""
        return np.asarray(self._origin + point @ self._plane)


def _beyond(reason: str, limit: str) -> ConfigError:
    return ConfigError('path', f'{reason}, whose limit is {limit}')


@njit
def _fill_tips(chain: Chain, positions: FloatArray, tips: FloatArray) -> None:
    n = positions.shape[1]
    rotations, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    for k in range(len(positions)):
        joint_frames(chain, positions[k], rotations, origins)
        tips[k, :] = origins[n]


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
    from scipy.spatial.transform import Rotation, Slerp  # as `_rest_to_rest` does

    turns = Slerp(knots, Rotation.from_euler('xyz', np.array(waypoints.orientations)))
    segment = np.clip(np.searchsorted(knots, grid, 'right') - 1, 0, len(knots) - 2)
    length = np.diff(knots)[segment]
    share = (grid - knots[segment]) / length
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return turns(np.clip(knots[segment] + eased * length, knots[0], knots[-1])).as_matrix()
