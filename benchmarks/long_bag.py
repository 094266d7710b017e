"""Makes long bags quickly: one simulated round of a closed path, repeated with fresh noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lpv.bag.replay.writer import RecordTemplate
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import qos_profile
from lpv.bag.rosbag.output_folder import replaced
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.serial_arm.sensor_map import map_rows
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.faults import FaultInjector
from lpv.files import load_scenario

TOPICS = {
    '/lpv/joint_states': 'sensor_msgs/msg/JointState',
    '/lpv/torque_command': 'lpv_msgs/msg/TorqueCommand',
}
_START = 1_700_000_000_000_000_000
_CHUNK = 3000
"""Samples in a chunk: about as many bytes as rosbag2's recorder has in one."""
_FAULTY = 30
"""Every so many rounds the sensors have the scenario's faults."""


def long_bag(path, arm, gains, hours):
    """A bag of measurements and torque commands, unless it is there; messages on each topic."""
    path, count = Path(path), round(hours * 3600.0 / arm.sample_time)
    if path.exists():
        return count
    truth, bias = _round(arm, gains)
    generator = np.random.default_rng(0)
    with replaced(path) as part, BagWriter(part, 'zstd_fast') as writer:
        for topic, msgtype in TOPICS.items():
            writer.add_topic(topic, msgtype, [qos_profile(False, False, 5)])
        templates = _templates(writer, arm)
        for first in range(0, count, _CHUNK):
            k = np.arange(first, min(first + _CHUNK, count))
            writer.write_chunk(*_chunk(k, templates, truth, bias, arm, generator))
    return count


def _round(arm, gains):
    """True positions, rates and torques of one round, and the faults of its sensors."""
    scenario = load_scenario('two_faults')
    run = run_closed_loop(arm, replace(scenario, faults=(), noise=False), gains)
    injector = FaultInjector(arm.sensor_names, scenario.faults, np.random.default_rng(0))
    bias = [injector.apply(time, np.zeros(2), arm.sample_time) for time in run.time[:-1]]
    truth = run.position, run.velocity, run.effort, run.command
    return [column[:-1] for column in truth], np.array(bias)


def _templates(writer, arm):
    messages = BagMessages(writer.typestore, 'base_link')
    measurement = messages.joint_state(0, arm.joint_names, *([0.0, 0.0],) * 3)
    command = messages.make(
        'lpv_msgs/msg/TorqueCommand', 0, {'torque': [0.0, 0.0], 'safe_stop': False}
    )
    return [
        RecordTemplate(writer.typestore, message, msgtype, writer.channel(topic))
        for message, (topic, msgtype) in zip((measurement, command), TOPICS.items())
    ]


def _chunk(k, templates, truth, bias, arm, generator):
    position, velocity, effort, torque = (column[k % len(bias)] for column in truth)
    shape = position.shape
    faulty = (k // len(bias) % _FAULTY == _FAULTY - 1)[:, None] * bias[k % len(bias)]
    sensors = arm.sensors()
    noise = sensors.position_noise, sensors.velocity_noise
    to_sensors, to_joints = arm.joints_to_sensors(), arm.sensors_to_joints()
    reading, rate = (
        map_rows(to_sensors, truth) + sigma * generator.standard_normal(shape)
        for truth, sigma in zip((position, velocity), np.array(noise))
    )
    stamp = _START + k * round(arm.sample_time * 1e9)
    late = stamp + generator.integers(100_000, 400_000, len(k))
    return (
        templates[0].fill(
            late,
            stamp,
            {
                'position': map_rows(to_joints, reading + faulty),
                'velocity': map_rows(to_joints, rate),
                'effort': effort,
            },
        ),
        templates[1].fill(
            late + generator.integers(100_000, 400_000, len(k)),
            stamp,
            {'torque': torque, 'safe_stop': np.zeros(len(k))},
        ),
    )
