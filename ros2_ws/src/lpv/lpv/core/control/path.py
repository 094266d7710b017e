"""Splines from rest to rest, Cartesian paths, and the joint references that they are made into."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.support.entries import entry, part, positive
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import FAR
from lpv.core.uio.model.kinematics import ELBOWS, forward, inverse, joint_motion
from lpv.core.uio.planar import planar_links, plane_of


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


def checked_times(times: Sequence[float]) -> np.ndarray:
    """Times of waypoints [s]; ConfigError if they are not two or more that increase."""
    knots = np.asarray(times, float)
    if len(knots) < 2:
        raise ConfigError('path.waypoints', 'must be two or more')
    if not (np.isfinite(knots).all() and np.all(np.diff(knots) > 0)):
        raise ConfigError('path.waypoints', 'times must increase')
    return knots


def rest_to_rest(knots: np.ndarray, points: np.ndarray) -> Any:
    """Spline through points, shape (m, n), at times, shape (m,) [s].

    Rates and accelerations vanish at both ends; the jerk is continuous inside.
    """
    # Here: it loads for 0.2 s, and not every program that reads a scenario follows its path.
    from scipy.interpolate import make_interp_spline

    still = np.zeros(points.shape[1])
    rest = [(1, still), (2, still)]
    return make_interp_spline(knots, points, k=5, bc_type=(rest, rest))


def _beyond(reason: str, limit: str) -> ConfigError:
    return ConfigError('path', f'{reason}, whose limit is {limit}')


class TimedPath(ABC):
    """Quintic spline through timed points, at rest at both ends, and before and after.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    times : sequence of float
        Strictly increasing [s].
    points : array_like, shape (m, n)
        Points at these times.
    size : int
        n.
    what : str
        What points are made of, for messages.

    Attributes
    ----------
    start, end : float
        Of the motion [s].
    obstacle : Obstacle or None
        In the plane of a planar arm.

    Raises
    ------
    ConfigError
        If times do not increase, there are fewer than two points, or these are of another size, or
        not finite.
    """

    obstacle: Obstacle | None = None

    def __init__(
        self, arm: SerialArm, times: Sequence[float], points: ArrayLike, size: int, what: str
    ) -> None:
        knots, values = checked_times(times), np.asarray(points, float)
        if values.shape != (len(knots), size):
            raise ConfigError('path.waypoints', f'must give {size} {what} each')
        if not np.isfinite(values).all():
            raise ConfigError('path.waypoints', 'must be finite')
        self._chain = compile_chain(arm)
        self.start, self.end = float(knots[0]), float(knots[-1])
        self._spline = rest_to_rest(knots, values)
        self._rate, self._bend = self._spline.derivative(1), self._spline.derivative(2)

    def _clock(self, times: ArrayLike) -> np.ndarray:
        """Times within the motion."""
        return np.clip(np.asarray(times, float), self.start, self.end)

    def _check_limits(self, arm: SerialArm, times: np.ndarray) -> None:
        """ConfigError if a limit of a joint is exceeded at one of many times."""
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

    @abstractmethod
    def sample(self, times: ArrayLike) -> Reference:
        """References at times on the path's clock, an array of shape (...) [s]."""

    @abstractmethod
    def tip(self, position: np.ndarray) -> np.ndarray:
        """Where joint positions, shape (..., n) [rad], bring the tip, shape (..., 3) [m]."""

    def in_base(self, point: np.ndarray) -> np.ndarray:
        """Points in the plane of a planar arm, shape (..., 2), in the base frame, shape (..., 3)
        [m]; of paths without a plane points of the base frame, as they are."""
        return point


@dataclass(frozen=True)
class PlanarWaypoints:
    """Points in the vertical plane of a planar arm that its tip goes through."""

    points: tuple[tuple[float, float], ...]  # x forward, y up, from joint 1 [m]
    # branch of the inverse kinematics
    elbow: str = entry('text', default='positive', choices=tuple(ELBOWS))
    # for pictures, and for the check that the path keeps clear of it
    obstacle: Obstacle | None = part(Obstacle, default=None)


class CartesianPath(TimedPath):
    """Quintic spline through timed points in the plane, at rest at both ends.

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
        If times do not increase, there are fewer than two points, the tip hits the obstacle, or a
        limit of a joint (position, rate, or torque according to the model) is exceeded.
    UnreachableError
        If any part of the path is out of reach or singular.
    """

    def __init__(self, arm: SerialArm, times: Sequence[float], waypoints: PlanarWaypoints) -> None:
        super().__init__(arm, times, waypoints.points, 2, 'coordinates x and y')
        if waypoints.elbow not in ELBOWS:
            raise ConfigError('path.elbow', f'must be one of {", ".join(ELBOWS)}')
        self._arm, self._elbow = planar_links(arm), waypoints.elbow
        self.obstacle = waypoints.obstacle
        self._origin, self._plane = plane_of(arm)
        # q1 of eqs. (32)-(34) counts from the x-axis, which is -pi/2 from the upper vertical.
        self._offset = np.array([-np.pi / 2 - self._arm.zero_angle, 0.0])
        self._grid = np.linspace(self.start, self.end, 1001)
        self._turning = self._first_joint(self._grid)
        self._check_clearance()
        self._check_limits(arm, self._grid)  # reachable everywhere

    def _first_joint(self, times: np.ndarray) -> np.ndarray:
        """Continuous q1 along the path, started within (-pi, pi]."""
        q_1 = inverse(self._spline(times), self._arm.lengths, self._elbow)[:, 0] + self._offset[0]
        q_1[0] = (q_1[0] + np.pi) % (2.0 * np.pi) - np.pi
        return np.unwrap(q_1)

    def _check_clearance(self) -> None:
        tip = self._spline(self._grid)
        if self.obstacle is not None:
            distance = np.hypot(*(tip - np.asarray(self.obstacle.center)).T)
            if distance.min() < self.obstacle.radius:
                raise ConfigError(
                    'path', f'the tip hits the obstacle ({distance.min():.3f} m from its centre)'
                )

    def sample(self, times: ArrayLike) -> Reference:
        """As of `TimedPath`; the point of the path is that of the spline."""
        clock = self._clock(times)
        tip = self._spline(clock)
        q = inverse(tip, self._arm.lengths, self._elbow)
        rate, acceleration = joint_motion(
            q, self._rate(clock), self._bend(clock), self._arm.lengths
        )
        position = self._continuous(q + self._offset, clock)
        return Reference(position, rate, acceleration, self.in_base(tip))

    def tip(self, position: np.ndarray) -> np.ndarray:
        """As of `TimedPath`."""
        return self.in_base(forward(position - self._offset, self._arm.lengths))

    def in_base(self, point: np.ndarray) -> np.ndarray:
        """As of `TimedPath`."""
        return np.asarray(self._origin + point @ self._plane)

    def _continuous(self, q: np.ndarray, times: np.ndarray) -> np.ndarray:
        """q with the turn of q1 that the path is in: atan2 jumps on the negative x-axis."""
        near = np.interp(times, self._grid, self._turning)
        turns = np.round((near - q[..., 0]) / (2.0 * np.pi))
        return np.stack([q[..., 0] + 2.0 * np.pi * turns, q[..., 1]], axis=-1)
