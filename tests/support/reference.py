"""The reference bag: what the diagnosis answers to one recording, so that changes are noticed.

``make reference`` replays the bag and stores the present answers; do so only where they were meant
to change, and say why in the commit.  ``reference.py --measurements`` makes the
recording itself anew, too.
"""

import argparse
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from places import DATA
from rosbags.highlevel import AnyReader

from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.writing import BagWriter
from lpv.bag.run.streams import stamp_of
from lpv.cli.commands.compare import show
from lpv.core.control.tracking import TrackingController
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import load_gains, save_gains
from lpv.core.uio.planar import planar_model
from lpv.report.comparison import Tolerances, compare_runs, load_pair

BAG = DATA / 'reference'
TOLERANCES = Tolerances(mise=1e-3, delay=0.0, signal=1e-6, flags=0.0, missing=1.0)
"""Processors round differently in the last digits; everything else is a change of behaviour."""
_THINNED = 20
"""Of the estimates every so many are stored."""
_FAULTS = (
    Fault('link1_angle', 'bias', 1.5, 1.5, size=0.3),
    Fault('link2_angle', 'drift', 2.5, 2.0, size=0.25, rate=0.25),
    Fault('link1_angle', 'dropout', 4.0, 0.1),
    Fault('link2_angle', 'stuck', 4.8, 0.8),
)
_STREAMS = ('joint_states', 'ground_truth')


def monitor(**options):
    """The monitor whose answers are the reference."""
    arm = load_arm(bringup_file('arms', 'paper'))
    return SerialSensorMonitor('', arm, gains=load_gains(BAG / 'gains.yaml'), **options)


def compare(replayed):
    """Comparison of the reference with a replay of it."""
    arm = load_arm(bringup_file('arms', 'paper'))
    return compare_runs(*load_pair(BAG, replayed, arm), arm, TOLERANCES)


def _rounded(values, bits):
    """Fewer digits, far below the noise: they would make most of the file."""
    return np.round(np.asarray(values, float) * 2.0**bits) / 2.0**bits


def record(path):
    """Simulate 6 s with faults, lost, late and unusable samples."""
    arm = load_arm(bringup_file('arms', 'paper'))
    scenario = load_scenario(bringup_file('scenarios', 'two_faults'))
    gains = load_gains(BAG / 'gains.yaml')
    plant = ArmSimulator(arm, replace(scenario, faults=_FAULTS))
    controller, course = TrackingController(arm, gains), scenario.path(arm)
    rng, faulty = np.random.default_rng(1), None
    with BagWriter(path, 'zstd_small') as writer:
        messages = BagMessages(writer.typestore, 'base_link')
        types = ('sensor_msgs/msg/JointState', 'lpv_msgs/msg/GroundTruth')
        for name, msgtype in zip(_STREAMS, types):
            writer.add_topic(f'/lpv/{name}', msgtype)
        for k in range(round(6.0 / arm.sample_time)):
            sense, truth = plant.sense()
            stamp = 10**9 + k * round(arm.sample_time * 1e9)
            read = ((sense.position, 16), (sense.velocity, 13), (sense.effort, 8))
            vectors = [_rounded(values, bits) for values, bits in read]
            kind = rng.integers(300)
            if kind == 0:
                vectors[rng.integers(3)][rng.integers(2)] = np.nan
            if kind != 1:
                message = messages.joint_state(stamp, arm.joint_names, *vectors)
                writer.write('/lpv/joint_states', stamp, message)
            begun, faulty = faulty, (truth.fault != 0.0).tolist()
            if k % _THINNED == 0 or faulty != begun:
                fields = {
                    name: _rounded(getattr(truth, name), 20)
                    for name in ('position', 'velocity', 'fault')
                }
                fields |= {'torque': vectors[2], 'disturbance': 0.0}
                message = messages.make(types[1], stamp, fields)
                writer.write('/lpv/ground_truth', stamp, message)
            feedback = truth.position, truth.velocity, truth.position
            command = controller.update(course.sample(plant.time), *feedback, arm.sample_time)
            plant.step(command.torque)


def renew(measurements):
    """Store what is answered now; the comparison with what was answered before, or None."""
    with tempfile.TemporaryDirectory() as folder:
        source, replayed = BAG, Path(folder) / 'replayed'
        if measurements:
            source = Path(folder) / 'recorded'
            record(source)
        Replay(monitor()).run(source, replayed)
        before = None if measurements else compare(replayed)
        new = Path(folder) / BAG.name
        with AnyReader([replayed]) as reader, BagWriter(new, 'zstd_small') as writer:
            for connection in reader.connections:
                if connection.topic.startswith('/lpv/'):
                    writer.copy_topic(connection)
            for connection, time, data in reader.messages():
                if _is_kept(connection, reader.deserialize(data, connection.msgtype)):
                    writer.write_raw(connection.topic, time, bytes(data))
        shutil.copy(BAG / 'gains.yaml', new)
        shutil.rmtree(BAG)
        shutil.copytree(new, BAG)
    return before


def _is_kept(connection, message):
    if connection.topic.endswith('_estimate'):
        return stamp_of(message.header.stamp) // 2_000_000 % _THINNED == 0
    return connection.topic.startswith('/lpv/')


def main():
    """Renew, and show what has changed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--measurements', action='store_true', help='simulate and design anew')
    arguments = parser.parse_args()
    if arguments.measurements:
        from lpv_design.design_flow import design
        from lpv_design.requirement import load_requirement

        BAG.mkdir(parents=True, exist_ok=True)
        arm = load_arm(bringup_file('arms', 'paper'))
        gains = design(planar_model(arm), load_requirement('paper')).gains
        save_gains(gains, BAG / 'gains.yaml')
    before = renew(arguments.measurements)
    if before is not None:
        from rich.console import Console

        show(before, Console(soft_wrap=True, highlight=False))
    print(f'renewed {BAG}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
