"""Serial arms of three joints, and of a ball joint, and recordings of it."""

from dataclasses import replace

import numpy as np
from bags import write_measurements
from fault_injection import shoulder_arm
from simulated_runs import simulated_run

from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import LinkInertia, Uncertainty

TOPIC = '/lpv/joint_states'


def crane():
    """A turning base, shoulder and elbow; encoders with rates that are derived from them."""
    return replace(shoulder_arm(), name='crane', uncertainty=Uncertainty())


def ball_joint():
    """Three joints that meet in one point, two of whose links stand for nothing, and a fourth."""
    nothing = LinkInertia.from_vector(1e-3 * crane().joints[2].link.to_vector())
    turns = [(0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)]
    of = [crane().joints[i] for i in (0, 1, 1, 2)]
    joints = [
        replace(joint, name=name, orientation=turned, rotor_inertia=0.0,
                position=joint.position if name == 'd' else (0.0, 0.0, 0.0),
                link=nothing if name in 'ab' else joint.link,
                sensors=replace(joint.sensors, name=name))
        for joint, turned, name in zip(of, turns, 'abcd')
    ]  # fmt: skip
    return replace(crane(), name='ball', joints=tuple(joints), sensor_matrix=None)


def crane_file(folder):
    save_arm(crane(), folder / 'crane.yaml')
    return folder / 'crane.yaml'


def crane_run(duration=1.2, faults=()):
    return simulated_run(crane(), duration, *faults)


def record_crane(path, run):
    """Bag of a run, whose messages have the joints in disorder."""
    order, names = [2, 0, 1], crane().joint_names
    vectors = np.moveaxis(run.samples[:, :, order], 1, 0)
    return write_measurements(path, [names[i] for i in order], run.stamps / 1e9, *vectors, TOPIC)
