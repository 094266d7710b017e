"""Motions that identify an arm well, within its limits: planned, and written to be played."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import qr

from lpv.bag.rosbag.writing import BagWriter
from lpv.core.serial_arm.description import N_INERTIAL, SerialArm
from lpv.core.serial_arm.dynamics.kinematics import joint_frames
from lpv.core.support.config import write_yaml
from lpv.identify.errors import IdentificationError
from lpv.identify.model.friction import SLOPE, friction_columns, join_columns
from lpv.identify.model.rigid_body import (
    RigidBody,
    find_base_parameters,
    independent,
    joint_torques,
)

HARMONICS = 5
"""Of a joint's Fourier series, as in Swevers et al. (1997)."""
STEP = 10.0 / HARMONICS / 20.0
"""Between points of the motion, 20 in a period of the last harmonic: the first one has 10 s [s]."""
RAMP = 1.5
"""Time in which the motion fades in and out [s]."""
_CHECK_STEP = STEP / 5.0  # between samples whose limits are checked [s]
TOPIC = '/lpv/excitation'
"""Topic of the reference in the bag, sensor_msgs/JointState."""


@dataclass(frozen=True)
class Trajectory:
    """q(t) = centre + e(t) sum_k (a_k sin(k w t) + b_k cos(k w t)), with an envelope e."""

    duration: float  # [s]
    center: np.ndarray  # shape (n,) [rad]
    sine: np.ndarray  # a, shape (harmonics, n) [rad]
    cosine: np.ndarray  # b, shape (harmonics, n) [rad]
    period: float  # 2 pi / w [s]

    def sample(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, rates and accelerations, each of shape (samples, n)."""
        omega = 2.0 * np.pi * np.arange(1, len(self.sine) + 1) / self.period
        s, c = np.sin(np.outer(time, omega)), np.cos(np.outer(time, omega))
        wave = s @ self.sine + c @ self.cosine
        rate = (c * omega) @ self.sine - (s * omega) @ self.cosine
        bend = -(s * omega**2) @ self.sine - (c * omega**2) @ self.cosine
        # An envelope, whose slope and curve are 0 at its ends.
        ramp = min(RAMP, 0.25 * self.duration)
        up, down = np.clip(time / ramp, 0, 1), np.clip((self.duration - time) / ramp, 0, 1)
        x, sign = np.minimum(up, down)[:, None], np.where(up <= down, 1.0, -1.0)[:, None]
        e = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        de = 30.0 * x**2 * (1.0 - x) ** 2 * sign / ramp
        dde = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
        position = self.center + e * wave
        return position, de * wave + e * rate, dde * wave + 2.0 * de * rate + e * bend

    def scaled(self, factor: np.ndarray | float) -> 'Trajectory':
        """The motion with other amplitudes."""
        return replace(self, sine=self.sine * factor, cosine=self.cosine * factor)


def random_trajectory(
    rng: np.random.Generator,
    center: np.ndarray,
    reach: np.ndarray,
    speed: np.ndarray,
    duration: float,
) -> Trajectory:
    """Random trajectory, at its limit of reach [rad] or speed [rad/s] in each joint."""
    k = np.arange(1, HARMONICS + 1)[:, None]
    period = duration / max(1, round(duration / 10.0))
    sine, cosine = rng.normal(size=(2, HARMONICS, len(center))) / k
    return fit_to_limits(Trajectory(duration, center, sine, cosine, period), reach, speed)


def fit_to_limits(trajectory: Trajectory, reach: np.ndarray, speed: np.ndarray) -> Trajectory:
    """Scale each joint's motion so that it reaches a limit of position or speed."""
    position, rate, _ = trajectory.sample(np.arange(0.0, trajectory.duration, 0.02))
    way = np.maximum(np.max(np.abs(position - trajectory.center), axis=0), 1e-9)
    fastest = np.maximum(np.max(np.abs(rate), axis=0), 1e-9)
    return trajectory.scaled(np.minimum(reach / way, speed / fastest))


@dataclass(frozen=True)
class Bounds:
    """What the motion must keep, besides the limits of the arm's joints."""

    speed_share: float = 0.6  # of the joints' velocity limits
    torque_share: float = 0.8  # of the joints' torque limits
    range_share: float = 0.8  # of the joints' position ranges
    reach: float = 1.5  # largest way of a joint from the middle [rad]
    lowest: float = -np.inf  # height that joints and tip stay above, base at 0 [m]
    radius: float = np.inf  # distance from the base's axis that joints and tip keep within [m]


@dataclass(frozen=True)
class Excitation:
    """A planned motion, and how well it identifies."""

    trajectory: Trajectory
    condition: float  # of the regressor with columns of unit length
    information: float  # logarithm of the determinant of the normalized information, per parameter
    torque: np.ndarray  # largest torque of each joint, shape (n,) [N m]


def plan_excitation(
    arm: SerialArm,
    duration: float = 30.0,  # [s]
    bounds: Bounds | None = None,
    center: np.ndarray | None = None,  # shape (n,); that of the joints' ranges if not given [rad]
    trials: int = 300,
    seed: int = 1,
) -> Excitation:
    """Fourier trajectory that determines the parameters best (D-optimal) within limits."""
    bounds = bounds or Bounds()
    search = _Search(arm, bounds, center)
    rng = np.random.default_rng(seed)
    best: tuple[float, Trajectory] | None = None
    for trial in range(trials):
        if best is None or trial < trials // 3:
            candidate = random_trajectory(rng, search.center, search.reach, search.speed, duration)
        else:
            candidate = search.varied(rng, best[1], 0.5 * (1.0 - trial / trials) + 0.05)
        allowed = search.within_limits(candidate)
        if allowed is None:
            continue
        rating = search.information(allowed)
        if best is None or rating > best[0]:
            best = rating, allowed
    if best is None:
        raise IdentificationError(
            'no motion keeps the limits of workspace and torque; choose '
            'another centre, a smaller reach or a slower motion'
        )
    return Excitation(best[1], search.condition(best[1]), best[0], search.torques(best[1]))


class _Search:
    """Arm, limits, and the rating of trajectories."""

    def __init__(self, arm: SerialArm, bounds: Bounds, center: np.ndarray | None):
        self._arm, self._bounds = arm, bounds
        self._model = RigidBody(arm)
        self._base = find_base_parameters(self._model)
        limits = [joint.limits for joint in arm.joints]
        lower, upper = np.array([joint.range for joint in arm.joints]).T
        self.center = 0.5 * (lower + upper) if center is None else center
        room = np.minimum(upper - self.center, self.center - lower)
        if np.any(room <= 0.0):
            raise IdentificationError('the centre is outside the position limits')
        self.reach = np.minimum(bounds.range_share * room, bounds.reach)
        self.speed = bounds.speed_share * np.array([min(limit.velocity, 10.0) for limit in limits])
        self._torque = bounds.torque_share * np.array([limit.torque for limit in limits])
        # What no motion tells apart, as a constant weight and an offset of friction, is no reason
        # to prefer one.
        some = random_trajectory(
            np.random.default_rng(0), self.center, self.reach, self.speed, 10.0
        )
        self._told = independent(qr(self._all_columns(some), mode='r')[0])

    def varied(self, rng: np.random.Generator, trajectory: Trajectory, width: float) -> Trajectory:
        size = width * self.reach / np.arange(1, len(trajectory.sine) + 1)[:, None]
        sine, cosine = size * rng.normal(size=(2, *size.shape))
        changed = replace(
            trajectory, sine=trajectory.sine + sine, cosine=trajectory.cosine + cosine
        )
        return fit_to_limits(changed, self.reach, self.speed)

    def within_limits(self, trajectory: Trajectory) -> Trajectory | None:
        """The trajectory, made smaller until it keeps all limits; None if it never does."""
        for _ in range(4):
            if self._in_workspace(trajectory) and np.all(self.torques(trajectory) <= self._torque):
                return trajectory
            trajectory = trajectory.scaled(0.7)
        return None

    def torques(self, trajectory: Trajectory) -> np.ndarray:
        """Largest torque of each joint, shape (n,) [N m]."""
        motion = trajectory.sample(np.arange(0.0, trajectory.duration, 5 * _CHECK_STEP))
        full = self._model.regressor(*motion)
        rigid = full[:, :, : N_INERTIAL * self._model.n] @ self._arm.inertial_parameters()
        largest, fastest = np.abs(rigid).max(axis=0), np.abs(motion[1]).max(axis=0)
        most = [
            abs(f.offset) + f.coulomb + f.load * load + abs(f.viscous) * speed
            for f, load, speed in zip((j.friction for j in self._arm.joints), largest, fastest)
        ]
        return np.abs(rigid + motion[2] @ self._model.chain.motor).max(axis=0) + most

    def _in_workspace(self, trajectory: Trajectory) -> bool:
        if not (np.isfinite(self._bounds.lowest) or np.isfinite(self._bounds.radius)):
            return True
        position = trajectory.sample(np.arange(0.0, trajectory.duration, _CHECK_STEP))[0]
        up = -self._arm.gravity_vector() / max(self._arm.gravity, 1e-9)
        n = self._model.n
        turns, points = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
        for q in position:
            joint_frames(self._model.chain, q, turns, points)
            height = points[1:] @ up
            away = np.linalg.norm(points[1:] - np.outer(height, up), axis=1)
            if height.min() < self._bounds.lowest or away.max() > self._bounds.radius:
                return False
        return True

    def _regressor(self, trajectory: Trajectory) -> np.ndarray:
        """Rows of all joints, each in units of its torque's range, of what motions tell apart."""
        return self._all_columns(trajectory)[:, self._told]

    def _all_columns(self, trajectory: Trajectory) -> np.ndarray:
        q, v, a = trajectory.sample(np.arange(0.0, trajectory.duration, STEP))
        full = self._model.regressor(q, v, a)
        torque = full[:, :, : N_INERTIAL * self._model.n] @ self._arm.inertial_parameters()
        friction = friction_columns(v, np.full(self._model.n, SLOPE), torque)[:, :, [0, 1, 3]]
        rows = join_columns(full[:, :, self._base.columns], friction)
        size = np.maximum(np.max(np.abs(torque), axis=0), 0.02 * np.abs(torque).max())
        return (rows / size[:, None]).reshape(-1, rows.shape[2])

    def information(self, trajectory: Trajectory) -> float:
        rows = self._regressor(trajectory)
        sign, value = np.linalg.slogdet(rows.T @ rows / len(rows))
        return float(value / rows.shape[1]) if sign > 0 else -np.inf

    def condition(self, trajectory: Trajectory) -> float:
        rows = self._regressor(trajectory)
        return float(np.linalg.cond(rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-12)))


