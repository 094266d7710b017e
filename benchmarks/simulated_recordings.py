"""Recordings of a simulated arm whose parameters are known."""

from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.description import LinkInertia, SerialArm
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.motions import Trajectory
from lpv.identify.recordings.recording import Recording


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of white noise per sample."""

    position: float = 2e-5  # [rad]
    velocity: float = 2e-3  # [rad/s]
    torque: float = 0.02  # share of each joint's largest torque


def simulate(
    arm: SerialArm,
    trajectory: Trajectory,
    rate: float,
    noise: SensorNoise,
    rng: np.random.Generator,
) -> Recording:
    """Recording of an arm that follows a trajectory exactly, so many samples per second [Hz].

    Efforts are in the unit that the arm's gains belong to.
    """
    time = np.arange(0.0, trajectory.duration, 1.0 / rate)
    position, velocity, acceleration = trajectory.sample(time)
    torque = joint_torques(arm, position, velocity, acceleration)
    spread = noise.torque * np.max(np.abs(torque), axis=0)
    gain = np.array([joint.torque_gain for joint in arm.joints])
    position = position + noise.position * rng.normal(size=torque.shape)
    velocity = velocity + noise.velocity * rng.normal(size=torque.shape)
    effort = (torque + spread * rng.normal(size=torque.shape)) / gain
    return Recording('simulation', time, position, velocity, effort)


def is_physical(link: LinkInertia) -> bool:
    """Whether some distribution of positive mass has the parameters of a link."""
    matrix = link.pseudo_inertia()
    return bool(np.linalg.eigvalsh(matrix)[0] >= -1e-9 * np.trace(matrix))
