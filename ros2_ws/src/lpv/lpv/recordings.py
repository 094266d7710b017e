"""Measurements in bags."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lpv.bag.run.record import load_run
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import LpvError


@dataclass(frozen=True)
class Sample:
    """One measurement of all joints."""

    stamp: int  # header stamp [ns]
    position: np.ndarray  # (joints,) [rad]
    velocity: np.ndarray  # (joints,) [rad/s]
    effort: np.ndarray  # (joints,) [N m]; NaN where there is none


def read_bag(path: str | Path, arm: SerialArm | None = None) -> Iterator[Sample]:
    """Measurements of a bag, in the order of their stamps.

    Parameters
    ----------
    path : str or pathlib.Path
        rosbag2 folder, or one MCAP or sqlite3 file, with sensor_msgs/JointState.
    arm : SerialArm, optional
        Its joints are read, in its order; otherwise those of the first message.

    Yields
    ------
    Sample
        One for each stamp.

    Raises
    ------
    LpvError
        If the bag cannot be read, or lacks measurements or one of the joints.
    """
    stamps, position, velocity, effort = recorded(path, arm)
    for row, stamp in enumerate(stamps.tolist()):
        yield Sample(stamp, position[row], velocity[row], effort[row])


def recorded(path: str | Path, arm: SerialArm | None = None) -> tuple[np.ndarray, ...]:
    """Stamps [ns], positions [rad], rates [rad/s] and efforts [N m] of a bag as arrays."""
    record = load_run(path, joint_names=None if arm is None else arm.joint_names)
    if 'joint_states' not in record.streams:
        raise LpvError(f'{path}: holds no measurements (sensor_msgs/JointState)')
    measured = record.streams['joint_states']
    return (
        record.stamps['joint_states'],
        *(measured[n] for n in ('position', 'velocity', 'effort')),
    )