def write_reference(
    arm: SerialArm, trajectory: Trajectory, rate: float, folder: Path
) -> list[Path]:
    """Write a motion into a new folder: table, trajectory message, bag, scenario."""
    folder.mkdir(parents=True)
    time = np.arange(0.0, trajectory.duration + 0.5 / rate, 1.0 / rate)
    motion = trajectory.sample(time)
    written = 'trajectory.csv', 'trajectory.yaml', 'reference', 'scenario.yaml'
    files = [folder / name for name in written]
    names, signals = arm.joint_names, (*motion[:2], joint_torques(arm, *motion))
    kinds = ('position', 'velocity', 'effort')
    header = ','.join(['time', *(f'{name}_{kind}' for kind in kinds for name in names)])
    table = np.column_stack([time, *signals])
    np.savetxt(files[0], table, '%.9g', ',', header=header, comments='')
    with BagWriter(files[2]) as writer:
        stamps = (round((1.0 + t) * 1e9) for t in time)
        writer.write_joint_states(TOPIC, names, zip(stamps, *signals))
    for file, content in zip(files[1::2], (_message(names, trajectory), _scenario(trajectory))):
        write_yaml(file, content)
    return files


def _scenario(trajectory: Trajectory) -> dict[str, Any]:
    """Scenario whose spline goes through the motion, which begins and ends at rest, too."""
    time = _message_times(trajectory)
    position, *_ = trajectory.sample(time)
    waypoints = [{'t': round(float(t), 9), 'joints': q.tolist()} for t, q in zip(time, position)]
    return {
        'name': 'excitation',
        'duration': float(trajectory.duration),
        'path': {'waypoints': waypoints},
    }


def _message_times(trajectory: Trajectory) -> np.ndarray:
    """Times of the points from the begin to the end [s]."""
    count = int(np.ceil(trajectory.duration / STEP - 1e-9))
    return np.append(STEP * np.arange(count), trajectory.duration)


def _message(names: tuple[str, ...], trajectory: Trajectory) -> dict[str, Any]:
    time = _message_times(trajectory)
    keys, points = ('positions', 'velocities', 'accelerations'), []
    for t, *motion in zip(time, *trajectory.sample(time)):
        seconds, nanoseconds = divmod(round(t * 1e9), 10**9)
        point: dict[str, Any] = {key: values.tolist() for key, values in zip(keys, motion)}
        point['time_from_start'] = {'sec': seconds, 'nanosec': nanoseconds}
        points.append(point)
    return {'joint_names': list(names), 'points': points}
