"""Fourier trajectories of an arm that start and end at rest."""

from dataclasses import dataclass, replace

import numpy as np

HARMONICS = 5
"""Of a joint's Fourier series, as in Swevers et al. (1997)."""
STEP = 10.0 / HARMONICS / 20.0
"""Between points of the motion, 20 in a period of the last harmonic: the first one has 10 s [s]."""
RAMP = 1.5
"""Time in which the motion fades in and out [s]."""


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
        e, de, dde = (x[:, None] for x in self._envelope(time))
        position = self.center + e * wave
        return position, de * wave + e * rate, dde * wave + 2.0 * de * rate + e * bend

    def scaled(self, factor: np.ndarray | float) -> 'Trajectory':
        """The motion with other amplitudes."""
        return replace(self, sine=self.sine * factor, cosine=self.cosine * factor)

    def _envelope(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ramp = min(RAMP, 0.25 * self.duration)
        up, down = np.clip(time / ramp, 0, 1), np.clip((self.duration - time) / ramp, 0, 1)
        x = np.minimum(up, down)
        sign = np.where(up <= down, 1.0, -1.0)
        value = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        slope = 30.0 * x**2 * (1.0 - x) ** 2 * sign / ramp
        curve = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
        return value, slope, curve


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
