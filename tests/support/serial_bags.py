"""A serial arm of three joints, and recordings of it."""

import numpy as np
from simulated_runs import simulated_run

from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import (
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
)

TOPIC, MEASUREMENT = '/lpv/joint_states', 'sensor_msgs/msg/JointState'


def crane():
    """A turning base, shoulder and elbow; encoders with rates that are derived from them."""
    placed = ((0.0, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.2), np.pi / 2), ((0.4, 0.0, 0.0), 0.0)
    joints = tuple(
        SerialJoint(
            f'joint{i + 1}',
            position,
            (roll, 0.0, 0.0),
            (0.0, 0.0, 1.0),
            LinkInertia(mass, (0.2 * mass, 0.0, 0.0), (0.1, 0.0, 0.3, 0.0, 0.0, 0.3)),
            rotor_inertia=0.05,
            limits=JointLimits(-2.5, 2.5, 2.5, 60.0),
            sensors=JointSensors(f'encoder{i + 1}', 1e-4, 0.0, 'derived', 5e-3),
        )
        for i, ((position, roll), mass) in enumerate(zip(placed, (4.0, 5.0, 3.0)))
    )
    return SerialArm('crane', joints, tip=(0.4, 0.0, 0.0))


def crane_file(folder):
    """Its arm file."""
    save_arm(crane(), folder / 'crane.yaml')
    return folder / 'crane.yaml'


def crane_run(duration=1.2, faults=()):
    """A simulated motion."""
    return simulated_run(crane(), duration, *faults)


def record_crane(path, run, without=()):
    """Bag of a run; its messages lack the fields ``without``, and their joints are in disorder."""
    order, names = [2, 0, 1], crane().joint_names
    with BagWriter(path) as writer:
        messages = BagMessages(writer.typestore, 'base_link')
        writer.add_topic(TOPIC, MEASUREMENT)
        for stamp, sample in zip(run.stamps.tolist(), run.samples):
            fields = dict(zip(('position', 'velocity', 'effort'), sample[:, order]))
            fields |= {name: [] for name in without}
            message = messages.joint_state(stamp, [names[i] for i in order], **fields)
            writer.write(TOPIC, stamp, message)
    return path
