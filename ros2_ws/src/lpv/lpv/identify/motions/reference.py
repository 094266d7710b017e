"""A planned motion as files: a table, a trajectory message, and a bag that can be played."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lpv.bag.rosbag.writing import BagWriter
from lpv.core.serial_arm.description import SerialArm
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.motions.trajectory import STEP, Trajectory

TOPIC = '/lpv/excitation'
"""Topic of the reference in the bag, sensor_msgs/JointState."""


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
        file.write_text(yaml.safe_dump(content, sort_keys=False, width=110))
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
