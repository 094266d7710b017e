"""One run of a campaign as a bag, as the graph would have recorded it, and files to repeat it."""

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.output_folder import replaced
from lpv.bag.rosbag.writing import BagWriter
from lpv.campaign.execution.runs import RunPlan
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.closed_loop import Run
from lpv.core.support.config import write_parameters, write_yaml
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import NANOSECONDS

NAMESPACE = '/lpv'
START = NANOSECONDS
"""Stamp of the first sample [ns], as in the lockstep graph: zero means "not set" in ROS."""


def stamps_of(run: Run) -> np.ndarray:
    """Header stamps of a run's samples in its bag [ns]."""
    return START + np.array([round(t * 1e9) for t in run.time.tolist()], np.int64)


def write_run_bag(plan: RunPlan, run: Run, out: str | Path) -> None:
    """Write a run as a bag with the answers of a replay, and files that repeat it."""
    out = Path(out)
    if out.exists():
        raise ConfigError('--bag', 'exists already: name a new folder', str(out))
    with replaced(out) as whole, tempfile.TemporaryDirectory(dir=whole.parent) as folder:
        measured = Path(folder) / 'measured'
        write_signals(plan.arm, run, measured)
        monitor = SerialSensorMonitor(f'{NAMESPACE}/uio', plan.arm, plan.parameters, plan.gains)
        Replay(monitor, preset='zstd_fast').run(measured, whole)
        own = {
            'lockstep': True,
            'diagnosis': asdict(plan.parameters),
            'compensation': plan.values['compensation'],
            'substeps': plan.substeps,
        }
        write_parameters(whole / 'parameters.yaml', own)
        for name, data in plan.files.items():
            write_yaml(whole / f'{name}.yaml', data)
        if plan.gains is not None:
            text = f'Gains of run {plan.number} ({plan.scenario.name}).'
            plan.gains.save(whole / 'gains.yaml', text)


def differences(stored: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Figures that are not what the results of the campaign say."""

    def differ(one: Any, two: Any) -> bool:
        is_close = float is type(one) is type(two) and np.isclose(one, two, 1e-9, 1e-12, True)
        return one != two and not is_close

    return [name for name in found if name in stored and differ(stored[name], found[name])]


def write_signals(arm: SerialArm, run: Run, path: str | Path) -> None:
    """Write measurements, commands, references and truth of a run as a bag, without answers."""
    stop = run.safe_stop
    command = np.where(stop[:, None], 0.0, run.command)
    known = ('position', 'velocity', 'fault', 'disturbance')
    truth = {name: getattr(run, name) for name in known} | {'torque': run.effort * arm.torque_gain}
    names = ('position', 'velocity', 'acceleration')
    reference = dict(zip(names, run.path[:, run.place])) | {'tip_position': run.tip[run.place]}
    kept, everywhere = ~run.lost, np.ones(len(run.time), bool)
    measured = {'position': run.measured, 'velocity': run.measured_velocity, 'effort': run.effort}
    topics = (
        ('ground_truth', 'lpv_msgs/msg/GroundTruth', everywhere, truth),
        ('joint_states', 'sensor_msgs/msg/JointState', kept, measured),
        ('torque_command', 'lpv_msgs/msg/TorqueCommand', kept,
         {'torque': command, 'safe_stop': stop}),
        ('reference', 'lpv_msgs/msg/JointReference', kept & ~stop, reference),
    )  # fmt: skip
    names_of = {'joint_states': {'name': list(arm.joint_names)}}
    with BagWriter(path) as bag:
        frames = {name: 'base_link' if name in names_of else arm.name for name, *_ in topics}
        messages = {name: BagMessages(bag.typestore, frame) for name, frame in frames.items()}
        for name, msgtype, _, _ in topics:
            bag.add_topic(f'{NAMESPACE}/{name}', msgtype)
        for k, stamp in enumerate(stamps_of(run).tolist()):
            for name, msgtype, chosen, fields in topics:
                if chosen[k]:
                    row = {field: values[k] for field, values in fields.items()}
                    message = messages[name].make(msgtype, stamp, names_of.get(name, {}) | row)
                    bag.write(f'{NAMESPACE}/{name}', stamp, message)
