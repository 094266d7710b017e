"""Recordings of a simulated arm whose parameters are known."""

from dataclasses import dataclass

import numpy as np
import pinocchio

from lpv_core.serial_arm.description import SerialArm
from lpv_identify.model.rigid_body import build_model
from lpv_identify.motions.trajectory import Trajectory
from lpv_identify.recordings.recording import Recording


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of white noise per sample."""

    position: float = 2e-5  # [rad]
    velocity: float = 2e-3  # [rad/s]
    torque: float = 0.02  # share of each joint's largest torque


def joint_torques(
    arm: SerialArm, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Torques that move an arm, friction and rotors included, shape (samples, n) [N m].

    Arguments of the same shape [rad], [rad/s], [rad/s2].
    """
    model = build_model(arm)
    data = model.createData()
    rigid = np.array(
        [pinocchio.rnea(model, data, *sample) for sample in zip(position, velocity, acceleration)]
    )
    rotors = np.array([joint.rotor_inertia for joint in arm.joints])
    friction = [
        joint.friction.torque(velocity[:, j], rigid[:, j]) for j, joint in enumerate(arm.joints)
    ]
    return rigid + rotors * acceleration + np.stack(friction, axis=1)


def simulate(
    arm: SerialArm,
    trajectory: Trajectory,
    rate: float,
    noise: SensorNoise,
    rng: np.random.Generator,
) -> Recording:
    """Recording of an arm that follows a trajectory exactly.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    trajectory : Trajectory
        Its motion.
    rate : float
        Samples per second [Hz].
    noise : SensorNoise
        Of the sensors.
    rng : numpy.random.Generator
        Source of the noise.

    Returns
    -------
    Recording
        Efforts in the unit that the arm's gains belong to.
    """
    time = np.arange(0.0, trajectory.duration, 1.0 / rate)
    motion = trajectory.sample(time)
    torque = joint_torques(arm, *motion)
    spread = noise.torque * np.max(np.abs(torque), axis=0)
    gain = np.array([joint.torque_gain for joint in arm.joints])
    shape = torque.shape
    return Recording(
        'simulation',
        time,
        motion[0] + noise.position * rng.normal(size=shape),
        motion[1] + noise.velocity * rng.normal(size=shape),
        (torque + spread * rng.normal(size=shape)) / gain,
    )
